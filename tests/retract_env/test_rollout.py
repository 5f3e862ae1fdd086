"""Playing plans through the environment: on the path, as fast as allowed, judged as the certifier judges."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import retract_env  # noqa: F401  (registers the environments)
from planners import certify, plan
from planners.paths import circular, ctc
from retract_env.grasp import Grasp, JawPath, to_pose
from retract_env.rollout import PathPolicy, Rollout, gripper_pose, rollout
from retract_env.scene import Scene, load_scene
from retract_env.task import TaskConfig, default_scene
from retract_env.task.episode import spring_grasps

SCENES = Path(__file__).resolve().parents[2] / "configs" / "scenes"
MakeEnv = Callable[..., Any]


@pytest.fixture
def make() -> Iterator[MakeEnv]:
    made = []

    def make(scene: Scene, **options: Any) -> Any:
        made.append(gym.make("TissueRetractFEM-v0", scene=scene.dump(), **options).unwrapped)
        return made[-1]

    yield make
    for env in made:
        env.close()


def distance_to_path(poses: Any, path: JawPath, samples: int = 200) -> Any:
    """(n,) of poses (n, 4) to so many samples a waypoint of the path, m, 1 rad counting as 1 m."""
    fine = path.pose_at(np.linspace(1, path.last, samples * path.last))
    return np.abs(poses[:, None] - fine[None]).max(axis=2).min(axis=1)


def play(make: MakeEnv, scene: Scene, grasp: Grasp, path: JawPath) -> tuple[Any, Rollout]:
    env = make(scene)
    return env, rollout(env, PathPolicy(scene, grasp, path), seed=0)


def test_a_rollout_is_what_the_environment_said(make: MakeEnv) -> None:
    env = make(default_scene())
    rng = np.random.default_rng(0)
    drawn = []

    def policy(_: Any) -> Any:
        return rng.uniform(-0.5, 0.5, 3).astype(np.float32)

    played = rollout(env, policy, seed=1, on_step=lambda: drawn.append(env.episode.now))
    assert played.terminated != played.truncated
    assert len(played) == len(played.actions) == len(played.observations) - 1 == len(played.infos) - 1
    assert len(drawn) == len(played.infos)
    seen, _ = env.reset(seed=1)
    for k, action in enumerate(played.actions):
        assert np.array_equal(seen, played.observations[k])
        seen, reward, *_, info = env.step(action)
        assert reward == played.rewards[k]
        assert info == played.infos[k + 1]
    assert played.total == pytest.approx(played.rewards.sum())


@pytest.mark.parametrize("draw", [ctc, circular])
@pytest.mark.parametrize("held", [False, True])
def test_it_stays_on_the_path_and_goes_as_fast_as_it_may(
    make: MakeEnv, draw: Callable[..., JawPath], held: bool
) -> None:
    """Whether the policy takes the grasp or the environment did."""
    scene = default_scene()
    grasp = spring_grasps(scene)[3]
    path = draw(scene, grasp, 48)  # straight between waypoints, so the bound needs them close
    env = make(scene)
    options = {"grasp": {"x": grasp.x, "compression": grasp.compression}} if held else None
    played = rollout(env, PathPolicy(scene, grasp, path), options=options)
    assert played.success
    moved = to_pose(np.array([s.jaws for s in env.episode.history[1:]]))
    assert (distance_to_path(moved, path) < 1e-3 * np.radians(6)).all()
    moves = played.actions[0 if held else 1 :]
    assert np.abs(moves).max(axis=1) == pytest.approx(np.ones(len(moves)), abs=0.01)
    # the observed pose is the real one, to single precision
    assert gripper_pose(played.observations[-1], scene) == pytest.approx(moved[-1], abs=1e-6)


@pytest.mark.parametrize("name", ["homogeneous", "homogeneous_near", "ten_veins"])
def test_demo_plans_succeed_as_the_certifier_says(make: MakeEnv, name: str) -> None:
    """Both see the same states: the certifier in finer steps, to the moment when the last tissue clears."""
    scene = load_scene(SCENES / f"{name}.yaml")
    grasp = spring_grasps(scene)[2]
    path = ctc(scene, grasp)
    certificate = certify(scene, grasp, path, "coarse")
    env, played = play(make, scene, grasp, path)
    assert certificate.certified and played.success
    info = played.infos[-1]
    assert info["max_strain"] == pytest.approx(certificate.max_strain, rel=0.02)
    assert info["required_friction"] == pytest.approx(certificate.required_friction, abs=0.03)
    assert info["exposure"] == 1 and 0 <= info["clearance"] < 4e-3
    # and what was played is itself a retraction that can be certified
    again = certify(scene, env.episode.grasp, env.episode.path, "coarse")
    assert again.certified
    assert again.max_strain == pytest.approx(info["max_strain"], rel=0.02)


def test_a_failing_plan_fails_for_the_certifiers_reason(make: MakeEnv) -> None:
    scene = default_scene()
    grasp = Grasp(-0.005, 0.25 * scene.tissue.height)
    path = circular(scene, grasp)
    certificate = certify(scene, grasp, path, "coarse")
    _, played = play(make, scene, grasp, path)
    assert certificate.reason in ("slip", "strain", "release")
    assert played.infos[-1]["failure"] == certificate.reason


def test_at_the_paths_end_it_waits(make: MakeEnv) -> None:
    scene = default_scene()
    grasp = spring_grasps(scene)[2]
    short = JawPath(ctc(scene, grasp).waypoints[:12], "short")
    env, played = play(make, scene, grasp, short)
    assert played.truncated and not played.success and len(played) == TaskConfig().steps
    assert to_pose(env.episode.now.state.jaws) == pytest.approx(short.poses[-1], abs=1e-7)
    assert np.abs(played.actions[-1]).max() < 1e-3


def test_a_policy_can_be_played_again(make: MakeEnv) -> None:
    scene = default_scene()
    grasp = spring_grasps(scene)[2]
    policy = PathPolicy.of(SimpleNamespace(scene=scene, grasp=grasp, path=ctc(scene, grasp)))
    env = make(scene)
    first, second = rollout(env, policy, seed=0), rollout(env, policy, seed=0)
    assert np.array_equal(first.observations, second.observations)


def test_far_waypoints_are_reached_in_steps(make: MakeEnv) -> None:
    """A path in two leaps, the first of which takes several actions."""
    scene = default_scene()
    grasp = spring_grasps(scene)[2]
    way = ctc(scene, grasp)
    leaps = JawPath.from_poses(way.poses[[0, 1, 13, 25]], "leaps")
    env, played = play(make, scene, grasp, leaps)
    moved = to_pose(np.array([s.jaws for s in env.episode.history[1:]]))
    assert len(played) > 5
    assert (distance_to_path(moved, leaps, 5000) < 1e-3 * np.radians(6)).all()


def test_pixels_are_not_understood(make: MakeEnv) -> None:
    scene = default_scene()
    grasp = spring_grasps(scene)[0]
    with pytest.raises(
        ValueError, match=r"^observation has shape \(96, 96, 3\), allowed that of obs='state'$"
    ):
        rollout(make(scene, obs="pixels"), PathPolicy(scene, grasp, ctc(scene, grasp)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["homogeneous", "homogeneous_near", "ten_veins", "twenty_veins"])
def test_the_planners_best_plan_succeeds(make: MakeEnv, name: str) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    best = plan(scene, "ctc", "coarse", workers=1)
    env = make(scene)
    assert rollout(env, PathPolicy.of(best), seed=0).success


@pytest.mark.slow
def test_the_wide_flap_too(make: MakeEnv) -> None:
    scene = load_scene(SCENES / "wide.yaml")
    grasp = spring_grasps(scene)[0]
    _, played = play(make, scene, grasp, ctc(scene, grasp))
    assert played.success


def test_on_bullet_a_plan_succeeds_too() -> None:
    """Bullet's flap bends too stiffly, but it clears the line within a few steps of the finite elements'."""
    pytest.importorskip("pybullet")
    scene = default_scene()
    grasp = spring_grasps(scene)[2]
    policy = PathPolicy(scene, grasp, ctc(scene, grasp))
    played = []
    for name in ("TissueRetractFEM-v0", "TissueRetract-v0"):
        env = gym.make(name, resolution="coarse").unwrapped
        played.append(rollout(env, policy, seed=0))
        env.close()
    assert all(p.success for p in played)
    assert abs(len(played[0]) - len(played[1])) <= 4
