"""Visibility, strain and security as pure functions: brute force, invariances, known cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from retract_env.objectives import WORST_FRACTION, clearance, required_friction, strain, verdict, worst_mean
from retract_env.scene import LineOfSight

Array = NDArray[np.float64]

values = st.lists(st.tuples(st.floats(0, 2), st.floats(1e-3, 1e3)), min_size=1, max_size=30)
fractions = st.floats(1e-3, 1.0)


def columns(pairs: list[tuple[float, float]]) -> tuple[Array, Array]:
    strains, volumes = np.array(pairs).T
    return strains, volumes


# --- Strain


def test_strain_is_the_largest_change_of_length() -> None:
    assert strain([1.3, 1.0, 0.9]) == pytest.approx(0.3)
    assert strain([1.1, 1.0, 0.6]) == pytest.approx(0.4)
    assert strain([1.0, 1.0, 1.0]) == 0
    assert strain(np.ones((4, 5, 3))).shape == (4, 5)
    assert strain([[[1.2, 1, 1], [1, 1, 0.5]]]) == pytest.approx(np.array([[0.2, 0.5]]))


@given(st.permutations([0.7, 1.05, 1.4]))
def test_strain_does_not_depend_on_the_order_of_stretches(stretches: list[float]) -> None:
    assert strain(stretches) == pytest.approx(0.4)


# --- eps_1%


@settings(deadline=None)
@given(values, fractions)
def test_worst_mean_is_that_of_many_equal_pieces(pairs: list[tuple[float, float]], fraction: float) -> None:
    strains, volumes = columns(pairs)
    # strain of the p-th part of volume, most strained first: the mean over p < fraction is an integral
    order = np.argsort(-strains)
    ends = np.cumsum(volumes[order]) / volumes.sum()
    pieces = 20_000
    p = (np.arange(pieces) + 0.5) / pieces * fraction
    sampled = strains[order][np.minimum(np.searchsorted(ends, p), len(strains) - 1)].mean()
    # each jump of strain is met within one piece
    assert worst_mean(strains, volumes, fraction) == pytest.approx(sampled, abs=2 * len(strains) / pieces)


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_worst_mean_of_what_is_no_strain_is_none(bad: float) -> None:
    """Also where more of it than the fraction is: there is no share of nothing to be had."""
    strains = np.r_[np.full(100, bad), np.full(900, 0.1)]
    assert not np.isfinite(worst_mean(strains, np.ones(1000)))
    assert str(worst_mean(strains, np.ones(1000))) == str(bad)


@given(values, fractions, st.integers(2, 5))
def test_worst_mean_does_not_change_when_elements_are_split(
    pairs: list[tuple[float, float]], fraction: float, parts: int
) -> None:
    strains, volumes = columns(pairs)
    whole = worst_mean(strains, volumes, fraction)
    assert worst_mean(
        np.repeat(strains, parts), np.repeat(volumes / parts, parts), fraction
    ) == pytest.approx(whole, rel=1e-9, abs=1e-12)
    assert worst_mean(strains, 7 * volumes, fraction) == pytest.approx(whole, rel=1e-9, abs=1e-12)
    order = np.random.default_rng(parts).permutation(len(strains))
    assert worst_mean(strains[order], volumes[order], fraction) == pytest.approx(whole, rel=1e-9, abs=1e-12)


@given(values, fractions, st.floats(0, 1))
def test_worst_mean_grows_with_strain_and_shrinks_with_the_fraction(
    pairs: list[tuple[float, float]], fraction: float, more: float
) -> None:
    strains, volumes = columns(pairs)
    now, rounding = worst_mean(strains, volumes, fraction), 1e-12
    raised = strains.copy()
    raised[0] += more
    assert worst_mean(raised, volumes, fraction) >= now - rounding
    assert worst_mean(strains + more, volumes, fraction) == pytest.approx(now + more, abs=1e-9)
    assert worst_mean(strains, volumes, min(1.0, 2 * fraction)) <= now + rounding
    mean = float(strains @ volumes / volumes.sum())
    assert mean - rounding <= now <= strains.max() + rounding


def test_worst_mean_of_a_known_case() -> None:
    # the worst 1 % is all of the 0.5 % at 0.9 and an equal part of what is at 0.1
    assert WORST_FRACTION == 0.01
    assert worst_mean([0.1, 0.9], [99.5, 0.5]) == pytest.approx(0.5)
    assert worst_mean([0.1, 0.9], [98.0, 2.0]) == pytest.approx(0.9)
    assert worst_mean([0.3], [2.0]) == pytest.approx(0.3)
    assert worst_mean([[0.1, 0.9], [0.2, 0.3]], [[1, 1], [1, 1]], 0.5) == pytest.approx(0.6)


# --- Security


def turned(vectors: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    found: Array = vectors @ np.array([[c, s], [-s, c]])
    return found


@given(st.floats(0, 3), st.floats(-math.pi, math.pi), st.floats(1e-6, 1e3), st.booleans())
def test_required_friction_is_tangential_over_normal_in_any_frame(
    ratio: float, angle: float, push: float, other_way: bool
) -> None:
    # lower jaw: the tissue presses it down, the normal points up into the tissue
    reaction = np.array([(-1 if other_way else 1) * ratio * push, -push])
    normal = np.array([0.0, 1.0])
    found = required_friction(turned(reaction, angle), turned(normal, angle))
    assert found == pytest.approx(ratio, rel=1e-12, abs=1e-12)


def test_a_jaw_that_pulls_or_does_not_touch_needs_infinite_friction() -> None:
    up = np.array([0.0, 1.0])
    assert required_friction([0.0, 0.1], up) == math.inf
    assert required_friction([0.1, 0.1], up) == math.inf
    assert required_friction([0.1, 0.0], up) == math.inf
    assert required_friction([0.0, 0.0], up) == math.inf
    assert required_friction([0.0, -0.1], up) == 0
    assert required_friction([0.0, -0.1], -up) == math.inf


def test_both_jaws_are_judged_at_once() -> None:
    reactions = np.array([[[0.03, -0.1], [0.02, 0.1]], [[0.0, 0.1], [0.05, 0.05]]])
    normals = np.array([[0.0, 1.0], [0.0, -1.0]])
    expected = np.array([[0.3, 0.2], [math.inf, 1.0]])
    assert required_friction(reactions, normals) == pytest.approx(expected)


# --- Visibility


@given(st.floats(-0.04, -0.001), st.floats(0.05, math.pi / 2), st.floats(-0.05, 0.05), st.floats(-0.05, 0.1))
def test_clearance_is_the_signed_distance_to_the_line(
    target: float, slope: float, distance: float, along: float
) -> None:
    line = LineOfSight.at(target, slope)
    direction = np.array([-math.cos(slope), math.sin(slope)])
    away = np.array([math.sin(slope), math.cos(slope)])  # towards the fixed end, and up
    point = np.array(line.target) + along * direction + distance * away
    assert clearance(point, line.camera, line.target) == pytest.approx(distance, abs=1e-14)


def test_clearance_is_that_of_the_lowest_point() -> None:
    line = LineOfSight.at(-0.0125, math.pi / 4)
    at_fixed_end, in_the_way = [0.0, 0.0], [-0.04, 0.002]
    assert clearance([at_fixed_end], line.camera, line.target) == pytest.approx(0.0125 / math.sqrt(2))
    assert clearance([in_the_way], line.camera, line.target) == pytest.approx(-0.0255 / math.sqrt(2))
    grid = np.array([[at_fixed_end, in_the_way], [at_fixed_end, at_fixed_end]])
    assert clearance(grid, line.camera, line.target) == pytest.approx(-0.0255 / math.sqrt(2))
    assert clearance([line.target], line.camera, line.target) == 0


def test_the_flap_at_rest_hides_the_target_and_a_steep_line_sees_past_the_fixed_end_only() -> None:
    rest = np.array([[-0.05, 0.0], [0.0, 0.0], [0.0, 0.0044], [-0.05, 0.0044]])
    for slope in (0.2, math.pi / 4, math.pi / 2):
        line = LineOfSight.at(-0.0125, slope)
        # the free end's lower corner is deepest below the line
        expected = -0.0375 * math.sin(slope)
        assert clearance(rest, line.camera, line.target) == pytest.approx(expected, rel=1e-12)


def test_the_cameras_distance_does_not_matter() -> None:
    point = [-0.02, 0.03]
    near, far = (LineOfSight.at(-0.0125, 0.7, distance) for distance in (0.05, 1.0))
    assert clearance(point, near.camera, near.target) == pytest.approx(
        clearance(point, far.camera, far.target)
    )


@pytest.mark.parametrize("weaker", [0, 1])
def test_the_verdict_is_that_of_the_jaw_which_needs_more(weaker: int) -> None:
    friction = np.array([0.1, 0.1])
    assert verdict(0.1, friction, 1.0, 0.5, 0.5) == "ok"
    friction[weaker] = 0.6
    assert verdict(0.1, friction, 1.0, 0.5, 0.5) == "slip"
    friction[weaker] = np.inf
    assert verdict(0.1, friction, 1.0, 0.5, 0.5) == "release"
