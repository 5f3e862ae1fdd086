"""The sweep of the spring model: exact sections, brute-force chords, symmetries, overlaps, many vertices."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retract_env.spring import SpringModel
from tests.retract_env.spring.outlines import (
    EV,
    LATTICE_TOLERANCE,
    E,
    H,
    L,
    Outlines,
    box,
    brute_compliance,
    few,
    flap,
    scenes,
)

# --- the compliance


@few
@given(scenes)
def test_compliance_equals_the_chords_of_the_union_on_both_sides_of_every_knot(
    veins: tuple[Outlines, list[float]],
) -> None:
    model = flap(*veins[0], moduli=veins[1])
    gap = np.diff(model.knots)
    first, second = (brute_compliance(model.knots[:-1] + f * gap, *veins) for f in (0.25, 0.75))
    # linear between two knots: two points determine the values just inside both
    tolerance = LATTICE_TOLERANCE * H / min(veins[1] + [E])
    np.testing.assert_allclose(model.right[:-1], 1.5 * first - 0.5 * second, rtol=0, atol=tolerance)
    np.testing.assert_allclose(model.left[1:], 1.5 * second - 0.5 * first, rtol=0, atol=tolerance)
    middle = model.knots[:-1] + 0.5 * gap
    np.testing.assert_allclose(model.compliance(middle), (first + second) / 2, rtol=0, atol=tolerance)
    np.testing.assert_allclose(model.k_eq(middle) * model.compliance(middle), 1, rtol=1e-15)


@few
@given(scenes)
def test_every_minimum_and_maximum_is_that_of_the_brute_force_curve(
    veins: tuple[Outlines, list[float]],
) -> None:
    model = flap(*veins[0], moduli=veins[1])
    basins = model.basins()
    x = np.sort(np.concatenate([np.linspace(-L, 0, 1001)[1:-1] + 1e-7, model.knots[1:-1] - 1e-9]))
    k = 1 / brute_compliance(x, *veins)
    noise = 2 * LATTICE_TOLERANCE * k.max()
    for basin in basins:
        falling = k[(x > basin.left) & (x < basin.x - basin.width / 2)]
        flat = k[(x > basin.x - basin.width / 2) & (x < basin.x + basin.width / 2)]
        rising = k[(x > basin.x + basin.width / 2) & (x < basin.right)]
        assert (np.diff(falling) <= noise).all()
        assert (np.diff(rising) >= -noise).all()
        np.testing.assert_allclose(flat, basin.k_eq, rtol=0, atol=noise)
        beside = np.concatenate([falling, rising])
        assert (beside >= basin.k_eq - noise).all()
        assert (falling <= basin.k_left + noise).all()
        assert (rising <= basin.k_right + noise).all()
        assert basin.k_eq <= basin.k_n
    # monotone within each basin and flat between two: no extremum is missing
    assert basins[0].left == -L or (k[x < basins[0].left] >= basins[0].k_left - noise).all()
    for here, there in pairwise(basins):
        assert here.k_right == there.k_left > max(here.k_eq, there.k_eq)
        assert here.right <= there.left
        top = k[(x > here.right) & (x < there.left)]
        np.testing.assert_allclose(top, here.k_right, rtol=0, atol=noise)


def test_rectangle_by_hand() -> None:
    model = flap(box(-0.03, -0.02))
    soft, stiff = H / E, (H - 0.002) / E + 0.002 / EV
    np.testing.assert_array_equal(model.knots, [-L, -0.03, -0.02, 0])
    np.testing.assert_allclose(model.left, [soft, soft, stiff, soft], rtol=1e-15)
    np.testing.assert_allclose(model.right, [soft, stiff, soft, soft], rtol=1e-15)
    np.testing.assert_allclose(
        model.k_eq([-0.03, -0.025, -0.02]), 1 / stiff, rtol=1e-15
    )  # stiffer at the jump
    np.testing.assert_allclose(model.k_eq([-L, -0.0300001, -0.0199999, 0]), 1 / soft, rtol=1e-15)


def test_triangle_and_trapezoid_by_hand() -> None:
    # chord: 0 to 2 mm over 5 mm, back over 1 mm; then 0 to 1 mm over 2 mm, level for 2 mm, back over 4 mm
    triangle = [(-0.04, 0.001), (-0.034, 0.001), (-0.035, 0.003)]
    trapezoid = [(-0.02, 0.002), (-0.012, 0.002), (-0.016, 0.003), (-0.018, 0.003)]
    model = flap(triangle, trapezoid)
    x = np.array([-0.04, -0.0375, -0.035, -0.0345, -0.034, -0.019, -0.018, -0.0165, -0.014, -0.012])
    chord = np.array([0, 1, 2, 1, 0, 0.5, 1, 1, 0.5, 0]) * 1e-3
    np.testing.assert_allclose(model.compliance(x), (H - chord) / E + chord / EV, rtol=1e-12)
    between = model.basins()[1]
    assert between.x == pytest.approx(-0.027, rel=1e-12)
    assert between.width == pytest.approx(0.014, rel=1e-12)
    assert (between.left, between.right) == (-0.035, -0.018)
    assert between.k_left == pytest.approx(1 / ((H - 0.002) / E + 0.002 / EV), rel=1e-12)
    assert between.k_right == between.k_n == pytest.approx(1 / ((H - 0.001) / E + 0.001 / EV), rel=1e-12)
    assert between.escape == pytest.approx(between.k_right - E / H, rel=1e-12)


@few
@given(scenes, st.integers(0, 2**32 - 1))
def test_the_way_an_outline_is_written_does_not_matter(
    veins: tuple[Outlines, list[float]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    outlines, moduli = veins
    written = []
    for outline in outlines:
        turned = np.roll(outline[:: rng.choice([-1, 1])], rng.integers(len(outline)), axis=0)
        written.append(np.vstack([turned, turned[:1]]) if rng.random() < 0.5 else turned)
    order = rng.permutation(len(outlines))
    x = rng.uniform(-L, 0, 200)
    np.testing.assert_allclose(
        flap(*(written[i] for i in order), moduli=[moduli[i] for i in order]).compliance(x),
        flap(*outlines, moduli=moduli).compliance(x),
        rtol=LATTICE_TOLERANCE,
    )


@few
@given(scenes)
def test_mirrored_flap_gives_mirrored_stiffness_and_inner_basins(veins: tuple[Outlines, list[float]]) -> None:
    model = flap(*veins[0], moduli=veins[1])
    mirrored = flap(*(o * [-1, 1] - [L, 0] for o in veins[0]), moduli=veins[1])
    x = np.linspace(-L, 0, 1000)[1:-1] + 1e-7
    np.testing.assert_allclose(mirrored.compliance(-L - x), model.compliance(x), rtol=LATTICE_TOLERANCE)
    inner = [b for b in model.basins() if b.left > -L and b.right < 0]
    other = [b for b in reversed(mirrored.basins()) if b.left > -L and b.right < 0]
    assert len(inner) == len(other)
    for a, b in zip(inner, other, strict=True):
        assert (a.k_eq, a.k_left, a.k_right) == pytest.approx(
            (b.k_eq, b.k_right, b.k_left), rel=LATTICE_TOLERANCE
        )
        assert a.width == pytest.approx(b.width, abs=1e-9 * L)
        assert a.x == pytest.approx(-L - b.x, abs=1e-9 * L)


@few
@given(scenes, st.integers(-10, 10), st.integers(-10, 10))
def test_lengths_and_moduli_scale_out(veins: tuple[Outlines, list[float]], a: int, b: int) -> None:
    size, stiffness = 2.0**a, 2.0**b
    outlines, moduli = veins
    model = flap(*outlines, moduli=moduli)
    scaled = SpringModel.from_outlines(
        size * L, size * H, stiffness * E, [size * o for o in outlines], [stiffness * m for m in moduli]
    )
    grasps = sorted(model.stable_grasps(), key=lambda grasp: grasp.x)
    others = sorted(scaled.stable_grasps(jaw_width=size * 1e-3), key=lambda grasp: grasp.x)
    # cutting overlapping veins rounds a little differently at another scale
    assert [g.x for g in others] == pytest.approx([size * g.x for g in grasps], rel=1e-12)
    assert [g.compression for g in others] == pytest.approx([size * g.compression for g in grasps], rel=1e-12)
    assert [g.score for g in others] == pytest.approx([size * stiffness * g.score for g in grasps], rel=1e-12)


# --- overlaps


def test_overlapping_veins_count_once_and_the_stiffer_counts() -> None:
    wide, narrow = box(-0.04, -0.01), box(-0.03, -0.02, 0.002, 0.004)
    x = np.array([-0.035, -0.025, -0.015])
    same = (H - np.array([2, 3, 2]) * 1e-3) / E + np.array([2, 3, 2]) * 1e-3 / EV
    np.testing.assert_allclose(flap(wide, narrow).compliance(x), same, rtol=1e-14)
    for order in (1, -1):  # the narrow one is stiffer and keeps its 2 mm, the wide one only 1 mm there
        model = flap(*(wide, narrow)[::order], moduli=(EV, 10 * EV)[::order])
        assert model.compliance(-0.025) == pytest.approx(
            (H - 0.003) / E + 0.001 / EV + 0.002 / (10 * EV), rel=1e-14
        )
    np.testing.assert_allclose(flap(wide, wide).compliance(x), flap(wide).compliance(x), rtol=1e-15)
    inside = box(-0.03, -0.02, 0.0015, 0.0025)  # leaves a hole in the wide one, or nothing of itself
    hole = flap(wide, inside, moduli=[EV, 10 * EV]).compliance(x)
    np.testing.assert_allclose(
        hole,
        (H - 0.002) / E + np.array([2, 1, 2]) * 1e-3 / EV + np.array([0, 1, 0]) * 1e-3 / (10 * EV),
        rtol=1e-14,
    )
    np.testing.assert_allclose(
        flap(wide, inside, moduli=[EV, E]).compliance(x), flap(wide).compliance(x), rtol=1e-14
    )


def test_two_halves_that_touch_are_one_vein() -> None:
    whole = flap(box(-0.03, -0.01))
    for halves in (
        (box(-0.03, -0.02), box(-0.02, -0.01)),
        (box(-0.03, -0.01, 0.001, 0.002), box(-0.03, -0.01, 0.002, 0.003)),
        ([(-0.03, 0.001), (-0.01, 0.001), (-0.03, 0.003)], [(-0.01, 0.001), (-0.01, 0.003), (-0.03, 0.003)]),
    ):
        model = flap(*halves)
        x = np.linspace(-L, 0, 101) + 1e-5 * np.sign(np.linspace(0.5, -0.5, 101))
        np.testing.assert_allclose(model.compliance(x), whole.compliance(x), rtol=1e-12)
        assert [b.x for b in model.basins()] == pytest.approx([b.x for b in whole.basins()], rel=1e-12)


# --- many vertices, and edges of all slopes


def test_edges_that_are_vertical_but_for_rounding_are_vertical() -> None:
    upright, leaning = box(-0.03, -0.02), box(-0.03, -0.02)
    leaning[[0, 2], 0] = np.nextafter(leaning[[0, 2], 0], [0, -L])
    for model in (flap(leaning), flap(leaning[::-1])):
        assert model.knots.size == 4
        np.testing.assert_allclose(model.left, flap(upright).left, rtol=1e-15)
        np.testing.assert_allclose(model.right, flap(upright).right, rtol=1e-15)
    # the smallest number next to 0 makes a slope beyond all numbers
    (basin,) = flap([(-0.02, 0.001), (0, 0.001), (-5e-324, 0.003), (-0.02, 0.003)]).basins()
    assert (basin.x, basin.width, basin.right) == pytest.approx((-0.035, 0.03, -0.02), rel=1e-12)


def test_twenty_five_thousand_steep_teeth_leave_no_rounding_behind() -> None:
    """A comb with known heights on a sloping back: flanks of slope 1e9 must not spoil the back's slope."""
    n = 25_000
    rng = np.random.default_rng(1)
    pitch = 0.9 * L / n
    foot = -0.95 * L + pitch * np.arange(n)
    height = rng.uniform(0.002, 0.004, n)
    flank = 1e-6 * pitch
    x = foot[:, None] + np.array([0.2 * pitch, 0.2 * pitch + flank, 0.7 * pitch, 0.7 * pitch + flank])
    y = np.column_stack([np.full(n, 0.001), height, height, np.full(n, 0.001)])
    ends = np.array([x[0, 0], x[-1, 3]])
    back = np.array([0.0008, 0.0002])  # falls to the right, so chords grow
    comb = np.vstack([np.column_stack([x.ravel(), y.ravel()]), np.column_stack([ends, back])[::-1]])
    model = flap(comb)
    # at worst 1e5 roundings of eps H add up
    tooth, gap = foot + 0.45 * pitch, foot[1:] - 0.05 * pitch
    chord = height - np.interp(tooth, ends, back)
    np.testing.assert_allclose(model.compliance(tooth), (H - chord) / E + chord / EV, rtol=1e-11)
    chord = 0.001 - np.interp(gap, ends, back)
    np.testing.assert_allclose(model.compliance(gap), (H - chord) / E + chord / EV, rtol=1e-11)
    assert model.compliance(-1e-3) == H / E  # beyond the comb, nothing at all is left
    basins = model.basins()
    assert len(basins) == n + 1
    np.testing.assert_allclose([b.x for b in basins[1:-1]], x[:-1, 3], rtol=0, atol=L / 2**40)
    np.testing.assert_allclose([b.left for b in basins[1:]], x[:, 2], rtol=0, atol=L / 2**40)


def test_a_fine_ellipse_has_one_maximum_and_the_chord_of_an_ellipse() -> None:
    n = 100_000
    angle = 2 * math.pi * np.arange(n) / n
    model = flap(np.column_stack([-0.025 + 0.01 * np.cos(angle), H / 2 + 0.002 * np.sin(angle)]))
    left, right = model.basins()
    assert left.right == pytest.approx(-0.025, abs=1e-6)
    assert left.k_right == right.k_left
    assert left.k_eq == right.k_eq == 1 / (H / E)  # whatever the vein between them rounds to
    x = np.linspace(-0.034, -0.016, 50)
    chord = 0.004 * np.sqrt(1 - ((x + 0.025) / 0.01) ** 2)
    # a side of the polygon misses its arc by (2 pi / n)^2 / 8 = 5e-10 of the radius
    np.testing.assert_allclose(model.compliance(x), (H - chord) / E + chord / EV, rtol=5e-9)
