"""The environments as Gymnasium, Stable-Baselines3 and their users meet them."""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import retract_env.physics.pool
from retract_env import task
from retract_env.env import TissueRetractEnv
from retract_env.physics.base import Diverged, TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, SceneError, load_scene, sample_scene
from retract_env.task import SLICES, default_scene
from tests.retract_env.bodies import flap, square_vein

ROOT = Path(__file__).resolve().parents[2]
FEM, BULLET = "TissueRetractFEM-v0", "TissueRetract-v0"
LIFT = np.array([0.1, 0.9, -0.9], np.float32)


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def make() -> Iterator[Callable[..., TissueRetractEnv]]:
    """The bare environment, closed at the end."""
    made: list[TissueRetractEnv] = []

    def make(**options: Any) -> TissueRetractEnv:
        env = gym.make(FEM, **options).unwrapped
        assert isinstance(env, TissueRetractEnv)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


def play(env: gym.Env[Any, Any], seed: int, steps: int = 12) -> list[Any]:
    """All that an episode says: mostly lifts, so that it lasts."""
    rng = np.random.default_rng(seed)
    said: list[Any] = [env.reset(seed=seed)]
    for k in range(steps):
        action = LIFT + 0.1 * rng.standard_normal(3) if k else np.array([-0.2, 0.1, 0.0])
        said.append(env.step(action.astype(np.float32)))
        if said[-1][2] or said[-1][3]:
            break
    return said


def digest(said: list[Any]) -> str:
    """Of every bit of it."""
    plain = [[x.tobytes().hex() if isinstance(x, np.ndarray) else x for x in one] for one in said]
    return hashlib.sha256(json.dumps(plain).encode()).hexdigest()


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


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_gymnasium_checks_it(make: Callable[..., TissueRetractEnv], options: dict[str, Any]) -> None:
    check_env(make(**options), skip_render_check=options.get("render_mode") is None)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
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
        "from tests.retract_env.test_env import FEM, digest, gym, play\n"
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


@pytest.mark.parametrize("options", [o for o in OPTIONS if "render_mode" not in o], ids=str)
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
    env: Any = gym.wrappers.RecordVideo(make(grasp="spring", render_mode="rgb_array"), str(tmp_path / "videos"))
    env.reset(seed=0)
    for _ in range(3):
        env.step(LIFT)
    env.close()
    assert [path.suffix for path in (tmp_path / "videos").iterdir()] == [".mp4"]


# --- Actions, ends and failures


def test_the_first_action_closes_the_jaws(make: Callable[..., TissueRetractEnv]) -> None:
    env = make()
    seen, _ = env.reset()
    assert not seen[SLICES["holding"]] and env.episode.path is None
    seen, *_ = env.step(np.zeros(3, np.float32))
    episode: Any = env.episode
    grasp = episode.grasp
    assert seen[SLICES["holding"]] == 1
    assert seen[SLICES["gripper"]] == pytest.approx([grasp.x / 0.05, 0.5 * 4.4e-3 / 0.05], rel=1e-6)
    assert seen[SLICES["separation"]] == pytest.approx(1 - grasp.compression / 4.4e-3, rel=1e-6)
    before = episode.now.state.jaws
    env.step(np.array([1.0, 0.5, 0.0]))
    assert episode.now.state.jaws - before == pytest.approx([2e-3, 1e-3, 2e-3, 1e-3], abs=1e-15)
    assert episode.path.last == 2
    assert episode.path.waypoints[1:] == pytest.approx(np.array([before, episode.now.state.jaws]))


@pytest.mark.parametrize("action", [[0, 0], np.zeros((1, 3)), [0, 0, math.nan], [math.inf, 0, 0], "up", None])
def test_what_is_no_action_changes_nothing(make: Callable[..., TissueRetractEnv], action: Any) -> None:
    env = make(grasp="spring")
    env.reset(seed=0)
    before = env.episode.now
    with pytest.raises(ValueError, match=r"^action") as caught:
        env.step(action)
    assert "\n" not in str(caught.value)
    assert env.episode.now is before
    env.step(np.zeros(3))


