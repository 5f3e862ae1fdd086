"""Jaw positions, grasps and jaw paths: conversions are inverse, values are checked, paths survive storage."""

from __future__ import annotations

import copy
import json
import math
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retract_env.grasp import Grasp, JawPath, to_jaws, to_pose

EPS = np.finfo(float).eps
coordinate = st.floats(-0.1, 0.1)
angle = st.floats(-math.pi, math.pi, exclude_min=True)
opening = st.floats(1e-4, 0.1)


def a_path(rows: int = 9) -> JawPath:
    """Squeeze, then turn clockwise through more than a full circle."""
    theta = np.concatenate([[0.0], np.linspace(0, -7.0, rows - 1)])
    x, y = -0.03 * np.cos(theta), 0.002 - 0.03 * np.sin(theta)
    poses = np.stack([x, y, theta, np.full(rows, 0.003)], axis=-1)
    poses[0, 3] = 0.0044
    return JawPath.from_poses(poses, "ctc")


# --- conversions


@given(coordinate, coordinate, angle, opening)
def test_pose_comes_back_from_its_jaws(x: float, y: float, theta: float, separation: float) -> None:
    back = to_pose(to_jaws([x, y, theta, separation]))
    # a jaw coordinate is below 0.15 m and rounds by half an eps of it; a few such errors meet
    error = 4 * EPS * 0.15
    np.testing.assert_allclose(back[[0, 1, 3]], [x, y, separation], rtol=0, atol=error)
    turned = math.remainder(back[2] - theta, 2 * math.pi)
    assert abs(turned) <= 2 * error / separation + 4 * EPS


@given(coordinate, coordinate, coordinate, coordinate)
def test_jaws_come_back_from_their_pose(x1: float, y1: float, x2: float, y2: float) -> None:
    back = to_jaws(to_pose([x1, y1, x2, y2]))
    # the axis angle rounds by up to eps * pi, at half a separation below 0.15 m
    np.testing.assert_allclose(back, [x1, y1, x2, y2], rtol=0, atol=4 * EPS * 0.15)


def test_conversions_take_any_leading_shape() -> None:
    jaws = np.random.default_rng(0).uniform(-0.05, 0.05, (3, 5, 4))
    poses = to_pose(jaws)
    assert poses.shape == jaws.shape == to_jaws(poses).shape
    np.testing.assert_array_equal(poses[2, 3], to_pose(jaws[2, 3]))
    np.testing.assert_array_equal(to_jaws(poses)[2, 3], to_jaws(poses[2, 3]))
    assert to_pose(np.empty((0, 4))).shape == (0, 4)


@pytest.mark.parametrize(
    ("upper", "theta"),
    [((0, 1), 0), ((-1, 1), math.pi / 4), ((-1, 0), math.pi / 2), ((1, 0), -math.pi / 2), ((0, -1), math.pi)],
)
def test_axis_angle_counts_from_up_counter_clockwise(upper: tuple[float, float], theta: float) -> None:
    assert to_pose([0.0, 0.0, *upper])[2] == pytest.approx(theta, abs=EPS)
    assert to_pose([-0.0, 0.0, *upper])[2] == pytest.approx(theta, abs=EPS)


def test_turning_the_pose_turns_the_jaws_about_the_midpoint() -> None:
    pose = np.array([0.01, 0.02, 0.3, 0.004])
    lower, upper = to_jaws(pose).reshape(2, 2)
    turn = 0.7
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    expected = [pose[:2] + rotation @ (jaw - pose[:2]) for jaw in (lower, upper)]
    turned = to_jaws(pose + np.array([0, 0, turn, 0])).reshape(2, 2)
    np.testing.assert_allclose(turned, expected, rtol=0, atol=4 * EPS * 0.03)


# --- grasp


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ((0.0, 1e-3), "grasp.x = 0 m"),
        ((0.01, 1e-3), "grasp.x = 0.01 m"),
        ((math.nan, 1e-3), "grasp.x = nan m"),
        ((-math.inf, 1e-3), "grasp.x = -inf m"),
        (("near", 1e-3), "grasp.x = 'near'"),
        ((None, 1e-3), "grasp.x = None"),
        ((-0.02, 0.0), "grasp.compression = 0 m"),
        ((-0.02, -1e-3), "grasp.compression = -0.001 m"),
        ((-0.02, math.nan), "grasp.compression = nan m"),
    ],
)
def test_grasp_refuses(values: tuple[Any, Any], field: str) -> None:
    with pytest.raises(ValueError, match="allowed") as error:
        Grasp(*values)
    assert str(error.value).startswith(field)
    assert "\n" not in str(error.value)


