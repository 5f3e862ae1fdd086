"""Jaw paths: published radii, arcs of constant length, rigid turns, straight lines, stated ends."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from planners.paths import (
    INCREMENTS,
    LONGEST,
    MOST_STRETCH,
    MOST_SWING,
    MOST_TURN,
    arc_curvature,
    arc_turn,
    circular,
    circular_motion,
    ctc,
    ctc_motion,
    goal_radius,
    goal_turn,
    linear,
    linear_motion,
)
from retract_env.grasp import Grasp, JawPath, to_jaws, to_pose
from retract_env.scene import LineOfSight, Scene, Tissue

Array = NDArray[np.float64]

EPS = np.finfo(float).eps
LENGTH, HEIGHT = 0.05, 0.0044
FIXED = np.array([0.0, HEIGHT / 2])
# a coordinate below 0.1 m is the outcome of a few operations, each rounding by half an eps
ROUNDING = 8 * EPS * 0.1

Point = tuple[float, float]
Planner = Callable[[Scene, Grasp], JawPath]
PLANNERS: list[Planner] = [
    ctc,
    circular,
    lambda scene, grasp: linear(scene, grasp, math.radians(60)),
    lambda scene, grasp: linear(scene, grasp, math.radians(75)),
]
every_path = pytest.mark.parametrize("planner", PLANNERS, ids=["ctc", "circular", "linear60", "linear75"])
grasps = st.builds(Grasp, st.floats(-LENGTH, -0.002), st.floats(0.02, 0.9).map(lambda part: part * HEIGHT))
lines = st.tuples(st.floats(0.02, 0.98), st.floats(0.02, math.pi / 2))


def a_scene(nearness: float = 0.25, slope: float = math.pi / 4) -> Scene:
    """The paper's homogeneous flap, B at `nearness` of its length from the fixed end."""
    return Scene(
        name="test",
        tissue=Tissue(length=LENGTH, height=HEIGHT, depth=0.0044, density=1000.0, modulus=40e3, poisson=0.45),
        line_of_sight=LineOfSight.at(-nearness * LENGTH, slope),
    )


def a_grasp(x: float = -0.03) -> Grasp:
    return Grasp(x, 0.25 * HEIGHT)


def radius(scene: Scene) -> float:
    return goal_radius(scene.line_of_sight.camera, scene.line_of_sight.target)


def arc_of(path: JawPath) -> tuple[Array, Array]:
    """Radius and angle, during the motion, of the arcs that leave (0, h/2) level and end at the midpoint."""
    x, y = (path.poses[2:, :2] - FIXED).T
    return (x**2 + y**2) / (2 * y), 2 * np.arctan2(y, -x)


def distance(point: Array, camera: Array, target: Array) -> Array:
    """From line AB, positive on the fixed end's side."""
    along = target - camera
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return np.asarray((point - target) @ normal)


# --- Eq. 6


@pytest.mark.parametrize(("target", "millimetres"), [(-0.0125, 30.18), (-0.0075, 18.11)])
def test_goal_radius_of_the_paper_s_lines(target: float, millimetres: float) -> None:
    for length in (0.03, 0.1, 2.0):  # where on the line the camera sits does not matter
        camera = (target - length, length)
        assert round(1000 * goal_radius(camera, (target, 0.0)), 2) == millimetres


def test_goal_circle_touches_bed_and_line_of_sight() -> None:
    rng = np.random.default_rng(6)
    for slope, back, length in rng.uniform([0.02, 1e-4, 0.01], [math.pi / 2, 0.2, 1.0], (10_000, 3)):
        target = np.array([-back, 0.0])
        camera = target + length * np.array([-math.cos(slope), math.sin(slope)])
        r = goal_radius(camera, target)
        # centre (0, r), so the bed is at distance r; the line is, with both terms of the distance below r
        assert distance(np.array([0.0, r]), camera, target) == pytest.approx(r, rel=64 * EPS / slope)
        # the same circle from the angle that line and bed enclose at B
        assert r == pytest.approx(back / math.tan(slope / 2), rel=64 * EPS / slope)


