"""Episodes of the environments: actions, ends, failures, options, wrong arguments, drawing, closing."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

import retract_env.physics.fem
from baselines.verification.flaps import flap, square_vein
from retract_env.env import TissueRetractEnv
from retract_env.errors import Diverged, SceneError
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, load_scene
from retract_env.task import SLICES, TaskConfig, default_scene
from tests.retract_env.playing import BULLET, FEM, LIFT, ROD, digest, play

ROOT = Path(__file__).resolve().parents[2]

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


@pytest.mark.parametrize("name", [FEM, BULLET])
def test_numbers_beyond_the_bounds_count_as_the_bounds(
    make: Callable[..., TissueRetractEnv], name: str
) -> None:
    env = make(name, grasp={"x": -0.03, "compression": 1e-3})
    answers = []
    for action in ([1e300, 2.0, -7.0], [1.0, 1.0, -1.0]):
        env.reset(seed=0)
        answers.append(env.step(np.array(action))[0])
    assert np.array_equal(answers[0], answers[1])
    for wrong in ([0, 0], [0, math.nan, 0], "up"):
        with pytest.raises(ValueError, match=r"^action"):
            env.step(wrong)
    assert np.array_equal(env.episode.task.observation(env.episode.now), answers[1])


def test_an_episode_ends_after_64_steps(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp="spring")
    seen, _ = env.reset(seed=0)
    for k in range(TaskConfig().steps):
        assert seen[SLICES["time_left"]] == pytest.approx(1 - k / 64)
        seen, _, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        assert (terminated, truncated) == (False, k == TaskConfig().steps - 1)
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
    with pytest.raises(Diverged, match="5 grasps could not be squeezed"):
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
        ({"grasp": "best"}, "^grasp = 'best', allowed 'agent', 'spring', x and compression, or x and force$"),
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
        ({"physics": "sofa"}, "^physics = 'sofa', allowed bullet, fem, rod$"),
        ({"resolution": "superb"}, "^resolution = 'superb', allowed coarse, medium, fine, finer$"),
        ({"obs": "sound"}, "^obs = 'sound', allowed state, pixels$"),
        ({"camera": "4d"}, "^camera = '4d', allowed section, 3d$"),
        ({"obs": "pixels", "view": "3d"}, "^view = '3d', allowed section, camera$"),
        ({"view": "camera"}, "^view = 'camera': allowed with obs = 'pixels' alone, not with 'state'$"),
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
    with pytest.raises(ImportError, match=r"make bullet; TissueRetractFEM-v0"):
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


@pytest.mark.parametrize("name", [FEM, BULLET, ROD])
def test_frames_in_space(make: Callable[..., TissueRetractEnv], name: str) -> None:
    env = make(name, camera="3d", render_mode="rgb_array")
    env.reset(seed=0)
    frames = [env.render()]
    for action in (np.zeros(3), LIFT):
        env.step(action)
        frames.append(env.render())
    assert len({frame.tobytes() for frame in frames if frame is not None}) == 3
    again = make(name, camera="3d", render_mode="rgb_array")
    again.reset(seed=0)
    assert np.array_equal(again.render(), frames[0])  # type: ignore[arg-type]


def test_pixels_through_the_camera_see_moves_and_are_no_section(
    make: Callable[..., TissueRetractEnv],
) -> None:
    env, section = make(ROD, obs="pixels", view="camera"), make(ROD, obs="pixels")
    first, _ = env.reset(seed=0)
    assert not np.array_equal(first, section.reset(seed=0)[0])
    held, lifted = env.step(np.zeros(3))[0], env.step(LIFT)[0]
    for seen in (first, held, lifted):
        assert seen in env.observation_space
    assert len({seen.tobytes() for seen in (first, held, lifted)}) == 3


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