def test_grasp_has_to_be_inside_the_flap() -> None:
    Grasp(-0.05, 0.001).check_inside(0.05, 0.0044)
    Grasp(-0.05 * (1 + EPS), 0.001).check_inside(0.05, 0.0044)
    with pytest.raises(ValueError, match=r"grasp\.x = -0\.051 m, allowed \[-0\.05, 0\) m"):
        Grasp(-0.051, 0.001).check_inside(0.05, 0.0044)
    with pytest.raises(ValueError, match=r"grasp\.compression = 0\.0044 m, allowed \(0, 0\.0044\) m"):
        Grasp(-0.02, 0.0044).check_inside(0.05, 0.0044)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, "grasp.compression = nan m, allowed above 0 m, or else grasp.force, above 0 N"),
        ({"force": 0.0}, "grasp.force = 0 N, allowed above 0 N"),
        ({"force": math.nan}, "grasp.force = nan N, allowed above 0 N"),
        ({"force": "hard"}, "grasp.force = 'hard', allowed a number, N"),
        (
            {"force": 0.1, "compression": 1e-3},
            "grasp.force = 0.1 N and grasp.compression = 0.001 m, allowed one of them",
        ),
    ],
)
def test_a_grasp_holds_by_compression_or_by_force(values: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match="allowed") as error:
        Grasp(-0.02, **values)
    assert str(error.value) == said


def test_grasps_by_the_same_force_are_the_same() -> None:
    grasp = Grasp(-0.02, force=np.float32(0.5))  # type: ignore[arg-type]
    assert grasp.firmness == {"force": 0.5} and math.isnan(grasp.compression)
    copies = Grasp(-0.02, force=0.5, score=3.0), copy.deepcopy(grasp), pickle.loads(pickle.dumps(grasp))
    assert all(grasp == one and hash(grasp) == hash(one) for one in copies)
    assert grasp == Grasp(-0.02, None, force=0.5) == Grasp(-0.02, math.nan, force=0.5)  # type: ignore[arg-type]
    assert grasp not in (Grasp(-0.02, 0.5), Grasp(-0.02, force=0.6), Grasp(-0.03, force=0.5))
    grasp.check_inside(0.05, 0.0044)
    with pytest.raises(ValueError, match=r"grasp\.x = -0\.02 m"):
        grasp.check_inside(0.01, 0.0044)


def test_grasp_is_the_same_with_or_without_a_score() -> None:
    grasp = Grasp(-0.02, 0.001)
    assert math.isnan(grasp.score)
    assert grasp == Grasp(-0.02, 0.001, 3.0) == pickle.loads(pickle.dumps(grasp))
    assert grasp != Grasp(-0.02, 0.002)
    assert len({grasp, Grasp(-0.02, 0.001, 3.0)}) == 1


def test_grasp_from_numpy_scalars_goes_into_json() -> None:
    grasp = Grasp(*np.array([-0.02, 0.001, 5.0], dtype=np.float32))
    assert json.loads(json.dumps(vars(grasp)))["score"] == 5.0


