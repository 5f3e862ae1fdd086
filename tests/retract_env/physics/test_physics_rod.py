"""The rod between moving jaws: what a physics promises, and that all it says of a state belongs together."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.paths import INCREMENTS, ctc
from retract_env.errors import Diverged
from retract_env.grasp import Grasp
from retract_env.mesh import jaw_range
from retract_env.objectives import IN_BLOCK, clearance, inside_block, required_friction
from retract_env.physics.base import Physics, Restorable, TissueState
from retract_env.physics.measures import tool_outline
from retract_env.physics.rod import RodPhysics
from retract_env.rod.chain import LANES, RIGHT, SCRATCH, sweep
from retract_env.rod.flap import FACTORS, INNER, SHORTEST
from retract_env.scene import Scene, load_scene
from retract_env.task import default_scene, sound
from tests.retract_env.extremes import CORNERS, corner, scene_with
from tests.retract_env.physics.test_physics_fem import same_bits

Array = NDArray[np.float64]

GRASP = Grasp(-0.025, 1.1e-3)
IN_A_BLINK = 1e-9
"""Of numbers of order 1, through some ten operations in another order."""


SCENES: dict[str, Scene] = {
    "plain": default_scene(),
    "veins": load_scene("ten_veins"),
    "wide": load_scene("wide"),
    "no bed": scene_with(bed=False),
    "thick": scene_with(tissue={"height": 0.012}),
    "deep": scene_with(tissue={"depth": 0.2}),
    "short": scene_with(
        tissue={"length": 0.015}, line_of_sight={"camera": [-0.02, 0.02], "target": [-0.004, 0.0]}
    ),
    "heavy": scene_with(tissue={"density": 1e4}),
    "tool in sight": scene_with(jaws={"in_sight": True}),
}


def poses_of(scene: Scene, x: float, compression: float) -> Array:
    """(n, 4): closing, then a retraction, then some turns and a push towards the fixed end."""
    height = scene.tissue.height
    path = ctc(scene, Grasp(x, compression))
    lifted = [path.pose_at(p) for p in np.linspace(1, 1 + INCREMENTS, 7)]
    turned = [lifted[-1] + [0.1 * x * k, 0.0, 0.3 * k, 0.0] for k in (-1, 1, 2)]
    pushed = np.array([0.3 * x, 0.8 * height, 0.0, height - compression])
    return np.array([*lifted, *turned, pushed])


def follow(scene: Scene, x: float = -0.6, compression: float = 0.25) -> list[tuple[RodPhysics, TissueState]]:
    """States along `poses_of` that there are, each with the physics; x, compression: over length, height."""
    x, compression = x * scene.tissue.length, compression * scene.tissue.height
    physics = RodPhysics(scene, x)
    physics.reset()
    found = []
    for pose in poses_of(scene, x, compression):
        try:
            found.append((physics, physics.move_to(pose)))
        except Diverged:
            break
    return found


# --- What a physics promises


def test_it_is_a_physics() -> None:
    physics: Physics = RodPhysics(default_scene(), GRASP.x)
    assert isinstance(physics, Restorable)
    state = physics.reset()
    assert (
        state is physics.state() and state.progress == 0 and state.worst_strain == pytest.approx(0, abs=5e-3)
    )
    assert not state.overlap and np.isfinite(state.points).all()
    assert state.points.shape == physics.section.points.shape
    assert state.strain.shape == (len(physics.section.triangles),)
    physics.close()
    physics.close()


@pytest.mark.parametrize("name", SCENES)
def test_the_same_moves_lead_to_the_same_states(name: str) -> None:
    scene = SCENES[name]
    x = 0.6 * -scene.tissue.length
    poses = poses_of(scene, x, 0.25 * scene.tissue.height)
    said = []
    physics = RodPhysics(scene, x)
    for one in (physics, physics, RodPhysics(scene, x)):
        first = one.reset()
        assert same_bits(first, one.reset())
        states = [first]
        for k, pose in enumerate(poses[:-1]):
            states.append(one.move_to(pose, float(k)))
            assert states[-1].progress == k
        said.append(states)
    for others in said[1:]:
        assert all(same_bits(a, b) for a, b in zip(said[0], others, strict=True))


def test_progress_stays_where_none_is_told() -> None:
    physics = RodPhysics(default_scene(), GRASP.x)
    physics.reset()
    poses = poses_of(physics.scene, GRASP.x, GRASP.compression)
    assert physics.move_to(poses[0], 1.0).progress == 1
    assert physics.move_to(poses[1]).progress == 1
    assert physics.reset().progress == 0


def test_a_move_that_fails_changes_nothing() -> None:
    scene = default_scene()
    physics, other = RodPhysics(scene, GRASP.x), RodPhysics(scene, GRASP.x)
    poses = poses_of(scene, GRASP.x, GRASP.compression)
    for one in (physics, other):
        one.reset()
        one.move_to(poses[0], 1.0)
    kept = physics.get_state()
    failed = 0
    for wrong in ([np.nan, 0, 0, 0], [0, np.nan, 0, 0], [0, 0, np.inf, 0], [0, 0, 1e3, 0], [1e6, 0, 0, 0]):
        for change in (wrong, [*wrong[:3], -1e-4]):
            try:
                physics.move_to(poses[0] + change)
            except Diverged:
                failed += 1
                assert same_bits(physics.state(), other.state())
                assert same_bits(physics.move_to(poses[1]), other.move_to(poses[1]))
            other.set_state(kept)
            physics.set_state(kept)
    assert failed >= 6


def test_a_grasp_has_to_be_on_the_flap() -> None:
    for x in (-0.06, 0.0, -1e-4, 0.01):
        with pytest.raises(ValueError, match=r"^grasp.x = .*allowed"):
            RodPhysics(default_scene(), x)
    with pytest.raises(ValueError, match=r"^resolution = 'huge', allowed rod"):
        RodPhysics(default_scene(), -0.03, "huge")


# --- What it says of one state belongs together


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("x", "compression"), [(-0.6, 0.25), (-1.0, 0.3), (-0.15, 0.05), (-0.8, 0.5)])
def test_a_state_is_what_the_objectives_say_of_it(name: str, x: float, compression: float) -> None:
    scene = SCENES[name]
    states = follow(scene, x, compression)
    assert len(states) >= 4
    line, height = scene.line_of_sight, scene.tissue.height
    for _, state in states:
        assert sound(state)
        assert np.hypot(*state.normals.T) == pytest.approx(1, abs=1e-12)
        assert state.normals[0] == pytest.approx(
            (state.jaws[2:] - state.jaws[:2]) / np.hypot(*(state.jaws[2:] - state.jaws[:2]))
        )
        found = required_friction(state.reactions, state.normals)
        assert state.required_friction == pytest.approx(found, rel=IN_A_BLINK)
        lowest = clearance(state.points, line.camera, line.target)
        if scene.jaws.in_sight:
            tool = tool_outline(scene, state.jaws)
            lowest = min(lowest, clearance(tool, line.camera, line.target))
        assert state.clearance == pytest.approx(lowest, abs=1e-12)
        assert state.overlap == inside_block(state.points, height, IN_BLOCK * height)
        assert (state.strain >= 0).all() and state.worst_strain > 0
        assert (
            -scene.tissue.length * (1 + 1e-12) <= state.worst_at[0] <= 0 and 0 <= state.worst_at[1] <= height
        )


def test_what_is_between_the_jaws_is_where_they_are() -> None:
    for physics, state in follow(default_scene()):
        low, high = (state.points[patch[0]] for patch in physics.section.patches)
        # the two parts are pushed apart a little, along the flap
        assert np.concatenate([low, high]) == pytest.approx(state.jaws, abs=0.1 * GRASP.compression)


def test_tissue_inside_the_block_is_told() -> None:
    scene = default_scene()
    physics, height = RodPhysics(scene, -0.01), scene.tissue.height
    physics.reset()
    told = set()
    for x in np.linspace(-0.01, 0.006, 17):
        try:
            state = physics.move_to(np.array([x, 0.5 * height, 0.0, 0.8 * height]))
        except Diverged:
            break
        assert state.overlap == inside_block(state.points, height, IN_BLOCK * height)
        told.add(state.overlap)
    assert told == {False, True}


@pytest.mark.parametrize("gravity", [0.0, 9.8, 40.0])
@pytest.mark.parametrize("x", [-0.6, -1.0, -0.3])
def test_a_flap_in_the_air_rests_on_its_jaws_and_its_fixed_end(gravity: float, x: float) -> None:
    """Without a bed: what the jaws and the fixed end bear is the flap's weight."""
    scene = scene_with(bed=False, gravity=gravity)
    tissue = scene.tissue
    unit = tissue.modulus * tissue.height * tissue.depth
    x *= tissue.length
    longest = max(tissue.length, SHORTEST * tissue.height - x)  # a stub beyond the jaws at the free end
    weight = tissue.density * gravity * longest * tissue.height * tissue.depth
    physics = RodPhysics(scene, x)
    physics.reset()
    for pose in poses_of(scene, x, 0.25 * tissue.height)[:10]:
        state = physics.move_to(pose)
        block, scratch = physics._block, np.zeros(SCRATCH * LANES)
        sweep(block.inner, block.inner_u, scratch, np.zeros(FACTORS * LANES), INNER, True)
        held = scratch.reshape(-1, LANES)[RIGHT : RIGHT + 2, 0] * unit
        assert held - state.reactions.sum(axis=0) == pytest.approx([0.0, weight], abs=1e-7 * unit)


