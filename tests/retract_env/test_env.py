"""The environments as Gymnasium, Stable-Baselines3 and their users meet them."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

from retract_env.env import TissueRetractEnv
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import rollout
from retract_env.scene import sample_scene
from retract_env.task import SIZE, SLICES, TaskConfig, default_scene
from tests.retract_env.playing import BULLET, FEM, LIFT, ROD, digest, play

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


CASES = [
    *(
        pytest.param(name, options, id=f"{name}-{k}")
        for name in (FEM, BULLET, ROD)
        for k, options in enumerate(OPTIONS)
        if name != ROD or "resolution" not in options
    ),
    *(
        pytest.param(name, {"camera": "3d", "render_mode": "rgb_array"}, id=f"{name}-3d")
        for name in (FEM, BULLET, ROD)
    ),
    pytest.param(ROD, {"obs": "pixels", "view": "camera"}, id=f"{ROD}-camera"),
]


@pytest.mark.parametrize(("name", "options"), CASES)
def test_gymnasium_checks_it(
    make: Callable[..., TissueRetractEnv], name: str, options: dict[str, Any]
) -> None:
    check_env(make(name, **options), skip_render_check=options.get("render_mode") is None)


@pytest.mark.parametrize(("name", "options"), CASES)
def test_stable_baselines3_checks_it(
    make: Callable[..., TissueRetractEnv], name: str, options: dict[str, Any]
) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make(name, **options), warn=True)


# --- Reproducible


def test_a_seed_names_an_episode(make: Callable[..., TissueRetractEnv]) -> None:
    """To the last bit: again, in an environment that has played others, in a new process."""
    options = {"scene": "random", "grasp": "spring", "resolution": "coarse"}
    names = [FEM, BULLET] if find_spec("pybullet") else [FEM]
    firsts = []
    for name in names:
        env = make(name, **options)
        first = digest(play(env, 3))
        play(env, 4, steps=3)
        assert digest(play(env, 3)) == first
        assert digest(play(env, 4)) != first
        firsts.append(first)
    assert len(set(firsts)) == len(names)
    code = (
        "from tests.retract_env.playing import digest, gym, play\n"
        f"for name in {names}: print(digest(play(gym.make(name, **{options!r}).unwrapped, 3)))"
    )
    other = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert other.stdout.split() == firsts


def test_episodes_on_a_kept_flap_are_those_on_a_new_one(make: Callable[..., TissueRetractEnv]) -> None:
    kept, other = make(grasp="spring"), make(grasp="spring")
    said = [digest(play(kept, seed)) for seed in (1, 2, 1)]
    assert said == [digest(play(other, 1)), digest(play(make(grasp="spring"), 2)), said[0]]


@pytest.mark.parametrize("names", [(FEM, FEM), (BULLET, BULLET), (FEM, BULLET), (ROD, ROD)], ids="-".join)
def test_interleaved_environments_do_not_know_of_each_other(
    make: Callable[..., TissueRetractEnv], names: tuple[str, str]
) -> None:
    envs = [make(name) for name in names]
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


def test_every_physics_has_an_environment() -> None:
    for kind in PHYSICS.values():
        assert gym.spec(kind.env_id).kwargs == {"physics": kind.name}


@pytest.mark.parametrize("steps", [3, TaskConfig().steps, 70])
def test_the_number_of_steps_is_the_tasks_wherever_it_is_asked_for(steps: int) -> None:
    """Gymnasium's own time limit does not come before it."""
    env = gym.make(FEM, grasp="spring", task={"steps": steps})
    assert env.spec is not None and env.spec.max_episode_steps == steps
    again = EnvSpec.from_json(env.spec.to_json()).make()
    for made in (env, again):
        played = rollout(made, lambda _: np.zeros(3, np.float32), seed=0)
        assert played.truncated and len(played) == steps
        left = played.observations[:, SLICES["time_left"]].ravel()
        assert left == pytest.approx(1 - np.arange(steps + 1) / steps, abs=1e-6)
        made.close()


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


HELD: dict[str, Any] = {"grasp": "spring", "resolution": "coarse"}
BOTH = [FEM, BULLET if find_spec("pybullet") else FEM]


