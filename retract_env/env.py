"""The retraction task as a Gymnasium environment: a thin shell around episode.py, task.py and actions.py."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.stage import PIXELS, Stage
from retract_env.grasp import Grasp
from retract_env.physics.registry import DEFAULT_RESOLUTION, PhysicsPool
from retract_env.scene import Scene, load_scene, sample_scene
from retract_env.task import actions, task
from retract_env.task.episode import Episode


class TissueRetractEnv(gym.Env[NDArray[Any], NDArray[Any]], EzPickle):
    """
    ## Description

    Tissue retraction for exposure: a gripper with two jaws grasps a flap of soft tissue that lies on a bed
    and is fixed at one end, and lifts it until a camera sees the bed up to a target point, without tearing
    the tissue and without losing hold. Stiffer veins may run through the flap. The problem is that of Jansen,
    Hauser, Chentanez, van der Stappen and Goldberg, IROS 2009.

    `TissueRetractFEM-v0` computes the flap by quasi-static finite elements, `TissueRetract-v0` as a soft body
    of PyBullet (installed with the rest where it has wheels: CPython 3.10 and 3.11 on Linux, x86-64;
    elsewhere `pip install "retract[bullet]"` compiles it); spaces, rewards and meaning are the same.

    The flap fills x in [-length, 0], y in [0, height] at rest and is fixed at x = 0. Gravity acts along -y,
    the camera looks from the upper left.

    ## Action Space

    `Box(-1, 1, (3,), float32)`. Numbers outside are clipped; NaN, infinity and other shapes raise ValueError.

    The first action of an episode chooses the grasp, unless the environment does (`grasp`); the jaws then
    close:

    | Num | Action | -1 | 1 |
    | --- | --- | --- | --- |
    | 0 | position along the flap | free end | 0.55 jaw widths before the fixed end |
    | 1 | compression of the flap between the jaws, geometrically | 0.02 height | 0.5 height |
    | 2 | none | | |

    Every later action moves the gripper; the distance between its jaws stays:

    | Num | Action | -1 | 1 |
    | --- | --- | --- | --- |
    | 0 | move along x | -2 mm | 2 mm |
    | 1 | move along y | -2 mm | 2 mm |
    | 2 | turn, counter-clockwise | -6 degrees | 6 degrees |

    ## Observation Space

    `obs="state"`: `Box(float32)` of shape (107,), whose parts `retract_env.task.SLICES` names. Values are
    clipped to their bounds.

    | Num | Name | Observation | Min | Max | Unit |
    | --- | --- | --- | --- | --- | --- |
    | 0 | `holding` | 0 until the grasp is chosen, 1 with closed jaws | 0 | 1 |  |
    | 1 | `time_left` | steps that are left | 0 | 1 | 64 steps |
    | 2-3 | `gripper` | midpoint of the jaws, x and y | -3 | 3 | length |
    | 4-5 | `angle` | sine and cosine of the jaw axis' angle, from +y, counter-clockwise | -1 | 1 |  |
    | 6 | `separation` | distance between the jaws | 0 | 2 | height |
    | 7-26 | `lower` | keypoints of the lower surface from the free end on, x y x y | -3 | 3 | length |
    | 27-46 | `upper` | keypoints of the upper surface, likewise | -3 | 3 | length |
    | 47 | `target` | x of B, where the line of sight meets the bed | -1 | 0 | length |
    | 48 | `slope` | angle between the line of sight and the bed | 0 | 2 | rad |
    | 49 | `nearness` | one over the distance from B to the camera | 0 | 10 | 1 / length |
    | 50-99 | `k_eq` | stiffness along the flap from the free end on | 0 | 10 | modulus / height |
    | 100 | `strain` | eps_1% now | 0 | 2 | limit |
    | 101 | `max_strain` | greatest eps_1% so far | 0 | 2 | limit |
    | 102-103 | `friction` | friction that the lower and the upper jaw need now | 0 | 2 | limit |
    | 104 | `max_friction` | greatest friction needed so far | 0 | 2 | limit |
    | 105 | `clearance` | signed distance of the lowest tissue to the line of sight | -3 | 3 | length |
    | 106 | `exposure` | fraction of the area of interest that the camera sees | 0 | 1 |  |

    `obs="pixels"`: `Box(0, 255, (96, 96, 3), uint8)`, the section as the camera's plane shows it, coloured by
    strain.

    ## Rewards

    The sum of these terms, each of which `info["reward_terms"]` gives by name; the weights are
    `retract_env.task.WEIGHTS`:

    - *exposure*: growth of the exposure.
    - *clearance*: share of the way from the clearance at rest to zero that was made.
    - *strain*: -0.5 times the growth of the episode's greatest strain over its limit, up to 2.
    - *friction*: -0.25 times the growth of the episode's greatest needed friction over its limit, up to 2.
    - *success*: 1 + margin in the last step, the margin being 1 - greatest strain / limit.
    - *failure*: -1 where a limit breaks.

    A step's reward, and that of a whole episode, lies in [-4.5, 4].

    `info` also holds `is_success`; `failure` ("", "strain", "slip", "release" or "diverged"); `cost`, how
    many limits are broken, for safe reinforcement learning; `max_strain` and `required_friction`, the
    greatest so far; `clearance` (m) and `exposure` now.

    ## Starting State

    The flap at rest and the gripper open in front of its free end. With a grasp that the environment takes,
    the jaws have closed on it already.

    `reset(options=...)` changes one episode: `scene` and `grasp` as the arguments below, and `line_of_sight`
    as a scene has it, `{"camera": [x, y], "target": [x, 0.0]}`.

    ## Episode End

    Limits and success are those of the certifier (`retract_env.objectives.verdict`), asked after each step.

    1. Termination: success, no tissue lies below the line of sight.
    2. Termination: a limit breaks. The tissue tears ("strain"), or a jaw slips ("slip") or would have to pull
       ("release"). A move may stop where that happens.
    3. Truncation: 64 steps were taken.
    4. Truncation: the physics cannot go on ("diverged"); the last good state is observed, nothing is rewarded
       but what led there.

    ## Arguments

    All can be written as JSON.

    - `physics` (`"bullet"`): `"bullet"` or `"fem"`.
    - `scene` (`None`): path of a scene's YAML file, a scene as plain data (`Scene.dump()`), `"random"` for a
      new one from the seed at each reset, or None for the paper's flap without veins.
    - `grasp` (`"agent"`): `"agent"` lets the first action choose; `"spring"` takes the best grasp of the
      spring model at reset; `{"x": m, "compression": m}` takes this one.
    - `resolution` (`None`): `"coarse"`, `"medium"`, `"fine"`, ...; None is `"coarse"` for fem, `"medium"` for
      bullet.
    - `obs` (`"state"`): `"state"` or `"pixels"`.
    - `camera` (`"section"`): what frames show, `"section"`, or `"3d"` for Bullet's own picture (`rgb_array`).
    - `render_mode` (`None`): `"rgb_array"`, frames of 640 x 480, or `"human"`.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array"],
        "render_fps": 12,
    }

    def __init__(
        self,
        physics: str = "bullet",
        scene: str | Mapping[str, Any] | Scene | None = None,
        grasp: str | Mapping[str, float] = "agent",
        resolution: str | None = None,
        obs: str = "state",
        camera: str = "section",
        render_mode: str | None = None,
    ):
        """Raises ValueError (SceneError) for what is not allowed, ImportError where pybullet is missing."""
        EzPickle.__init__(self, physics, scene, grasp, resolution, obs, camera, render_mode)
        for name, value, allowed in (
            ("obs", obs, ("state", "pixels")),
            ("camera", camera, ("section", "3d") if physics == "bullet" else ("section",)),
            ("render_mode", render_mode, (None, *self.metadata["render_modes"])),
        ):
            if value not in allowed:
                raise ValueError(f"{name} = {value!r}, allowed {', '.join(map(str, allowed))}")
        self._pool = PhysicsPool(physics, resolution or DEFAULT_RESOLUTION.get(physics, ""))
        self._scene = read_scene(scene)
        self._grasp = read_grasp(grasp)
        self.obs, self.render_mode = obs, render_mode
        self.action_space = spaces.Box(-1.0, 1.0, (actions.SIZE,), np.float32)
        if obs == "state":
            self.observation_space: spaces.Space[NDArray[Any]] = spaces.Box(
                task.LOW, task.HIGH, dtype=np.float32
            )
        else:
            self.observation_space = spaces.Box(0, 255, (PIXELS[1], PIXELS[0], 3), np.uint8)
        self._task: task.RetractionTask | None = None
        self._episode: Episode | None = None
        self._over = True
        self._stage = Stage(camera, self.metadata["render_fps"])

    @property
    def episode(self) -> Episode:
        """The episode under way: scene, situation, grasp, jaw path. Raises ResetNeeded before the first."""
        if self._episode is None:
            raise ResetNeeded("reset the environment first")
        return self._episode

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode; the class says which options there are.

        Raises ValueError for others, Diverged where a grasp that was asked for cannot be squeezed.
        """
        super().reset(seed=seed)
        options = options or {}
        if unknown := set(options) - {"scene", "grasp", "line_of_sight"}:
            raise ValueError(f"options: unknown {', '.join(sorted(unknown))}")
        source = read_scene(options["scene"]) if "scene" in options else self._scene
        scene = source if isinstance(source, Scene) else sample_scene(self.np_random)
        if "line_of_sight" in options:
            scene = Scene.from_data(scene.dump() | {"line_of_sight": options["line_of_sight"]})
        grasp = read_grasp(options["grasp"]) if "grasp" in options else self._grasp
        if self._task is None or self._task.scene != scene:
            self._task = task.RetractionTask(scene)
        self._over, self._episode = True, Episode(self._task, self._pool)
        if grasp != "agent":
            self._episode.take(grasp if isinstance(grasp, Grasp) else None)
        self._over = False
        if self.render_mode == "human":
            self._stage.show(self.episode)
        terms = dict.fromkeys(task.WEIGHTS, 0.0)
        return self._observation(), self._task.info(self._episode.now, terms, None)

    def step(self, action: ArrayLike) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Close the jaws or move them. Raises ValueError for what is no action, ResetNeeded after the end."""
        if self._over:
            raise ResetNeeded("the episode is over: reset the environment first")
        episode, rules = self.episode, self.episode.task
        before = episode.now
        episode.act(action)
        verdict = None if episode.diverged else rules.verdict(episode.now)
        terminated = verdict is not None
        truncated = not terminated and (episode.diverged or episode.now.steps >= task.MAX_STEPS)
        self._over = terminated or truncated
        if self.render_mode == "human":
            self._stage.show(self.episode)
        terms = rules.reward_terms(before, episode.now, verdict)
        info = rules.info(episode.now, terms, verdict, episode.diverged)
        return self._observation(), sum(terms.values()), terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The frame (480, 640, 3) of `render_mode="rgb_array"`; None in the other modes."""
        return self._stage.frame(self.episode) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Give back physics and window; may be called again, and reset opens both anew."""
        self._pool.close()
        self._over = True
        self._stage.close()

    def _observation(self) -> NDArray[Any]:
        if self.obs == "pixels":
            return self._stage.pixels(self.episode)
        return self.episode.task.observation(self.episode.now)


def read_scene(source: str | Mapping[str, Any] | Scene | None) -> Scene | Literal["random"]:
    """A scene from what the environment was given. Raises SceneError."""
    if source is None:
        return task.default_scene()
    if source == "random":
        return "random"
    if isinstance(source, Scene):
        return source
    return Scene.from_data(source) if isinstance(source, Mapping) else load_scene(source)


def read_grasp(source: str | Mapping[str, float] | Grasp) -> Grasp | str:
    """The grasp that the environment was given, "agent" and "spring" as they are. Raises ValueError."""
    if isinstance(source, Grasp) or source in ("agent", "spring"):
        return source
    if isinstance(source, Mapping) and set(source) == {"x", "compression"}:
        return Grasp(source["x"], source["compression"])
    raise ValueError(f"grasp = {source!r}, allowed 'agent', 'spring' or x and compression")