def test_without_weight_a_flap_turned_upside_down_is_the_same() -> None:
    """No bed, no block in the way: mirrored moves lead to mirrored states, the jaws change their roles."""
    scene = scene_with(bed=False, gravity=0.0)
    height, physics = scene.tissue.height, RodPhysics(scene, GRASP.x)
    physics.reset()
    poses = poses_of(scene, GRASP.x, GRASP.compression)[:7]
    mirrored = poses * [1, -1, -1, 1] + [0, height, 0, 0]
    said = [physics.move_to(pose) for pose in poses]
    physics.reset()
    for pose, state in zip(mirrored, said, strict=True):
        other = physics.move_to(pose)
        assert other.required_friction[::-1] == pytest.approx(state.required_friction, rel=1e-6, abs=1e-9)
        assert other.worst_strain == pytest.approx(state.worst_strain, rel=1e-9)
        flipped = other.points.reshape(-1, 3, 2)[:, ::-1].reshape(-1, 2) * [1, -1] + [0, height]
        assert flipped == pytest.approx(state.points, abs=1e-9)


# --- Whatever the scene


@pytest.mark.parametrize("jaw", [1e-3, 0.24])
@pytest.mark.parametrize("number", range(len(CORNERS)))
def test_at_the_corners_of_what_a_scene_may_be(number: int, jaw: float) -> None:
    """Numbers, or no equilibrium; for grasps at both ends of the flap and between."""
    scene = corner(number, jaw)
    length, height = scene.tissue.length, scene.tissue.height
    low, high = jaw_range(length, scene.jaws.width)
    for x, closed in product((low, 0.5 * (low + high), high * (1 + 1e-9)), (0.02, 0.5)):
        said: list[TissueState] = []
        try:
            physics = RodPhysics(scene, x)
            said.append(physics.reset())
            pose = np.array([x, height / 2, 0.0, (1 - closed) * height])
            for change in ([0, 0, 0, 0], [2e-3, 2e-3, 0.1, 0], [-2e-3, 2e-3, -0.1, 0], [0.01, -0.01, 0.5, 0]):
                said.append(physics.move_to(pose + change))
        except Diverged:
            pass
        for state in said:
            # between jaws far thinner than the flap is high, the law of a squeeze overflows
            assert np.isfinite(state.points).all() and np.isfinite(state.reactions).all()
            assert math.isfinite(state.clearance) and not math.isnan(state.worst_strain)
            assert not np.isnan(state.required_friction).any()
