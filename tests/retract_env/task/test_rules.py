"""The compiled formulas of the task against those that are written to be read, to the last bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from retract_env import objectives
from retract_env.scene import LineOfSight, Scene, sample_scene
from retract_env.task import KEYPOINTS, SIZE, SLICES, RetractionTask, TaskConfig, default_scene, rules
from retract_env.task.observation import bounds
from retract_env.task.rest import rest_section, rest_state

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=200, deadline=None)

CODES = {None: rules.GOES_ON, "strain": rules.STRAIN, "slip": rules.SLIP, "release": rules.RELEASE}
CODES |= {"contact": rules.CONTACT, "ok": rules.OK}


def surfaces(rng: np.random.Generator, high: float) -> tuple[Array, Array]:
    """Lower and upper surface of a flap bent at random, up to about so high, m; some may be in the bed."""
    n = 2 * int(rng.integers(1, 27)) + 1
    angle = np.cumsum(rng.normal(scale=rng.choice([0.05, 0.3, 1.0]), size=n))
    axis = 0.05 / n * np.cumsum(np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=0)
    axis += -axis[-1] + [0.0, rng.uniform(-0.002, high)]
    across = rng.uniform(1e-4, 3e-3) * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return axis - across, axis + across


def outline(lower: Array, upper: Array) -> Array:
    """(2 n - 1 + 2, 2): around the section, the middle of both its ends included."""
    middle = [(lower[k] + upper[k]) / 2 for k in (-1, 0)]
    return np.vstack([lower, middle[0], upper[::-1], middle[1], lower[:1]])


@many
@given(seeds, st.sampled_from([0.0, 0.01, 0.06, 0.15]))
def test_exposure_past_a_flap(seed: int, high: float) -> None:
    """Also where part of it is as high as the camera."""
    rng = np.random.default_rng(seed)
    lower, upper = surfaces(rng, high)
    camera = np.array([rng.uniform(-0.1, -0.03), rng.uniform(0.01, 0.1)])
    target = rng.uniform(-0.03, -0.003)
    ring = outline(lower, upper)
    expected = objectives.exposure(ring, camera, (target, 0.0), -0.05)
    edges = np.stack([ring[:-1], ring[1:]], axis=1)
    for pieces in (ring[None], edges, edges[::-1], edges[:, ::-1]):
        assert rules.exposed_past(np.ascontiguousarray(pieces), *camera, target, -0.05) == expected
    assert rules.exposed_above(lower, upper, *camera, target, -0.05) == expected
    if ring[:, 1].max() < camera[1]:
        hits = objectives.bed_hits(ring, camera)
        assert rules.exposed_beside(hits.min(), hits.max(), target, -0.05) == expected


def test_some_of_these_flaps_are_above_the_camera() -> None:
    tops = [surfaces(np.random.default_rng(seed), 0.15)[1][:, 1].max() for seed in range(50)]
    assert min(tops) < 0.01 and max(tops) > 0.1


def test_a_point_at_the_height_of_the_camera() -> None:
    lower = np.array([[-0.05, 0.05], [-0.02, 0.05], [0.0, 0.0]])
    upper = lower + np.array([0.0, 0.02])
    for camera in ([-0.08, 0.07], [-0.08, 0.05], [-0.05, 0.07], [-0.05, 0.05]):
        expected = objectives.exposure(outline(lower, upper), camera, (-0.01, 0.0), -0.05)
        assert rules.exposed_above(lower, upper, *camera, -0.01, -0.05) == expected


@many
@given(seeds)
def test_verdicts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = np.array([rng.uniform(0.1, 0.9), rng.uniform(0.1, 2.0), rng.choice([0.0, 0.003])])
    strain = float(rng.choice([0.0, limits[0], np.nextafter(limits[0], 1), rng.uniform(0, 2), np.inf]))
    friction = rng.choice([0.0, limits[1], np.nextafter(limits[1], 9), rng.uniform(0, 3), np.inf], 2)
    clearance = float(rng.choice([-np.inf, limits[2], np.nextafter(limits[2], -1), rng.uniform(-0.01, 0.01)]))
    overlap = bool(rng.integers(2))
    most, slips, asked = limits.tolist()
    expected = objectives.verdict(strain, friction, clearance, most, slips, asked, overlap)
    assert rules.verdict(strain, float(friction.max()), clearance, limits, overlap) == CODES[expected]


def drawn(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    scene = sample_scene(rng)
    limits = scene.limits.model_copy(update={"clearance": float(rng.choice([0.0, 0.004]))})
    line = LineOfSight(
        camera=(rng.uniform(-0.1, -0.06), rng.uniform(0.01, 0.1)), target=(rng.uniform(-0.04, -0.001), 0.0)
    )
    return scene.model_copy(update={"limits": limits, "line_of_sight": line})


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_the_way_from_rest_to_what_is_asked(seed: int) -> None:
    scene = drawn(seed)
    tissue, line = scene.tissue, scene.line_of_sight
    outset = rules.rest_clearance(tissue.length, tissue.height, *line.camera, line.target[0])
    task = RetractionTask(scene)
    begin = task.begin()
    assert outset == begin.state.clearance == rest_state(scene, rest_section(scene)).clearance
    rng = np.random.default_rng(seed)
    for clearance in (outset, 0.0, scene.limits.clearance, *rng.uniform(outset - 0.01, 0.02, 5)):
        state = rest_state(scene, rest_section(scene))
        object.__setattr__(state, "clearance", float(clearance))
        now = task.hold(begin, rest_section(scene), state)
        assert rules.way(float(clearance), outset, scene.limits.clearance) == task._way(now)


@many
@given(seeds)
def test_an_observation_number_by_number(seed: int) -> None:
    """Against NumPy; needed friction may be infinite."""
    rng = np.random.default_rng(seed)
    scene, config = default_scene(), TaskConfig()
    length, height = scene.tissue.length, scene.tissue.height
    low, high = bounds(config)
    points = rng.normal(scale=0.08, size=4 * KEYPOINTS)
    jaws = rng.normal(scale=0.02, size=4)
    if rng.integers(5) == 0:
        jaws[2:] = jaws[:2]
    sight, k_eq = rng.uniform(-3, 12, 3), rng.uniform(-1, 12, 50)
    strain, most, one, other, friction = rng.choice([0.0, 0.3, 0.7, 3.0, np.inf], 5)
    limits = np.array([0.5, 0.4, 0.0])
    clearance, exposure, left = rng.uniform(-0.2, 0.2), rng.uniform(), rng.uniform()
    forces, off = tuple(rng.normal(scale=5, size=4).tolist()), rng.choice([0.0, 1e-4], 3)
    out = np.full(SIZE, np.nan, np.float32)
    rules.observe(
        True, left, jaws, length, height, points, sight, k_eq, strain, most, one, other, friction, clearance,
        exposure, limits, forces, off, low, high, out,
    )  # fmt: skip
    across = jaws[2:] - jaws[:2]
    separation = math.sqrt(across[0] ** 2 + across[1] ** 2)
    angle = [-across[0] / separation, across[1] / separation] if separation > 0 else [0.0, 1.0]
    expected = {
        "holding": 1.0,
        "time_left": left,
        "gripper": ((jaws[:2] + jaws[2:]) / 2 - off[:2]) / length,
        "angle": angle,
        "separation": (separation + off[2]) / height,
        "lower": points[: 2 * KEYPOINTS] / length,
        "upper": points[2 * KEYPOINTS :] / length,
        "target": sight[0],
        "slope": sight[1],
        "nearness": sight[2],
        "k_eq": k_eq,
        "strain": strain / 0.5,
        "max_strain": most / 0.5,
        "friction": [one / 0.4, other / 0.4],
        "max_friction": friction / 0.4,
        "clearance": clearance / length,
        "exposure": exposure,
        "forces": forces,
    }
    assert set(expected) == set(SLICES)
    for name, part in SLICES.items():
        clipped = np.clip(np.asarray(expected[name], np.float64), low[part], high[part]).astype(np.float32)
        assert out[part].tobytes() == np.broadcast_to(clipped, out[part].shape).tobytes(), name


@many
@given(seeds)
def test_sensors_feel_what_the_jaws_do_to_the_tissue(seed: int) -> None:
    """Both jaws' forces are put together again from their parts, whichever way the jaws stand."""
    rng = np.random.default_rng(seed)
    reactions, jaws = rng.normal(size=(2, 2)), rng.normal(scale=0.02, size=4)
    out = np.array(rules.sensed(tuple(reactions.ravel().tolist()), jaws, 0.2))
    axis = (jaws[2:] - jaws[:2]) / np.linalg.norm(jaws[2:] - jaws[:2])
    along = np.array([axis[1], -axis[0]])
    presses, drags = 0.2 * out[0::2], 0.2 * out[1::2]
    put_together = np.outer([presses[0], -presses[1]], axis) + np.outer(drags, along)
    assert put_together == pytest.approx(-reactions, abs=1e-12)
    # upright jaws, which tissue between them pushes apart
    assert rules.sensed((0.0, -1.0, 0.0, 1.0), np.array([0.0, 0.0, 0.0, 1.0]), 1.0) == (1.0, 0.0, 1.0, 0.0)


@many
@given(seeds)
def test_keypoints_are_interpolated(seed: int) -> None:
    """Between nodes anywhere, of which the first and the last count beyond the ends."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(-0.055, 0.0, int(rng.integers(2, 30))))
    at = np.unique(np.append(at, [-0.05, 0.0])) if rng.integers(2) else at
    surface = rng.normal(scale=0.03, size=(len(at), 2))
    out = np.empty(2 * KEYPOINTS)
    rules.keypoints(at, surface, 0.05, out)
    stations = -0.05 * (1 - np.arange(KEYPOINTS) / KEYPOINTS)
    expected = np.stack([np.interp(stations, at, surface[:, k]) for k in range(2)], axis=1)
    assert out == pytest.approx(expected.ravel(), abs=1e-14)