# --- path


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ([[0, 0, 0, 1]], r"shape \(1, 4\)"),
        ([0, 0, 0, 1], r"shape \(4,\)"),
        ([[0, 0, 1], [0, 0, 1]], r"shape \(2, 3\)"),
        ([[0, 0, 0, 1], [0, 0, 1]], "not numbers in equal rows"),
        ([[0, 0, 0, "up"], [0, 0, 0, 1]], "not numbers"),
        (None, r"shape \(\)"),
        ([[0, 0, 0, 1], [0, 0, math.nan, 1]], r"waypoints\[1, 2\] = nan"),
        ([[0, 0, 0, math.inf], [0, 0, 0, 1]], r"waypoints\[0, 3\] = inf"),
        ([[0, 0, 0, 1], [0, 1, 0, 1]], r"separation\[1\] = 0 m"),
        ([[0, 0, 0, 1], [0, -1.7e308, 0, 1.7e308]], r"separation\[1\] = inf m"),
    ],
)
def test_path_refuses(waypoints: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        JawPath(waypoints, "ctc")
    assert "\n" not in str(error.value)
    assert "allowed" in str(error.value)


@pytest.mark.parametrize("kind", ["", "  ", None, 3])
def test_path_needs_a_kind(kind: Any) -> None:
    with pytest.raises(ValueError, match=r"path\.kind = .*allowed a name"):
        JawPath(a_path().waypoints, kind)


def test_poses_with_swapped_jaws_are_refused() -> None:
    with pytest.raises(ValueError, match=r"separation\[1\] = -1 m, allowed above 0 m"):
        JawPath.from_poses([[0, 0, 0, 1], [0, 0, 0, -1]], "ctc")


def test_angle_runs_on_beyond_half_and_full_turns() -> None:
    rounding = 2 * EPS * 0.05 / 0.003 + 8 * EPS
    np.testing.assert_allclose(a_path(40).poses[1:, 2], np.linspace(0, -7, 39), rtol=0, atol=rounding)


def test_pose_is_exact_at_waypoints_and_linear_between() -> None:
    path = a_path()
    rows = np.arange(len(path))
    np.testing.assert_array_equal(path.pose_at(rows), path.poses)
    np.testing.assert_allclose(path.jaws_at(rows), path.waypoints, rtol=0, atol=4 * EPS * 0.05)
    np.testing.assert_allclose(path.pose_at(3.25), 0.75 * path.poses[3] + 0.25 * path.poses[4], rtol=4 * EPS)
    assert path.pose_at(0.5).shape == (4,)
    assert path.jaws_at(np.full((2, 3), 1.5)).shape == (2, 3, 4)
    assert path.last == len(path) - 1 == 8


def test_jaws_turn_rather_than_close_between_waypoints() -> None:
    # cutting straight from jaw to jaw would shorten the separation by cos(7 / 7 / 2), some 12 %
    jaws = a_path().jaws_at(np.linspace(1, 8, 200))
    separation = np.hypot(jaws[:, 2] - jaws[:, 0], jaws[:, 3] - jaws[:, 1])
    np.testing.assert_allclose(separation, 0.003, rtol=0, atol=4 * EPS * 0.05)


@pytest.mark.parametrize("progress", [-1e-9, 8.001, math.nan, [0.0, 9.0]])
def test_progress_stays_on_the_path(progress: Any) -> None:
    with pytest.raises(ValueError, match=r"progress = .* waypoints, allowed \[0, 8\]"):
        a_path().pose_at(progress)


def test_more_waypoints_of_the_same_motion_are_the_same_motion() -> None:
    path = a_path()
    finer = JawPath.from_poses(path.pose_at(np.linspace(0, path.last, 4 * path.last + 1)), path.kind)
    at = np.linspace(0, path.last, 101)
    np.testing.assert_allclose(finer.jaws_at(4 * at), path.jaws_at(at), rtol=0, atol=64 * EPS * 0.05)


@pytest.mark.parametrize(
    "copied",
    [
        lambda path: pickle.loads(pickle.dumps(path)),
        copy.copy,
        copy.deepcopy,
        lambda path: JawPath.from_json(json.loads(json.dumps(path.to_json()))),
        lambda path: JawPath(path.waypoints, path.kind),
    ],
    ids=["pickle", "copy", "deepcopy", "json", "constructor"],
)
def test_a_copy_is_equal_and_read_only(copied: Any) -> None:
    path = a_path()
    _ = path.poses  # a cached array must not spoil the copy
    other = copied(path)
    assert other == path
    assert hash(other) == hash(path)
    for array in (other.waypoints, other.poses):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0


def test_path_does_not_follow_the_array_it_came_from() -> None:
    rows = a_path().waypoints.copy()
    path = JawPath(rows, "ctc")
    rows += 1
    assert path == a_path()


def test_paths_differ_by_kind_and_by_waypoints() -> None:
    path = a_path()
    moved = path.waypoints.copy()
    moved[-1, 0] = np.nextafter(moved[-1, 0], 1)
    for other in (JawPath(path.waypoints, "circular"), JawPath(moved, "ctc"), a_path(10), "ctc"):
        assert path != other
    plus, minus = (JawPath(np.array([[zero, 0, 0, 1], [0, 0, 0, 1]]), "ctc") for zero in (0.0, -0.0))
    assert plus == minus
    assert hash(plus) == hash(minus)


@pytest.mark.parametrize("data", [None, [], {}, {"kind": "ctc"}, {"kind": "", "waypoints": [], "speed": 1}])
def test_other_json_is_refused(data: Any) -> None:
    with pytest.raises(ValueError, match=r"path = .*allowed kind and waypoints"):
        JawPath.from_json(data)
