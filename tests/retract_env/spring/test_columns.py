"""k_eq at given places from plain arrays: the sweep's values, for any scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retract_env.config import config_file
from retract_env.scene import Scene, Tissue, flaps, load_scene, pcg64, sample_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.spring import Stiffness, columns
from tests.retract_env.descriptions import plain
from tests.retract_env.spring.outlines import EV, E, H, L, few

SHIPPED = ("homogeneous", "homogeneous_near", "ten_veins", "twenty_veins", "wide")
DENSE = SceneRanges(veins=(0, 40), vein_modulus=(1e4, 1e7), length=(0.05, 0.2), height=(5e-3, 1e-2))
"""Not much softer than tissue: the sweep moves vertices by up to L / 2^41, which would show."""


def tissue(*veins: tuple[list[tuple[float, float]], float]) -> Tissue:
    """The paper's flap with these outlines and moduli."""
    described = [{"outline": outline, "modulus": modulus} for outline, modulus in veins]
    return Scene.from_data(plain(tissue__veins=described)).tissue


def rectangle(left: float, right: float, low: float, high: float) -> list[tuple[float, float]]:
    return [(left, low), (right, low), (right, high), (left, high)]


def agrees(body: Tissue, x: np.ndarray) -> None:
    """The places asked for, the ends of the flap and every vertex."""
    corners = [x for vein in body.veins for x, _ in vein.outline]
    at = np.sort(np.concatenate([x, [-body.length, 0.0], corners]))
    np.testing.assert_allclose(columns.k_eq(body, at), Stiffness(body).k_eq(at), rtol=1e-9)


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([SceneRanges(), DENSE]))
def test_random_flaps_agree_with_the_sweep(seed: int, ranges: SceneRanges) -> None:
    rng = np.random.default_rng(seed)
    body = sample_scene(rng, ranges).tissue
    agrees(body, rng.uniform(-body.length, 0.0, 200))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_agree_with_the_sweep(name: str) -> None:
    body = load_scene(config_file(name, "scenes")).tissue
    agrees(body, np.linspace(-body.length, 0.0, 501))


def test_vertical_edges_give_the_stiffer_side() -> None:
    """Stiff and soft rectangles, one over the whole height, one up to each end of the flap."""
    soft, stiff = E / 4, EV
    body = tissue(
        (rectangle(-L, -0.04, 0.0, H), stiff),
        (rectangle(-0.035, -0.03, 0.001, 0.003), soft),
        (rectangle(-0.025, -0.02, 0.001, 0.003), stiff),
        (rectangle(-0.01, 0.0, 0.0, 0.002), stiff),
    )
    agrees(body, np.linspace(-L, 0.0, 1001))
    part = H - 0.002
    x = np.array([-L, -0.04, -0.035, -0.0325, -0.03, -0.025, -0.0225, -0.02, -0.015, -0.01, 0.0])
    compliance = [H / stiff] * 2 + [H / E, part / E + 0.002 / soft, H / E]
    compliance += [part / E + 0.002 / stiff] * 3 + [H / E] + [part / E + 0.002 / stiff] * 2
    np.testing.assert_allclose(columns.k_eq(body, x) * compliance, 1.0, rtol=1e-12)


def test_a_flap_drawn_as_arrays_has_the_very_stiffness_of_its_scene() -> None:
    most = DENSE.veins[1]
    for seed in range(20):
        scalars, vertices, offsets, moduli = flaps.room(most)
        row = pcg64.state_of(np.random.default_rng(seed))
        flaps.draw_flap(row, flaps.table(DENSE), scalars, vertices, offsets, moduli)
        length, height, _, modulus, *_ = scalars.tolist()
        x, found = -length * (1 - (np.arange(50) + 0.5) / 50), np.empty(50)
        columns.columns(length, height, modulus, vertices, offsets, moduli, x, found)
        body = sample_scene(np.random.default_rng(seed), DENSE).tissue
        np.testing.assert_array_equal(found, columns.k_eq(body, x))


def test_places_have_to_ascend_within_the_flap() -> None:
    for x in ([-0.01, -0.02], [0.001], [-2 * L], [np.nan], [[-0.01]]):
        with pytest.raises(ValueError, match="allowed ascending numbers in"):
            columns.k_eq(tissue(), np.array(x))
