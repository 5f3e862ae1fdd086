"""The environments as Gymnasium, Stable-Baselines3 and their users meet them."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from retract_env import task
from retract_env.env import TissueRetractEnv
from retract_env.scene import sample_scene
from retract_env.task import default_scene
from tests.retract_env.playing import BULLET, FEM, LIFT, digest, play

ROOT = Path(__file__).resolve().parents[2]

# --- Checkers

OPTIONS: list[dict[str, Any]] = [
    {},
    {"grasp": "spring"},
    {"grasp": {"x": -0.03, "compression": 1e-3}, "obs": "pixels"},
    {"scene": "random", "render_mode": "rgb_array"},
    {"scene": "random", "grasp": "spring"},
    {"scene": str(ROOT / "configs" / "scenes" / "ten_veins.yaml"), "obs": "pixels"},
    {"scene": default_scene().dump(), "resolution": "medium", "render_mode": "human"},
]


@pytest.mark.parametrize("options", OPTIONS, ids="-".join)
def test_gymnasium_checks_it(make: Callable[..., TissueRetractEnv], options: dict[str, Any]) -> None:
    check_env(make(**options), skip_render_check=options.get("render_mode") is None)


@pytest.mark.parametrize("options", OPTIONS, ids="-".join)
def test_stable_baselines3_checks_it(make: Callable[..., TissueRetractEnv], options: dict[str, Any]) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make(**options), warn=True)


def test_gymnasium_checks_it_on_bullet() -> None:
    pytest.importorskip("pybullet")
    env = gym.make(BULLET, resolution="coarse").unwrapped
    check_env(env, skip_render_check=True)
    env.close()


# --- Reproducible


def test_a_seed_names_an_episode(make: Callable[..., TissueRetractEnv]) -> None:
    """To the last bit: again, in an environment that has played others, in a new process."""
    options = {"scene": "random", "grasp": "spring"}
    env = make(**options)
    first = digest(play(env, 3))
    play(env, 4)
    assert digest(play(env, 3)) == first
    assert digest(play(env, 4)) != first
    code = (
        "from tests.retract_env.playing import FEM, digest, gym, play\n"
        f"print(digest(play(gym.make(FEM, **{options!r}).unwrapped, 3)))"
    )
    other = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == first


def test_episodes_on_a_kept_flap_are_those_on_a_new_one(make: Callable[..., TissueRetractEnv]) -> None:
    kept, other = make(grasp="spring"), make(grasp="spring")
    said = [digest(play(kept, seed)) for seed in (1, 2, 1)]
    assert said == [digest(play(other, 1)), digest(play(make(grasp="spring"), 2)), said[0]]


def test_interleaved_environments_do_not_know_of_each_other(
    make: Callable[..., TissueRetractEnv],
) -> None:
    envs = make(), make()
    actions = [np.array([-0.2, 0.1, 0.0]), *[LIFT] * 4]
    alone = []
    for env in envs:
        alone.append([env.reset(seed=0)[0], *(env.step(a)[0] for a in actions)])
    together = [[env.reset(seed=0)[0]] for env in envs]
    for action in actions:
        for env, seen in zip(envs, together, strict=True):
            seen.append(env.step(action)[0])
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one, other)


def test_random_scenes_come_from_the_seed_alone(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(scene="random")
    env.reset(seed=7)
    scenes = [env.episode.task.scene]
    for seed in (None, 7, None):
        env.reset(seed=seed)
        scenes.append(env.episode.task.scene)
    assert scenes[0] != scenes[1]
    assert scenes[:2] == scenes[2:]
    assert scenes[0] == sample_scene(gym.utils.seeding.np_random(7)[0])


# --- Spec, pickles, vectors, wrappers


@pytest.mark.parametrize("options", [o for o in OPTIONS if "render_mode" not in o], ids="-".join)
def test_a_spec_survives_json(make: Callable[..., TissueRetractEnv], options: dict[str, Any]) -> None:
    env = make(**options)
    assert env.spec is not None
    spec = EnvSpec.from_json(env.spec.to_json())
    assert spec == env.spec
    again = spec.make()
    assert np.array_equal(again.reset(seed=5)[0], env.reset(seed=5)[0])
    again.close()


def test_the_registered_limit_is_the_tasks() -> None:
    for name in (FEM, BULLET):
        assert gym.spec(name).max_episode_steps == task.MAX_STEPS


def test_it_is_made_without_an_import() -> None:
    code = f"import gymnasium as gym; print(gym.make('retract_env:{FEM}').unwrapped.spec.id)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == FEM


def test_pickles_are_new_environments_of_the_same_sort(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp="spring", scene="random")
    said = digest(play(env, 2, steps=3))
    again = pickle.loads(pickle.dumps(env))
    assert digest(play(again, 2, steps=3)) == said
    again.close()


@pytest.mark.parametrize("kind", ["sync", "async"])
def test_vectors_of_environments(make: Callable[..., TissueRetractEnv], kind: str) -> None:
    settings = {} if kind == "sync" else {"context": "spawn"}
    envs: Any = gym.make_vec(FEM, num_envs=2, vectorization_mode=kind, vector_kwargs=settings, grasp="spring")
    try:
        seen = [envs.reset(seed=[1, 2])[0]]
        for _ in range(3):
            seen.append(envs.step(np.stack([LIFT, LIFT / 2]))[0])
    finally:
        envs.close()
    for k in range(2):
        env = make(grasp="spring")
        alone = [env.reset(seed=1 + k)[0]] + [env.step(LIFT / (1 + k))[0] for _ in range(3)]
        assert np.array_equal(alone, [both[k] for both in seen])


def test_wrappers(make: Callable[..., TissueRetractEnv]) -> None:
    wrapped: gym.Env[Any, Any] = gym.wrappers.RecordEpisodeStatistics(make(grasp="spring"))
    wrapped = gym.wrappers.NormalizeReward(gym.wrappers.NormalizeObservation(wrapped))
    wrapped = gym.wrappers.FrameStackObservation(wrapped, 2)
    wrapped.reset(seed=0)
    while True:
        seen, _, terminated, truncated, info = wrapped.step(LIFT)
        assert seen.shape == (2, task.SIZE)
        if terminated or truncated:
            break
    assert info["episode"]["l"] <= task.MAX_STEPS


def test_videos(make: Callable[..., TissueRetractEnv], tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env: Any = gym.wrappers.RecordVideo(
        make(grasp="spring", render_mode="rgb_array"), str(tmp_path / "videos")
    )
    env.reset(seed=0)
    for _ in range(3):
        env.step(LIFT)
    env.close()
    assert [path.suffix for path in (tmp_path / "videos").iterdir()] == [".mp4"]


@pytest.mark.slow
def test_500_resets_need_no_more_memory(make: Callable[..., TissueRetractEnv]) -> None:
    """Every one on a new flap with a new grasp, squeezed."""
    resource = pytest.importorskip("resource")
    env = make(scene="random")
    used = []
    for k in range(500):
        env.reset(seed=k)
        env.step(env.action_space.sample() * 0.5)
        used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    # of the peak, in kB: what 400 flaps would add if they stayed is some GB
    assert used[-1] - used[100] < 50_000
