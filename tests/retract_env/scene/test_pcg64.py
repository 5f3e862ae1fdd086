"""The compiled generator: NumPy's numbers, bit for bit, and NumPy's state after them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.scene import pcg64, ziggurat

COMPILED = {
    "random": pcg64.random,
    "uniform": pcg64.uniform,
    "integers": pcg64.integers,
    "standard_normal": ziggurat.standard_normal,
}
LEAST, MOST = -(2**63), 2**63 - 1
SPANS = (0, 1, 2, 2**31, 3 * 2**30, 2**32 - 2, 2**32 - 1, 2**32, 3 * 2**62, 2**64 - 2, 2**64 - 1)
"""where NumPy's method changes, and where it draws again most often"""

numbers = st.floats(-1e9, 1e9)
wholes = st.one_of(
    st.tuples(st.integers(LEAST, MOST), st.integers(LEAST, MOST)).map(lambda ends: (min(ends), max(ends))),
    st.sampled_from(SPANS).map(lambda span: (LEAST, LEAST + span)),
    st.sampled_from(SPANS[:8]).map(lambda span: (-5, span - 5)),
)
draws = st.one_of(
    st.tuples(st.just("random")),
    st.tuples(st.just("uniform"), numbers, numbers).map(lambda d: (d[0], min(d[1:]), max(d[1:]))),
    st.tuples(st.just("integers"), wholes).map(lambda d: (d[0], *d[1])),
    st.tuples(st.just("standard_normal")),
)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32), st.lists(draws, max_size=60))
def test_any_draws_in_any_order_are_those_of_numpy(seed: int, wanted: list[tuple[str, ...]]) -> None:
    rng = np.random.default_rng(seed)
    row = pcg64.state_of(rng)
    for kind, *ends in wanted:
        options = {"endpoint": True} if kind == "integers" else {}
        assert COMPILED[kind](row, *ends) == getattr(rng, kind)(*ends, **options)
        np.testing.assert_array_equal(row, pcg64.state_of(rng))


@pytest.mark.parametrize("kind", ["random", "standard_normal"])
def test_many_draws_are_those_of_numpy(kind: str) -> None:
    """Enough for the rare branches: 1 normal number in 70 leaves its layer, 1 in 4000 lies in the tail."""
    rng = np.random.default_rng(3)
    row = pcg64.state_of(rng)
    drawn = [COMPILED[kind](row) for _ in range(100_000)]
    np.testing.assert_array_equal(drawn, getattr(rng, kind)(100_000))


def test_a_generator_goes_on_where_the_kernels_stopped() -> None:
    rng, twin = np.random.default_rng(4), np.random.default_rng(4)
    row = pcg64.state_of(rng)
    for high in (6, 2**40):  # the first leaves half of a draw behind
        pcg64.integers(row, 0, high)
        twin.integers(0, high, endpoint=True)
        pcg64.give_back(rng, row)
        assert rng.bit_generator.state == twin.bit_generator.state


def test_other_bit_generators_seed_one_and_go_on_themselves() -> None:
    first, again, never = (np.random.Generator(np.random.MT19937(5)) for _ in range(3))
    rows = [pcg64.state_of(rng) for rng in (first, again, first)]
    np.testing.assert_array_equal(rows[0], rows[1])
    assert (rows[0] != rows[2]).any()
    pcg64.give_back(again, rows[1])
    assert again.random() != never.random()