@pytest.mark.parametrize(("camera", "target"), [((-0.1, 0.0), (-0.01, 0.0)), ((-0.1, 0.1), (0.0, 0.0))])
def test_lines_without_a_goal_circle_are_refused(camera: Point, target: Point) -> None:
    with pytest.raises(ValueError, match=r"line_of_sight\.\w+ \w = .* m, allowed"):
        goal_radius(camera, target)


# --- every path


@every_path
@given(line=lines, grasp=grasps)
def test_every_path_squeezes_then_moves_at_that_separation(
    planner: Planner, line: Point, grasp: Grasp
) -> None:
    path = planner(a_scene(*line), grasp)
    half = grasp.compression / 2
    np.testing.assert_array_equal(path.waypoints[0], [grasp.x, 0, grasp.x, HEIGHT])
    np.testing.assert_allclose(
        path.waypoints[1], [grasp.x, half, grasp.x, HEIGHT - half], rtol=0, atol=2 * EPS * HEIGHT
    )
    np.testing.assert_allclose(path.poses[1:, 3], HEIGHT - grasp.compression, rtol=0, atol=ROUNDING)
    assert (np.diff(path.poses[1:, 2]) < 0).all()  # turns clockwise, over towards the fixed end
    assert (path.waypoints[1:, 1] >= half - ROUNDING).all()  # never into the bed
    assert 3 <= len(path) <= 2 + LONGEST * INCREMENTS


@every_path
def test_jaws_and_poses_say_the_same(planner: Planner) -> None:
    path = planner(a_scene(), a_grasp())
    np.testing.assert_allclose(to_jaws(path.poses), path.waypoints, rtol=0, atol=ROUNDING)
    turned = np.exp(1j * to_pose(path.waypoints)[:, 2])
    np.testing.assert_allclose(np.exp(1j * path.poses[:, 2]), turned, rtol=0, atol=16 * EPS)


@every_path
def test_twice_the_increments_pass_through_the_same_poses(planner: Planner) -> None:
    name = planner(a_scene(), a_grasp()).kind
    coarse, fine = (
        linear(a_scene(), a_grasp(), math.radians(float(name[6:])), n)
        if name.startswith("linear")
        else {"ctc": ctc, "circular": circular}[name](a_scene(), a_grasp(), n)
        for n in (24, 48)
    )
    shared = fine.waypoints[1::2][: len(coarse) - 1]
    np.testing.assert_allclose(coarse.waypoints[1:], shared, rtol=0, atol=ROUNDING)
    # between them the coarse path cuts corners by the sagitta of its steps, no more
    step = np.hypot(*np.diff(coarse.poses[1:, :2], axis=0).T).max()
    turn = np.abs(np.diff(coarse.poses[1:, 2])).max()
    halfway = coarse.jaws_at(np.arange(1, coarse.last) + 0.5)
    np.testing.assert_allclose(halfway, fine.waypoints[2::2][: len(halfway)], rtol=0, atol=step * turn / 4)


@every_path
def test_a_scaled_flap_gets_the_scaled_path(planner: Planner) -> None:
    scene, grasp = a_scene(), a_grasp()
    half = scene.model_copy(
        update={
            "tissue": scene.tissue.model_copy(update={"length": LENGTH / 2, "height": HEIGHT / 2}),
            "line_of_sight": LineOfSight.at(-LENGTH / 8, math.pi / 4),
        }
    )
    scaled = planner(half, Grasp(grasp.x / 2, grasp.compression / 2)).waypoints
    np.testing.assert_allclose(2 * scaled, planner(scene, grasp).waypoints, rtol=0, atol=4 * ROUNDING)