def test_an_episode_ends_after_64_steps(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp="spring")
    seen, _ = env.reset(seed=0)
    for k in range(task.MAX_STEPS):
        assert seen[SLICES["time_left"]] == pytest.approx(1 - k / 64)
        seen, _, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        assert (terminated, truncated) == (False, k == task.MAX_STEPS - 1)
    assert seen[SLICES["time_left"]] == 0
    assert not info["failure"] and not info["is_success"]
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3, np.float32))


@pytest.mark.parametrize(
    ("grasp", "move", "failure"),
    [
        ((0.0, 1.0), (0, 0, 0), "strain"),
        ((0.0, -0.8), (0, 1, 1), "slip"),
        ((0.0, -0.8), (0, -1, 0), "release"),
    ],
)
def test_broken_limits_end_an_episode(
    make: Callable[..., TissueRetractEnv],
    grasp: tuple[float, float],
    move: tuple[float, ...],
    failure: str,
) -> None:
    env = make()
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.array([*grasp, 0.0]))
    while not (terminated or truncated):
        _, reward, terminated, truncated, info = env.step(np.array(move))
    assert terminated and not truncated
    assert info["failure"] == failure
    assert info["cost"] >= 1 and not info["is_success"] and reward < 0


class Fails(FemPhysics):
    """Loses its way at the given move; the squeeze is the first."""

    at = 1
    answer: str = "raises"

    def move_to(self, pose: NDArray[Any], progress: float | None = None) -> TissueState:
        self.moves = getattr(self, "moves", 0) + 1
        state = super().move_to(pose, progress)
        if self.moves < self.at:
            return state
        if self.answer == "raises":
            raise Diverged("on purpose")
        state.points[0] = math.nan
        return state


@pytest.mark.parametrize("answer", ["raises", "nan"])
@pytest.mark.parametrize("at", [1, 3])
def test_a_physics_that_cannot_go_on_truncates(
    make: Callable[..., TissueRetractEnv], monkeypatch: pytest.MonkeyPatch, at: int, answer: str
) -> None:
    monkeypatch.setattr(Fails, "at", at)
    monkeypatch.setattr(Fails, "answer", answer)
    monkeypatch.setattr(retract_env.physics.fem, "FemPhysics", Fails)
    env = make()
    env.reset(seed=0)
    for k in range(1, at + 1):
        seen, reward, terminated, truncated, info = env.step(np.zeros(3) if k == 1 else LIFT / 2)
        assert (terminated, truncated) == (False, k == at)
        assert np.isfinite(seen).all() and seen in env.observation_space
    assert info["failure"] == "diverged"
    assert not info["is_success"] and math.isfinite(reward)
    assert seen[SLICES["holding"]] == (at > 1)


def test_a_grasp_that_was_asked_for_and_diverges_is_an_error(
    make: Callable[..., TissueRetractEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retract_env.physics.fem, "FemPhysics", Fails)
    env = make(grasp="spring")
    with pytest.raises(Diverged, match="no grasp"):
        env.reset()
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3))


# --- Options


