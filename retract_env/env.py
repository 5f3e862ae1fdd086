"""The retraction task as a Gymnasium environment: a thin shell around an episode and the task's rules.

From an action to an equilibrium and back: `step` here, `Episode.act` (task/episode.py), `move_to` of a
physics (physics/fem.py), and what is made of its state (task/task.py, task/observation.py).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.stage import CAMERAS, PIXELS, VIEWS, Stage
from retract_env.given import Unknowns, check_choices, read_grasp, read_options, read_scene, read_settings
from retract_env.grasp import Grasp
from retract_env.physics.pool import PhysicsPool
from retract_env.scene import UNKNOWNS, Scene, sample_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.task import Outcome, RetractionTask, Sensors, TaskConfig, actions
from retract_env.task.episode import Episode, EpisodeState
from retract_env.task.observation import bounds


@dataclass(frozen=True, repr=False, eq=False)
class EnvState:
    """Where an environment stood, for `set_state`. It can be pickled; not to be changed."""

    physics: str
    resolution: str
    task: TaskConfig
    episode: EpisodeState
    over: bool
    random: np.random.Generator
    seed: int | None


class TissueRetractEnv(gym.Env[NDArray[Any], NDArray[Any]]):
    """
    ## Description

    Tissue retraction for exposure: a gripper with two jaws grasps a flap of soft tissue that lies on a bed
    and is fixed at one end, and lifts it until a camera sees the bed up to a target point, without tearing
    the tissue and without losing hold. Stiffer veins may run through the flap. The problem is that of Jansen,
    Hauser, Chentanez, van der Stappen and Goldberg, IROS 2009.

    `TissueRetractFEM-v0` computes the flap by quasi-static finite elements, `TissueRetractRod-v0` as a rod,
    `TissueRetract-v0` as a soft body of PyBullet (with wheels on CPython 3.10 and 3.11 on Linux, x86-64, else
    `pip install "retract[bullet]"` compiles it); spaces, rewards and meaning are the same.

    The flap fills x in [-length, 0], y in [0, height] at rest and is fixed at x = 0. Gravity acts along -y,
    the camera looks from the upper left.

    ## Action Space

    `Box(-1, 1, (3,), float32)`. Numbers outside are clipped; NaN, infinity and other shapes raise ValueError.

    The first action of an episode chooses the grasp, unless the environment does (`grasp`); the jaws then
    close:

    | Num | Action | -1 | 1 |
    | --- | --- | --- | --- |
    | 0 | position along the flap | free end | 0.55 jaw widths before the fixed end |
    | 1 | compression of the flap between the jaws, geometrically | 0.02 s height | 0.5 height |
    | 2 | none | | |

    s is the square of the flap's height over its length, over that of the paper's flap, where it is 1. The
    lightest grip is at most half of the firmest, and what would be firmer than that is the firmest. With
    `grip="force"` number 1 is the force with which the jaws press, geometrically from 0.03 s to 1 E w d: E is
    the tissue's modulus, w the jaws' width, d the flap's depth. For the paper's flap that is 5 to 176 mN;
    Eq. 5's compression, a quarter of the height, presses with 109 mN there, and one of 0.02 with some 8. The
    force is the mean of both jaws' normal reactions, which differ by what they lift.

    Every later action moves the gripper; the distance between its jaws stays, or with `grip="force"` the
    force does, and the jaws give. `task` changes how far, and the range of the compression and of the force:

    | Num | Action | -1 | 1 |
    | --- | --- | --- | --- |
    | 0 | move along x | -2 mm | 2 mm |
    | 1 | move along y | -2 mm | 2 mm |
    | 2 | turn, counter-clockwise | -6 degrees | 6 degrees |

    ## Observation Space

    `obs="state"`: `Box(float32)` of shape (111,), whose parts `retract_env.task.SLICES` names. Values are
    clipped to their bounds. The bound 2 of strain and friction is the task's cap; the unit of `forces` is the
    one above. `sensors` blurs parts of it or leaves them out.

    | Num | Name | Observation | Min | Max | Unit |
    | --- | --- | --- | --- | --- | --- |
    | 0 | `holding` | 0 until the grasp is chosen, 1 with closed jaws | 0 | 1 |  |
    | 1 | `time_left` | steps that are left | 0 | 1 | all steps |
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
    | 107-110 | `forces` | what the lower jaw presses and drags with, then the upper one | -10 | 10 | E w d |

    `obs="pixels"`: `Box(0, 255, (96, 96, 3), uint8)`, the section in the camera's plane, coloured by strain,
    or with `view="camera"` what the camera A itself sees, in which strain does not show.

    ## Rewards

    The sum of these terms, each of which `info["reward_terms"]` gives by name; `task` changes the weights:

    - *exposure*: growth of the exposure.
    - *clearance*: share of the way from the clearance at rest to zero that was made.
    - *strain*: -0.5 times the growth of the episode's greatest strain over its limit, up to 2.
    - *friction*: -0.25 times the growth of the episode's greatest needed friction over its limit, up to 2.
    - *success*: 1 + margin in the step that brings the target into view, the margin being 1 - greatest
      strain / limit, or 0.
    - *failure*: -1 in the step that breaks a limit.

    A step's reward, and that of a whole episode, lies in `task_config.reward_range`, which is [-4.5, 4].

    `info` also holds `is_success`; `failure` ("", "strain", "slip", "release", "contact" or
    "diverged"); for safe reinforcement learning `cost`, how many limits are broken now, and `cost_terms`, by
    how much of itself each of them, of `strain` and of `friction`, is exceeded now: 0 where it holds, at most
    the cap less 1, also where a jaw would have to pull; `max_strain` and `required_friction`, the greatest so
    far; `clearance` (m) and `exposure` now.

    ## Starting State

    The flap at rest and the gripper open in front of its free end. With a grasp that the environment takes,
    the jaws have closed on it already.

    `reset(options=...)` changes one episode: `scene` and `grasp` as the arguments below, `line_of_sight` as a
    scene has it, `{"camera": [x, y], "target": [x, 0.0]}`, and `unknowns`.

    ## Episode End

    Limits and success are those of the certifier (`retract_env.objectives.verdict`), asked after each step.

    1. Termination: success, no tissue lies below the line of sight, or as far above it as the scene asks
       (`limits.clearance`).
    2. Termination: a limit breaks. The tissue tears ("strain"), or a jaw slips ("slip") or would have to pull
       ("release"), or tissue runs into itself, which is not computed, or too far into the block that holds
       the fixed end ("contact"). A move may stop where that happens.
    3. Truncation: 64 steps were taken, or as many as `task` says; `spec.max_episode_steps` says it too.
    4. Truncation: the physics cannot go on ("diverged"); the last good state is observed, nothing is rewarded
       but what led there.

    With `task={"limits": "cost"}` a broken limit ends nothing, and no move stops for it: the episode goes on
    until the target is in view or time is up. The first broken limit counts once as *failure*; `is_success`
    is what a certifier would say, so it stays False, and `failure` names the limit to the end. With
    `{"limits": "cost", "weights": {"failure": 0, "strain": 0, "friction": 0}}` the reward knows nothing of
    limits but the margin of success, and `cost` or `cost_terms` nothing but them.

    ## Arguments

    All can be written as JSON.

    - `physics` (`"bullet"`): a name of `retract_env.physics.registry.PHYSICS`: `"bullet"`, `"fem"`, `"rod"`.
    - `scene` (`None`): path of a scene's YAML file, a scene as plain data (`Scene.dump()`), `"random"` for a
      new one from the seed at each reset, or None for the paper's flap without veins.
    - `grasp` (`"agent"`): `"agent"` lets the first action choose; `"spring"` takes the best grasp of the
      spring model at reset that can be squeezed, of the first five; `{"x": m, "compression": m}` takes this
      one, `{"x": m, "force": N}` one that presses so.
    - `grip` (`None`): `"force"` or `"compression"`, what the second number of the first action is; a spring
      model's grasp then presses as hard as closing so far is expected to. None is the task's own,
      `"compression"`.
    - `resolution` (`None`): `"coarse"`, `"medium"`, `"fine"`, ...; None is `"coarse"` for fem, `"medium"` for
      bullet; the rod has `"rod"` alone.
    - `obs` (`"state"`): `"state"` or `"pixels"`.
    - `view` (`"section"`): what pixels show, `"section"`, or `"camera"` for what the camera A sees.
    - `render_mode` (`None`): `"rgb_array"`, frames of 640 x 480, or `"human"`.
    - `camera` (`"section"`): what frames show, `"section"`, or `"3d"` for the scene in space.
    - `task` (`None`): what differs from `retract_env.task.TaskConfig()`: `weights` (those of the terms
      above), `steps` (64), `move` ([0.002, 0.002, 0.105], m, m, rad: how far -1 or 1 moves the gripper),
      `grip`, as above, `compression` ([0.02, 0.5], least and greatest, over the height), `force` ([0.03, 1],
      over E w d), `cap` (2), `limits` (`"end"` or `"cost"`). Gymnasium's own `max_episode_steps` can only cut
      episodes short, unseen by `time_left`.
    - `ranges` (`None`): what `scene="random"` draws from where it differs from
      `retract_env.scene.sampling.SceneRanges()`: `{"veins": [0, 5], "slope": [0.5, 1.2]}`.
    - `unknowns` (`None`): True, and each episode is on a flap that is not quite what the scene says, see
      below; a mapping does so with ranges that count instead of the scenes' own, `{"modulus": 0.5}`.
    - `sensors` (`None`): `{"noise": ..., "hide": [...]}`. `noise`: deviation of Gaussian noise on parts of
      the observation, in the units above, `{"strain": 0.1, "k_eq": 0.5}`, or a number for all parts but
      `holding` and `time_left`; it comes from the environment's seed and leaves no bound. `hide`: names of
      parts that are observed as 0.

    ## Unknowns

    With `unknowns` flap, grip and line of sight are drawn anew in each episode from the scene's own
    `uncertainty` (docs/robustness.md), from the environment's seed. Physics, strain, needed friction and its
    limit, clearance, exposure, rewards and the end are those of what was drawn. The policy knows what a
    robot knows: `target`, `slope`, `nearness` and `k_eq`, and what its actions mean, are the scene's;
    `gripper`, and `separation` where the jaws hold by compression, are where the jaws were sent to; a camera
    sees the keypoints, and `forces` are felt, as they are.

    `info["unknowns"]` is the draw, (11,) in [-1, 1], in the order of `retract_env.scene.UNKNOWNS`;
    `reset(options={"unknowns": z})` makes one episode that draw, also without the argument. Jaws that turn
    out not to close on the flap at all have let go: the episode ends with "release", one that would have
    begun on this grasp with its first step.

    ## Copies

    `copy.deepcopy(env)` and pickles go on from where the environment stands, as it would have gone on, to the
    last bit, on a flap of their own: Bullet's makes the moves of the episode again before its next step.

    ## Look-ahead

    `x = env.unwrapped.get_state()` is where the environment stands, its random numbers included, and
    `env.unwrapped.set_state(x)` goes back there, as often as asked, also in other environments of the same
    `physics`, `resolution` and `task`, whose scene or grasp may be another now, and in other processes: x can
    be pickled. The same actions then lead to the same observations, rewards and infos, to the last bit. Look
    ahead with `env.unwrapped.step`, as wrappers keep counts of their own.

    Either takes a millisecond or two. On Bullet the flap makes its moves again before the next step.

    ## Version History

    - v0: first version. Later with `grip` and `unknowns`, whose defaults change nothing, with `forces` at the
      end of the observation, (107,) before, and with a lightest grip of 0.02 s instead of 0.02 of the height.
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
        task: Mapping[str, Any] | TaskConfig | None = None,
        ranges: Mapping[str, Any] | SceneRanges | None = None,
        sensors: Mapping[str, Any] | Sensors | None = None,
        grip: str | None = None,
        unknowns: Unknowns = None,
        view: str = "section",
    ):
        """Raises ValueError (ConfigError) for what is not allowed, ImportError where the physics needs a
        package that is missing."""
        self._pool = PhysicsPool(physics, resolution)
        check_choices(
            ("obs", obs, ("state", "pixels")),
            ("view", view, VIEWS),
            ("camera", camera, CAMERAS),
            ("render_mode", render_mode, (None, *self.metadata["render_modes"])),
        )
        self._settings = settings = read_settings(task, ranges, sensors, grip, unknowns)
        self.task_config = settings.task
        self._scene, self._grasp = self._pool.kind.accepted(read_scene(scene)), read_grasp(grasp)
        if ranges is not None and self._scene != "random":
            raise ValueError("ranges: allowed with scene = 'random' alone")
        if sensors is not None and obs != "state":
            raise ValueError(f"sensors: allowed with obs = 'state' alone, not with {obs!r}")
        if view != VIEWS[0] and obs != "pixels":
            raise ValueError(f"view = {view!r}: allowed with obs = 'pixels' alone, not with {obs!r}")
        self.obs, self.render_mode = obs, render_mode
        self.action_space = spaces.Box(-1.0, 1.0, (actions.SIZE,), np.float32)
        if obs == "state":
            low, high = bounds(self.task_config)
            self.observation_space: spaces.Space[NDArray[Any]] = spaces.Box(low, high, dtype=np.float32)
        else:
            self.observation_space = spaces.Box(0, 255, (PIXELS[1], PIXELS[0], 3), np.uint8)
        self._spec: EnvSpec | None = None
        self._task: RetractionTask | None = None
        self._episode: Episode | None = None
        self._over = True
        self._stage = Stage(camera, view, self.metadata["render_fps"])

    @property
    def spec(self) -> EnvSpec | None:
        """What `gym.make` made it from; max_episode_steps is the task's number of steps."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, max_episode_steps=self.task_config.steps)

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

        Raises ValueError for others and a law that the physics does not know, Diverged for a failed squeeze.
        """
        super().reset(seed=seed)
        asked, settings = read_options(options), self._settings
        source, grasp, z = asked.scene or self._scene, asked.grasp or self._grasp, asked.unknowns
        scene = source if isinstance(source, Scene) else sample_scene(self.np_random, settings.ranges)
        if asked.line_of_sight is not None:
            scene = Scene.from_data(scene.dump() | {"line_of_sight": asked.line_of_sight})
        if z is None and settings.unknowns is not None:
            z = self.np_random.uniform(-1.0, 1.0, len(UNKNOWNS))
        episode = self._begin(settings.prior(self._pool.kind.accepted(scene)), z)
        if grasp != "agent":
            episode.take(grasp if isinstance(grasp, Grasp) else None)
        self._over = False
        if self.render_mode == "human":
            self._stage.show(episode)
        return self._observation(), episode.task.info(episode.now, None, Outcome())

    def _begin(self, scene: Scene, z: NDArray[np.float64] | None) -> Episode:
        """A new episode, which is over until it can go on."""
        if z is not None or self._task is None or self._task.z is not None or self._task.stated != scene:
            self._task = RetractionTask(scene, self.task_config, z)
        self._over, self._episode = True, Episode(self._task, self._pool)
        return self._episode

    def step(self, action: ArrayLike) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Close the jaws or move them. Raises ValueError for what is no action, ResetNeeded after the end."""
        if self._over:
            raise ResetNeeded("the episode is over: reset the environment first")
        episode, rules = self.episode, self.episode.task
        before = episode.now
        episode.act(action)
        outcome = Outcome(failure="diverged") if episode.diverged else rules.judge(before, episode.now)
        terminated = outcome.over
        truncated = not terminated and (episode.diverged or episode.now.steps >= self.task_config.steps)
        self._over = terminated or truncated
        if self.render_mode == "human":
            self._stage.show(self.episode)
        terms = rules.reward_terms(before, episode.now, outcome)
        info = rules.info(episode.now, terms, outcome)
        reward = 0.0
        for term in terms.values():  # in turn: what `sum` makes of floats differs between Python's versions
            reward += term
        return self._observation(), reward, terminated, truncated, info

    def get_state(self) -> EnvState:
        """Where the environment stands, to be kept, pickled, and set any number of times.

        Raises ResetNeeded before the first reset.
        """
        pool, episode = self._pool, self.episode.get_state()
        random = copy.deepcopy(self.np_random)
        task, seed = self.task_config, self._np_random_seed
        return EnvState(pool.kind.name, pool.resolution, task, episode, self._over, random, seed)

    def set_state(self, state: EnvState) -> None:
        """Go on from where this environment stood, or another of the same physics, resolution and task.

        Raises TypeError for what is no state, ValueError for that of an environment made otherwise; nothing
        has changed then.
        """
        if not isinstance(state, EnvState):
            raise TypeError(f"a state of get_state is needed, not {type(state).__name__}")
        for name, theirs, ours in (
            ("physics", state.physics, self._pool.kind.name),
            ("resolution", state.resolution, self._pool.resolution),
        ):
            if theirs != ours:
                raise ValueError(f"the state is of an environment with {name} = {theirs!r}, here {ours!r}")
        self._settings.check_same_task(state.task)
        self._begin(state.episode.stated, state.episode.z).set_state(state.episode)
        self._over = state.over
        self._np_random, self._np_random_seed = copy.deepcopy(state.random), state.seed

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
        exact = self.episode.task.observation(self.episode.now)
        return self._settings.sensors.read(exact, self.task_config, self.np_random)