def alone(make: Callable[..., TissueRetractEnv], names: Sequence[str]) -> list[list[NDArray[Any]]]:
    """What environment k sees that is reset with seed k and lifts ever more slowly with k."""
    seen = []
    for k, name in enumerate(names):
        env = make(name, **HELD)
        seen.append([env.reset(seed=k)[0]] + [env.step(LIFT / (1 + k))[0] for _ in range(3)])
    return seen


@pytest.mark.parametrize("name", [FEM, BULLET])
def test_vectors_of_one_id(make: Callable[..., TissueRetractEnv], name: str) -> None:
    expected = alone(make, [name, name])
    envs: Any = gym.make_vec(name, num_envs=2, vectorization_mode="sync", **HELD)
    seen = [envs.reset(seed=[0, 1])[0], *(envs.step(np.stack([LIFT, LIFT / 2]))[0] for _ in range(3))]
    envs.close()
    assert np.array_equal(np.swapaxes(seen, 0, 1), expected)


def test_vectors_in_processes_of_their_own(make: Callable[..., TissueRetractEnv]) -> None:
    """Both physics in one vector: their spaces are the same."""
    made = [partial(gym.make, f"retract_env:{name}", **HELD) for name in BOTH]
    envs: Any = gym.vector.AsyncVectorEnv(made, context="spawn")
    try:
        seen = [envs.reset(seed=[0, 1])[0], *(envs.step(np.stack([LIFT, LIFT / 2]))[0] for _ in range(3))]
    finally:
        envs.close()
    assert np.array_equal(np.swapaxes(seen, 0, 1), alone(make, BOTH))


def test_stable_baselines3_runs_them_in_processes(make: Callable[..., TissueRetractEnv]) -> None:
    vectors = pytest.importorskip("stable_baselines3.common.vec_env")
    made = [partial(gym.make, f"retract_env:{name}", **HELD) for name in BOTH]
    envs = vectors.SubprocVecEnv(made, start_method="spawn")
    try:
        envs.seed(0)  # k gets the seed 0 + k
        seen = [envs.reset(), *(envs.step(np.stack([LIFT, LIFT / 2]))[0] for _ in range(3))]
    finally:
        envs.close()
    assert np.array_equal(np.swapaxes(seen, 0, 1), alone(make, BOTH))


def test_wrappers(make: Callable[..., TissueRetractEnv]) -> None:
    wrapped: gym.Env[Any, Any] = gym.wrappers.RecordEpisodeStatistics(make(grasp="spring"))
    wrapped = gym.wrappers.NormalizeReward(gym.wrappers.NormalizeObservation(wrapped))
    wrapped = gym.wrappers.FrameStackObservation(wrapped, 2)
    wrapped.reset(seed=0)
    while True:
        seen, _, terminated, truncated, info = wrapped.step(LIFT)
        assert seen.shape == (2, SIZE)
        if terminated or truncated:
            break
    assert info["episode"]["l"] <= TaskConfig().steps


def test_videos(make: Callable[..., TissueRetractEnv], tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env: Any = gym.wrappers.RecordVideo(
        make(grasp="spring", render_mode="rgb_array"), str(tmp_path / "videos")
    )
    env.reset(seed=0)
    for _ in range(3):
        env.step(LIFT)
    env.close()
    (film,) = (tmp_path / "videos").iterdir()
    assert film.suffix == ".mp4"
    frames, _ = pytest.importorskip("imageio_ffmpeg").count_frames_and_secs(str(film))
    assert frames == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", [FEM, BULLET])
def test_500_resets_need_no_more_memory(make: Callable[..., TissueRetractEnv], name: str) -> None:
    """Every one on a new flap with a new grasp, squeezed."""
    resource = pytest.importorskip("resource")
    env = make(name, scene="random")
    used = []
    for k in range(500):
        env.reset(seed=k)
        env.step(env.action_space.sample() * 0.5)
        used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    # of the peak, in kB: 400 flaps that stayed would add some GB of finite elements, some 100 MB of Bullet's
    assert used[-1] - used[100] < 50_000