@every_path
@pytest.mark.parametrize(
    ("grasp", "message"),
    [
        (Grasp(-0.06, 0.001), r"grasp\.x = -0\.06 m, allowed \[-0\.05, 0\) m"),
        (Grasp(-0.02, HEIGHT), r"grasp\.compression = 0\.0044 m, allowed \(0, 0\.0044\) m"),
        (Grasp(-0.02, 0.01), r"grasp\.compression = 0\.01 m"),
    ],
)
def test_a_grasp_off_the_flap_is_refused(planner: Planner, grasp: Grasp, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        planner(a_scene(), grasp)


@pytest.mark.parametrize("planner", [ctc, circular])
def test_at_least_one_increment(planner: Callable[[Scene, Grasp, int], JawPath]) -> None:
    assert len(planner(a_scene(), a_grasp(), 1)) >= 3
    with pytest.raises(ValueError, match="increments = 0, allowed at least 1"):
        planner(a_scene(), a_grasp(), 0)


def test_motions_leave_the_squeezed_grasp_without_a_jump() -> None:
    arc, slope, step = 0.03, math.radians(60), 1e-9
    motions: dict[Callable[..., Array], tuple[float, float, float]] = {
        ctc_motion: (0.0, arc / 2, -1.0),
        circular_motion: (0.0, arc, -1.0),
        lambda way, arc, height: linear_motion(way, arc, height, slope): (
            math.cos(slope),
            math.sin(slope),
            -math.sin(slope) / arc,
        ),
    }
    for motion, speed in motions.items():
        np.testing.assert_array_equal(motion(0.0, arc, HEIGHT), [-arc, HEIGHT / 2, 0.0])
        # second order: the step squared, over lengths no shorter than arc^2
        moved = motion(step, arc, HEIGHT) - motion(0.0, arc, HEIGHT)
        np.testing.assert_allclose(moved, step * np.array(speed), rtol=0, atol=(step / arc) ** 2 + EPS * arc)


# --- CTC


@pytest.mark.parametrize("nearness", [0.25, 0.15])
@pytest.mark.parametrize("x", [-0.01, -0.025, -0.04, -0.05])
def test_ctc_is_the_paper_s_trajectory(nearness: float, x: float) -> None:
    scene, grasp = a_scene(nearness), a_grasp(x)
    path = ctc(scene, grasp)
    assert path.kind == "ctc"
    for t, jaws in enumerate(path.waypoints[2:], start=1):
        r = radius(scene) * INCREMENTS / t
        phi = -x / (r - HEIGHT / 2)
        near, far = r - grasp.compression / 2, r - HEIGHT + grasp.compression / 2
        sin, cos = math.sin(phi), math.cos(phi)
        printed = [-near * sin, r - near * cos, -far * sin, r - far * cos]
        # as printed, two numbers of size r are subtracted
        np.testing.assert_allclose(jaws, printed, rtol=0, atol=8 * EPS * (r + 0.1))


@given(line=lines, grasp=grasps)
def test_ctc_keeps_the_length_of_the_medial_axis(line: Point, grasp: Grasp) -> None:
    path = ctc(a_scene(*line), grasp)
    radii, angles = arc_of(path)
    # the rise above (0, h/2) is a difference of coordinates
    rise = path.poses[2, 1] - HEIGHT / 2
    rounding = 16 * EPS * (1 + 0.1 / rise)
    np.testing.assert_allclose(radii * angles, -grasp.x, rtol=rounding)
    # and the jaws' axis stays normal to it
    rounding += 2 * ROUNDING / path.poses[1, 3]
    np.testing.assert_allclose(-path.poses[2:, 2], angles, rtol=0, atol=rounding)


def test_ctc_raises_curvature_in_equal_steps_and_meets_the_goal_circle() -> None:
    scene = a_scene()
    path = ctc(scene, a_grasp(-0.04))
    radii, _ = arc_of(path)
    curvature = 1 / (radii + HEIGHT / 2)
    steps = np.arange(1, len(path) - 1)
    np.testing.assert_allclose(curvature * radius(scene) * INCREMENTS, steps, rtol=1e-11)
    assert len(path) > 2 + INCREMENTS  # runs on past T


def test_ideal_flap_clears_the_line_of_sight_exactly_from_the_goal_on() -> None:
    scene = a_scene()
    camera, target = np.array(scene.line_of_sight.camera), np.array(scene.line_of_sight.target)
    angles = np.linspace(0, MOST_TURN, 100_001)
    least = []
    for r in radius(scene) * np.array([1.25, 1.0, 0.8]):
        lower = angles[angles <= arc_turn(1 / r, 0.04, HEIGHT)]
        surface = np.stack([-r * np.sin(lower), r - r * np.cos(lower)], axis=-1)
        least.append(distance(surface, camera, target).min())
    sagitta = radius(scene) * (angles[1] - angles[0]) ** 2 / 8
    assert least[0] < 0 < least[2]
    assert -ROUNDING <= least[1] <= sagitta


@pytest.mark.parametrize(
    ("x", "line", "limit"),
    [
        (-0.01, (0.25, math.pi / 4), "radius"),
        (-0.04, (0.25, math.pi / 4), "turn"),
        (-0.05, (0.1, math.pi / 2), "turn"),  # the goal circle is too small for a flap this long
        (-0.005, (0.02, math.pi / 2), "radius"),  # and here for one this thick
    ],
)
def test_ctc_ends_where_the_arc_can_go_no_further(x: float, line: Point, limit: str) -> None:
    scene = a_scene(*line)
    path = ctc(scene, a_grasp(x))
    radii, angles = arc_of(path)
    curvature = 1 / (radii + HEIGHT / 2)
    after = 2 * curvature[-1] - curvature[-2]
    assert curvature[-1] <= (1 + 1e-9) / HEIGHT
    assert angles[-1] <= MOST_TURN * (1 + 1e-9)
    if limit == "radius":
        assert after > (1 - 1e-9) / HEIGHT
    else:
        assert arc_turn(after, -x, HEIGHT) > MOST_TURN * (1 - 1e-9)
    if radius(scene) < 1 / curvature[-1] * (1 - 1e-9):
        assert len(path) == 2 + INCREMENTS


def test_a_nearly_flat_line_makes_longer_steps_rather_than_a_longer_path() -> None:
    scene = a_scene(0.5, 0.02)
    path = ctc(scene, a_grasp(), 2 * INCREMENTS)
    radii, _ = arc_of(path)
    assert len(path) <= 2 + LONGEST * 2 * INCREMENTS
    assert np.isclose(radii + HEIGHT / 2, radius(scene), rtol=1e-9).any()  # R_g is still a waypoint
    assert len(circular(scene, a_grasp())) <= 2 + LONGEST * INCREMENTS


@given(st.floats(1e-9, 1.9 / HEIGHT), st.floats(1e-3, LENGTH))
def test_curvature_and_turn_are_inverse(curvature: float, arc: float) -> None:
    # at 1.9 / h the denominator of the turn is 0.05, which loses a factor of 20
    back = arc_curvature(arc_turn(curvature, arc, HEIGHT), arc, HEIGHT)
    assert back == pytest.approx(curvature, rel=100 * EPS, abs=0)


# --- circular


def test_circular_turns_the_grasp_rigidly_by_equal_angles() -> None:
    scene, grasp = a_scene(0.25, math.radians(50)), a_grasp()
    path = circular(scene, grasp)
    assert path.kind == "circular"
    angles = -path.poses[1:, 2]
    equal = math.radians(50) / INCREMENTS * np.arange(len(angles))
    np.testing.assert_allclose(angles, equal, rtol=0, atol=2 * ROUNDING / (HEIGHT - grasp.compression))
    complex_jaws = path.waypoints[1:].reshape(-1, 2, 2) @ [1, 1j] - 1j * HEIGHT / 2
    turned = complex_jaws[0] * np.exp(-1j * angles)[:, None]
    np.testing.assert_allclose(complex_jaws, turned, rtol=0, atol=2 * ROUNDING)


def test_circular_passes_the_pose_parallel_to_the_line_of_sight_and_goes_on() -> None:
    scene = a_scene(0.25, math.radians(50))
    path = circular(scene, a_grasp())
    reach = path.poses[1 + INCREMENTS, :2] - FIXED
    along = np.subtract(scene.line_of_sight.camera, scene.line_of_sight.target)
    assert abs(np.linalg.det([reach, along])) <= 16 * EPS * math.hypot(*reach) * math.hypot(*along)
    step = math.radians(50) / INCREMENTS
    assert MOST_SWING - step < -path.poses[-1, 2] <= MOST_SWING + 1e-9


# --- linear


@pytest.mark.parametrize("degrees", [5, 30, 45, 60, 75, 90])
def test_linear_keeps_its_slope_and_its_axis_perpendicular(degrees: int) -> None:
    slope, grasp = math.radians(degrees), a_grasp()
    path = linear(a_scene(), grasp, slope)
    assert path.kind == f"linear{degrees}"
    way = path.poses[1:, :2] - [grasp.x, HEIGHT / 2]
    np.testing.assert_allclose(way @ [-math.sin(slope), math.cos(slope)], 0, rtol=0, atol=ROUNDING)
    steps = np.diff(way @ [math.cos(slope), math.sin(slope)])
    np.testing.assert_allclose(steps, steps[0], rtol=0, atol=2 * ROUNDING)
    axis = path.waypoints[1:, 2:] - path.waypoints[1:, :2]
    reach = path.poses[1:, :2] - FIXED
    np.testing.assert_allclose((axis * reach).sum(axis=1), 0, rtol=0, atol=2 * ROUNDING * (0.1 + HEIGHT))
    assert (reach[:, 0] * axis[:, 1] < reach[:, 1] * axis[:, 0]).all()  # and never flips over


@pytest.mark.parametrize("degrees", [5, 30, 45, 60, 75, 90])
def test_linear_ends_at_the_stated_stretch(degrees: int) -> None:
    path = linear(a_scene(), a_grasp(), math.radians(degrees))
    stretch = np.hypot(*(path.poses[1:, :2] - FIXED).T) / 0.03
    assert stretch[-1] <= MOST_STRETCH * (1 + 1e-12)
    # the distance from a point is convex along a line, so one more step adds at least as much as the last
    assert 2 * stretch[-1] - stretch[-2] > MOST_STRETCH - (stretch[-1] - stretch[-2]) ** 2


def test_linear_at_sixty_degrees_is_back_at_rest_length_above_an_equilateral_triangle() -> None:
    motion = linear_motion(0.03, 0.03, HEIGHT, math.radians(60))
    np.testing.assert_allclose(
        motion, [-0.015, HEIGHT / 2 + 0.03 * math.sqrt(3) / 2, -math.pi / 3], rtol=0, atol=8 * EPS
    )


@pytest.mark.parametrize("slope", [0.0, -0.5, math.radians(90.01), math.nan])
def test_linear_refuses_other_slopes(slope: float) -> None:
    with pytest.raises(ValueError, match=r"slope = .* rad, allowed \(0, 1\.5708\]"):
        linear(a_scene(), a_grasp(), slope)


def test_steps_of_the_three_kinds_are_of_like_length() -> None:
    def step(path: JawPath) -> float:
        return float(np.hypot(*np.diff(path.poses[1 : 2 + INCREMENTS, :2], axis=0).T).mean())

    for nearness in (0.25, 0.15):
        for x in (-0.03, -0.04, -0.05):
            scene, grasp = a_scene(nearness), a_grasp(x)
            lengths = [step(ctc(scene, grasp)), step(circular(scene, grasp)), step(linear(scene, grasp, 1.0))]
            assert max(lengths) <= 2 * min(lengths)


@pytest.mark.parametrize(
    ("height", "target", "slope"), [(0.0044, -0.0125, 45), (0.02, -0.005, 60), (0.0044, -0.002, 90)]
)
def test_the_goal_is_a_turn_that_ctc_makes(height: float, target: float, slope: float) -> None:
    """Also where the line is nearer than half the thickness, which no arc clears."""
    tissue = Tissue(length=LENGTH, height=height, depth=0.005, modulus=40e3, poisson=0.4, density=1000.0)
    scene = Scene(name="near", tissue=tissue, line_of_sight=LineOfSight.at(target, math.radians(slope)))
    turns = -ctc(scene, Grasp(-0.03, height / 5)).poses[2:, 2]
    assert np.abs(turns - goal_turn(scene, 0.03)).min() < 1e-9
