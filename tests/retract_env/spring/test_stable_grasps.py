"""Stable grasps of the spring model: the stated special cases, energy balance, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from retract_env.scene import Tissue, Vein
from retract_env.spring import SpringModel, optimal_compression
from tests.retract_env.spring.outlines import EV, Array, E, H, L, Outlines, box, few, flap, scenes

# --- stable grasps


def test_between_two_veins_one_grasp_at_the_middle() -> None:
    model = flap(box(-0.04, -0.035), box(-0.02, -0.015, 0.001, 0.0025))
    free, between, fixed = model.basins()
    assert between.x == pytest.approx(-0.0275, rel=1e-15)
    assert between.width == pytest.approx(0.015, rel=1e-12)
    assert between.k_eq == E / H
    assert between.k_n == between.k_right < between.k_left  # the shorter chord is the weaker way out
    assert between.escape == between.k_right - between.k_eq > 0
    assert [g.x for g in model.stable_grasps()] == [between.x, fixed.x, free.x]


def test_free_end_leaves_nothing_to_climb_and_the_fixed_end_is_a_wall() -> None:
    model = flap(box(-0.03, -0.02))
    free, fixed = model.basins()
    assert (free.x, fixed.x) == pytest.approx((-0.04, -0.01))
    assert free.escape == 0
    assert free.k_n == free.k_eq
    assert fixed.k_right == math.inf
    assert fixed.k_n == fixed.k_left == free.k_right
    at_fixed, at_free = model.stable_grasps()
    assert at_fixed.x == fixed.x
    assert at_free.compression == pytest.approx(
        0.5 * H / 2, rel=1e-15
    )  # k_n = k_eq, as in homogeneous tissue


def test_a_vein_at_the_free_end_is_climbed_like_any_other() -> None:
    free_vein = flap(box(-L, -0.04), box(-0.02, -0.01))
    between = free_vein.basins()[0]
    assert between.x == pytest.approx(-0.03)
    assert between.k_left == pytest.approx(between.k_right)
    assert between.escape > 0


def test_waist_of_a_stiff_vein_and_a_soft_inclusion_are_stable() -> None:
    waist = [
        (-0.03, 0.0005),
        (-0.025, 0.0015),
        (-0.02, 0.0005),
        (-0.02, 0.0035),
        (-0.025, 0.0025),
        (-0.03, 0.0035),
    ]
    middle = flap(waist).basins()[1]
    assert (middle.x, middle.width) == (-0.025, 0)
    assert middle.k_eq == pytest.approx(1 / ((H - 0.001) / E + 0.001 / EV), rel=1e-12)
    assert middle.k_n == pytest.approx(1 / ((H - 0.003) / E + 0.003 / EV), rel=1e-12)

    soft = flap(box(-0.03, -0.02), moduli=E / 4)
    (basin,) = soft.basins()
    assert (basin.x, basin.left, basin.right) == pytest.approx((-0.025, -0.03, -0.02))
    assert basin.k_left == basin.k_right == E / H  # the level tissue on both sides is the maximum
    assert [g.x for g in soft.stable_grasps()] == [basin.x]


def wavy_layer() -> Array:
    """From end to end, 1 mm thick everywhere: its chord is the difference of two bent lines."""
    rng = np.random.default_rng(3)
    x, y = np.linspace(-L, 0, 1000), rng.uniform(0.001, 0.002, 1000)
    return np.vstack([np.column_stack([x, y]), np.column_stack([x, y + 0.001])[::-1]])


@pytest.mark.parametrize("veins", [[], [box(-L, 0.0)], [wavy_layer()]], ids=["none", "layer", "wavy layer"])
def test_tissue_without_extrema_is_sampled_uniformly(veins: list[ArrayLike]) -> None:
    model = flap(*veins)
    (basin,) = model.basins()
    assert (basin.x, basin.width, basin.escape) == (-L / 2, L, 0)
    grasps = model.stable_grasps()
    # Fig. 8: ten grasps; the farthest stands half a jaw inside the free end
    assert [g.x for g in grasps] == pytest.approx([-0.0495, *(-0.005 * np.arange(9, 0, -1))])
    assert [g.compression for g in grasps] == pytest.approx([0.25 * H] * 10, rel=1e-12)  # eps_L h / 2
    assert [g.score for g in grasps] == pytest.approx([basin.k_eq * (0.25 * H) ** 2 / 2] * 10, rel=1e-12)
    assert len(model.stable_grasps(samples=50)) == 50  # Fig. 12
    crowded = [g.x for g in model.stable_grasps(samples=500)]
    assert len(set(crowded)) == len(crowded) < 500
    assert (min(crowded), max(crowded)) == (-L + 5e-4, -5.5e-4)


def test_a_vein_as_soft_as_the_tissue_is_no_vein() -> None:
    assert len(flap(box(-0.03, -0.02), moduli=E).basins()) == 1
    assert len(flap(box(-0.03, -0.02), moduli=E).stable_grasps(samples=7)) == 7


def test_jaws_fit_on_the_flap() -> None:
    wedge = [(-L, 0.002), (0, 0.001), (0, 0.004)]  # softest at the very free end
    (grasp,) = flap(wedge).stable_grasps(jaw_width=2e-3)
    assert grasp.x == -L + 1e-3
    # there the chord is 1/50 of 3 mm, and still nothing lies beyond: k_n = k_eq
    chord = 0.02 * 0.003
    k = 1 / ((H - chord) / E + chord / EV)
    assert grasp.compression == pytest.approx(0.25 * H, rel=1e-12)
    assert grasp.score == pytest.approx(k * (0.25 * H) ** 2 / 2, rel=1e-9)

    (other,) = flap(np.array(wedge) * [-1, 1] - [L, 0]).stable_grasps(jaw_width=2e-3)
    assert other.x == pytest.approx(-1.1e-3)  # the patch keeps off the fixed end
    k_n = 1 / ((H - 0.003) / E + 0.003 / EV)  # the maximum at the free end's edge; at the other end a wall
    assert other.score == pytest.approx(k_n * other.compression**2 / 2, rel=1e-9)

    # a gap of 0.2 mm at the free end: a jaw of 1 mm there would stand on the vein
    narrow = flap(box(-L + 2e-4, -0.03))
    assert len(narrow.basins()) == 2
    assert [g.x for g in narrow.stable_grasps()] == pytest.approx([-0.015])


@few
@given(scenes, st.floats(0.01, 0.99))
def test_compression_balances_the_two_energies(veins: tuple[Outlines, list[float]], limit: float) -> None:
    model = flap(*veins[0], moduli=veins[1])
    grasps = model.stable_grasps(strain_limit=limit)
    # U_n = k_n delta^2 / 2 gives k_n back; U_L = k_eq (eps_L h - delta)^2 / 2 must be the same (Eq. 3, 4)
    for grasp in grasps:
        assert 0 < grasp.compression <= limit * H / 2 * (1 + 1e-12)
        k_n = 2 * grasp.score / grasp.compression**2
        k_eq = k_n * (grasp.compression / (limit * H - grasp.compression)) ** 2
        beside = [b for b in model.basins() if b.left < grasp.x < b.right]
        if beside and grasp.x == beside[0].x:
            assert k_eq == pytest.approx(beside[0].k_eq, rel=1e-9)
            assert k_n == pytest.approx(beside[0].k_n, rel=1e-9)
        assert -L + 5e-4 <= grasp.x <= -5e-4
    assert [g.score for g in grasps] == sorted((g.score for g in grasps), reverse=True)


def test_stiffer_neighbours_allow_less_compression_and_score_higher() -> None:
    k_n = np.geomspace(1, 1e4, 50)
    delta = optimal_compression(1.0, k_n, H, 0.5)
    assert delta[0] == 0.5 * H / 2
    assert (np.diff(delta) < 0).all()
    assert (np.diff(k_n * delta**2) > 0).all()


# --- the tissue of a scene, and bad input


def test_tissue_of_a_scene_is_swept_like_its_outlines() -> None:
    outlines = [box(-0.04, -0.03), np.array([(-0.02, 0.001), (-0.01, 0.001), (-0.014, 0.004)])]
    moduli = [EV, 3 * EV]
    veins = tuple(
        Vein(outline=tuple((float(x), float(y)) for x, y in o), modulus=m)
        for o, m in zip(outlines, moduli, strict=True)
    )
    tissue = Tissue(length=L, height=H, depth=H, density=1000.0, modulus=E, poisson=0.45, veins=veins)
    model, other = SpringModel(tissue), flap(*outlines, moduli=moduli)
    np.testing.assert_array_equal(model.knots, other.knots)
    np.testing.assert_array_equal(model.left, other.left)
    np.testing.assert_array_equal(model.right, other.right)
    assert model.stable_grasps() == other.stable_grasps()


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        (box(-0.06, -0.02), "leaves the flap"),
        (box(-0.02, -0.01, 0.001, math.nan), "leaves the flap"),
        ([(-0.03, 0.001), (-0.02, 0.003), (-0.02, 0.001), (-0.03, 0.003)], "crosses itself"),
        ([(-0.03, 0.001), (-0.02, 0.001), (-0.01, 0.001)], "no area"),
        ([(-0.03, 0.001), (-0.02, 0.001)], "shape"),
    ],
)
def test_bad_outlines_are_named_in_one_line(outline: ArrayLike, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        flap(box(-0.03, -0.02), outline)
    assert str(error.value).startswith("outlines[1]")
    assert "\n" not in str(error.value)


def test_bad_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="height = -1"):
        SpringModel.from_outlines(L, -1.0, E, [], [])
    with pytest.raises(ValueError, match="moduli"):
        flap(box(-0.03, -0.02), moduli=[0.0])
    with pytest.raises(ValueError, match="moduli"):
        flap(box(-0.03, -0.02), moduli=[EV, EV])
    model = flap(box(-0.03, -0.02))
    for x in (-0.06, 0.01, math.nan):
        with pytest.raises(ValueError, match="x = "):
            model.k_eq(x)
    with pytest.raises(ValueError, match="strain_limit"):
        model.stable_grasps(strain_limit=0.0)
    with pytest.raises(ValueError, match="jaw_width"):
        model.stable_grasps(jaw_width=0.06)
    with pytest.raises(ValueError, match="samples"):
        model.stable_grasps(samples=0)
