"""What the camera sees of the bed, and the decision on a state: exact shadows, rays one by one, laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from retract_env.objectives import bed_hits, clearance, exposure, seen_spans, verdict

Array = NDArray[np.float64]

A = np.array([-0.08, 0.07])
NEAR, B = -0.05, np.array([-0.0125, 0.0])

few = settings(max_examples=60, deadline=None)


def ring(*points: tuple[float, float]) -> Array:
    return np.array([*points, points[0]])


def box(left: float, right: float, low: float, high: float) -> Array:
    return ring((left, low), (right, low), (right, high), (left, high))


@st.composite
def outlines(draw: st.DrawFn) -> Array:
    """Star-shaped outlines anywhere above the bed, the camera outside, some reaching past its height."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    corners = int(rng.integers(3, 12))
    angle = np.sort(rng.uniform(0, math.tau, corners))
    reach = rng.uniform(0.002, 0.05, corners)
    middle = np.array([rng.uniform(-0.06, 0.01), rng.uniform(0.0, 0.08)])
    points = middle + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points[:, 1] = np.maximum(points[:, 1], 0.0)
    polygon = shapely.Polygon(points)
    assume(polygon.is_valid and polygon.distance(shapely.Point(A)) > 1e-3)
    return np.vstack([points, points[:1]])


# --- Exposure


def test_a_post_casts_the_shadow_of_its_upper_far_corner() -> None:
    left, right, high = -0.04, -0.035, 0.01
    seen = exposure(box(left, right, 0.0, high), A, B, NEAR)
    shadow_end = A[0] + (right - A[0]) * A[1] / (A[1] - high)
    assert seen == pytest.approx(1 - (shadow_end - left) / (B[0] - NEAR), rel=1e-12)


def test_a_bar_in_the_air_casts_the_shadow_of_two_opposite_corners() -> None:
    left, right, low, high = -0.06, -0.05, 0.03, 0.035
    ends = [A[0] + (x - A[0]) * A[1] / (A[1] - y) for x, y in ((left, low), (right, high))]
    spans = seen_spans(box(left, right, low, high), A, NEAR, B[0])
    assert spans == pytest.approx(np.array([[NEAR, ends[0]], [ends[1], B[0]]]), rel=1e-12)


@pytest.mark.parametrize(
    ("outline", "seen"),
    [
        (box(-0.05, 0.0, 0.0, 0.0044), 0.0),
        (box(-0.0125, 0.0, 0.0, 0.0044), 1.0),
        (box(-0.0125, 0.0, -1e-5, 0.0044), 1.0),
        (box(0.0, 0.05, 0.0, 0.03), 1.0),
        (box(-0.05, -0.0125, 0.08, 0.09), 1.0),
        (box(-0.05, -0.0125, -1e-5, 0.001), 0.0),
        (box(-0.079, -0.0785, 0.0, 0.2), 0.0),
        (box(-0.09, -0.085, 0.0, 0.2), 1.0),
    ],
    ids=[
        "flat",
        "behind B",
        "a little in the bed",
        "right of B",
        "above the camera",
        "in the way, in the bed",
        "wall",
        "wall behind",
    ],
)
def test_all_or_nothing(outline: Array, seen: float) -> None:
    assert exposure(outline, A, B, NEAR) == pytest.approx(seen, abs=1e-12)


def test_an_edge_that_rises_past_the_camera_hides_the_bed_to_that_side() -> None:
    """Behind a wall that leans over the camera's height nothing is seen, whichever side its top is on."""
    foot = -0.03
    for top in (-0.2, 0.05):
        wall = np.array([[foot, 0.0], [top, 0.5]])
        level = foot + (top - foot) * A[1] / 0.5
        hidden = (foot, B[0]) if level > A[0] else (NEAR, foot)
        assert exposure(wall, A, B, NEAR) == pytest.approx(
            1 - (hidden[1] - hidden[0]) / (B[0] - NEAR), rel=1e-12
        )


@few
@given(outlines())
def test_it_is_what_rays_one_by_one_find(outline: Array) -> None:
    n = 400
    targets = NEAR + (B[0] - NEAR) * (np.arange(n) + 0.5) / n
    rays = shapely.linestrings([[A.tolist(), [x, 0.0]] for x in targets.tolist()])
    seen = ~shapely.intersects(shapely.Polygon(outline), rays)
    # a shadow's edge misplaces one ray at most; an outline of 12 corners has no more than 12 shadows
    assert exposure(outline, A, B, NEAR) == pytest.approx(seen.mean(), abs=24 / n)


@few
@given(outlines())
def test_tissue_above_the_line_of_sight_hides_nothing(outline: Array) -> None:
    along = (A - B) / np.hypot(*(A - B))
    lifted = outline + max(0.0, -clearance(outline, A, B)) * np.array([along[1], -along[0]]) * (1 + 1e-9)
    assert clearance(lifted, A, B) >= -1e-12
    assert exposure(lifted, A, B, NEAR) == pytest.approx(1.0, abs=1e-9)


@few
@given(outlines(), st.floats(0.1, 10.0))
def test_how_it_is_drawn_does_not_matter(outline: Array, scale: float) -> None:
    seen = exposure(outline, A, B, NEAR)
    edges = np.stack([outline[:-1], (outline[:-1] + outline[1:]) / 2, outline[1:]], axis=1)
    for other in (outline[::-1], edges, edges[::-1, ::-1]):
        assert exposure(other, A, B, NEAR) == pytest.approx(seen, abs=1e-9)
    assert exposure(scale * outline, scale * A, scale * B, scale * NEAR) == pytest.approx(seen, abs=1e-9)


@few
@given(outlines(), outlines())
def test_more_tissue_hides_more_and_spans_are_in_order(one: Array, other: Array) -> None:
    both = np.concatenate([np.stack([o[:-1], o[1:]], axis=1) for o in (one, other)])
    least = min(exposure(one, A, B, NEAR), exposure(other, A, B, NEAR))
    assert exposure(both, A, B, NEAR) <= least + 1e-12
    spans = seen_spans(both, A, NEAR, B[0])
    assert (np.diff(spans.ravel()) > 0).all()
    assert ((spans >= NEAR) & (spans <= B[0])).all()


def test_rays_meet_the_bed_where_lines_do() -> None:
    points = np.array([[[0.0, 0.035], [-0.08, 0.03]], [[0.0, 0.07], [-0.1, 0.09]]])
    assert bed_hits(points, A) == pytest.approx(np.array([[0.08, -0.08], [np.inf, -np.inf]]), abs=1e-15)


# --- Verdict


@pytest.mark.parametrize(
    ("strain", "friction", "clear", "expected"),
    [
        (0.1, 0.1, -0.01, None),
        (0.1, 0.1, 0.0, "ok"),
        (0.5, 0.5, 0.01, "ok"),
        (0.5 + 1e-12, 0.1, 0.01, "strain"),
        (0.6, math.inf, 0.01, "strain"),
        (0.1, math.inf, 0.01, "release"),
        (0.1, 0.5 + 1e-12, 0.01, "slip"),
        (0.1, [0.1, 0.6], -0.01, "slip"),
        (0.1, [math.inf, 0.6], -0.01, "release"),
        (0.1, 0.0, -1e-12, None),
    ],
)
def test_limits_come_before_success(
    strain: float, friction: float | list[float], clear: float, expected: str | None
) -> None:
    assert verdict(strain, friction, clear, strain_limit=0.5, friction_limit=0.5) == expected