def test_options_change_one_episode(make: Callable[..., TissueRetractEnv]) -> None:
    env = make()
    other = flap(veins=[square_vein(-0.02, 0.0024, 0.0008)])
    line = {"camera": [-0.1, 0.05], "target": [-0.01, 0.0]}
    seen, info = env.reset(
        options={"scene": other.dump(), "grasp": {"x": -0.03, "compression": 1e-3}, "line_of_sight": line}
    )
    scene = env.episode.task.scene
    assert scene.tissue == other.tissue
    assert scene.line_of_sight.camera == (-0.1, 0.05)
    assert env.episode.grasp is not None and env.episode.grasp.x == -0.03
    assert seen[SLICES["holding"]] == 1 and seen[SLICES["time_left"]] == 1
    assert info["max_strain"] > 0
    seen, info = env.reset()
    assert env.episode.task.scene == default_scene()
    assert seen[SLICES["holding"]] == 0 and info["max_strain"] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"grip": "spring"}, "^options: unknown grip$"),
        ({"grasp": "best"}, "^grasp = 'best', allowed 'agent', 'spring' or x and compression$"),
        ({"grasp": {"x": -0.03}}, "^grasp = "),
        ({"grasp": {"x": -0.06, "compression": 1e-3}}, r"^grasp\.x = -0\.06 m, allowed \[-0\.05, 0\) m$"),
        ({"scene": {"name": "nothing"}}, "missing"),
        ({"scene": "no/such.yaml"}, "no/such.yaml"),
        ({"line_of_sight": {"camera": [-0.1, 0.05]}}, "line_of_sight.target: missing"),
    ],
)
def test_wrong_options_say_what_is_allowed(
    make: Callable[..., TissueRetractEnv], options: dict[str, Any], message: str
) -> None:
    env = make()
    env.reset()
    with pytest.raises(ValueError, match=message) as caught:
        env.reset(options=options)
    assert "\n" not in str(caught.value)
    env.reset()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"physics": "sofa"}, "^physics = 'sofa', allowed bullet, fem$"),
        ({"resolution": "superb"}, "^resolution = 'superb', allowed coarse, medium, fine, finer$"),
        ({"obs": "sound"}, "^obs = 'sound', allowed state, pixels$"),
        ({"camera": "3d"}, "^camera = '3d', allowed section$"),
        ({"render_mode": "ansi"}, "^render_mode = 'ansi', allowed None, human, rgb_array$"),
        ({"grasp": 3}, "^grasp = 3, allowed"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TissueRetractEnv(**({"physics": "fem"} | arguments))


def test_a_scene_that_cannot_be_used_is_a_scene_error() -> None:
    with pytest.raises(SceneError):
        TissueRetractEnv("fem", scene=str(ROOT / "nothing.yaml"))


def test_without_pybullet_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match=r"pip install \"retract\[bullet\]\".*TissueRetractFEM-v0"):
        gym.make(BULLET)


# --- Drawing and closing


def test_frames(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    frames = [env.render()]
    for action in (np.zeros(3), LIFT):
        env.step(action)
        frames.append(env.render())
    for frame in frames:
        assert frame is not None and frame.shape == (480, 640, 3) and frame.dtype == np.uint8
    assert len({frame.tobytes() for frame in frames if frame is not None}) == 3
    assert make().render() is None


def test_pixels_show_the_episode(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(obs="pixels", scene="random")
    images = [env.reset(seed=0)[0], env.step(np.zeros(3))[0], env.step(LIFT)[0]]
    assert all(image in env.observation_space for image in images)
    assert len({image.tobytes() for image in images}) == 3
    assert not np.array_equal(env.reset(seed=1)[0], images[0])


def test_closing_twice_and_going_on(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp="spring", render_mode="human")
    said = digest(play(env, 0, steps=2))
    env.close()
    env.close()
    with pytest.raises(ResetNeeded):
        env.step(LIFT)
    assert digest(play(env, 0, steps=2)) == said


def test_nothing_works_before_reset(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(render_mode="rgb_array")
    for work in (lambda: env.step(LIFT), env.render, lambda: env.episode):
        with pytest.raises(ResetNeeded):
            work()


def test_default_scene_from_file_and_data_are_the_same_episode(make: Callable[..., TissueRetractEnv]) -> None:
    path = ROOT / "configs" / "scenes" / "homogeneous.yaml"
    sources: list[Any] = [None, str(path), load_scene(path).dump(), Scene.from_data(default_scene().dump())]
    assert len({digest(play(make(scene=source), 0, steps=2)) for source in sources}) == 1


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
