"""Many flaps at once: the retraction task on rods as Gymnasium's vector environment.

The flaps are computed side by side (`retract_env.task.lanes`), on all cores. This file is the shell around
it: arguments, spaces, seeds, threads, what infos look like.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from retract_env.compilation import announce
from retract_env.errors import Diverged, SceneError
from retract_env.given import (
    NOTHING,
    Options,
    Unknowns,
    check_choices,
    read_actions,
    read_grasp,
    read_mask,
    read_options,
    read_scene,
    read_seeds,
    read_settings,
)
from retract_env.grasp import Grasp
from retract_env.mesh.jaws import jaw_range, patch_ends
from retract_env.physics.registry import physics_kind
from retract_env.physics.rod import COMPILES
from retract_env.rod.block import advance_blocks
from retract_env.scene import Jaws, Scene, sample_scene
from retract_env.scene.pcg64 import state_of
from retract_env.scene.sampling import SceneRanges
from retract_env.task import Sensors, TaskConfig, actions
from retract_env.task.batch import (
    DISABLED,
    NEXT_STEP,
    SAME_STEP,
    act_range,
    advance_range,
    begin_range,
    settle_range,
    show_range,
    take_range,
)
from retract_env.task.episode import held, spring_grasps
from retract_env.task.flaps import Flaps, Workers
from retract_env.task.infos import infos_of
from retract_env.task.observation import bounds
from retract_env.threads import cores

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MODES = {
    AutoresetMode.NEXT_STEP: NEXT_STEP,
    AutoresetMode.SAME_STEP: SAME_STEP,
    AutoresetMode.DISABLED: DISABLED,
}
"""As the kernels know them."""


class TissueRetractVectorEnv(gym.vector.VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """
    ## Description

    `TissueRetractRod-v0` for many flaps at once, in one process and on all cores:
    `gym.make_vec("TissueRetractRod-v0", num_envs=1024, scene="random")`. Task, spaces, rewards and infos are
    those of `TissueRetractEnv` with `physics="rod"`. Environment k is the same, to the last bit, whatever
    `num_envs` and the number of threads are, and the same as a single one with its seed.

    ## Arguments

    Those of the single environment, but for pixels and rendering, and:

    - `grasp`: `"spring"` takes the spring model's best grasp alone, and fails where it cannot be squeezed,
      where the single environment tries the next ones.
    - `num_envs`: how many.
    - `autoreset_mode` (`"NextStep"`): `gymnasium.vector.AutoresetMode`, or its value. With `"SameStep"` the
      last observation and info of an episode are in `infos["final_obs"]` and `infos["final_info"]`. With
      `"Disabled"` nothing begins anew by itself: `reset(options={"reset_mask": (num_envs,) bool})` does it.
    - `threads` (`None`): how many compute; None is one a core that this process may use.

    ## Reset

    `reset(seed=...)`: an int seeds environment k with seed + k; a list has a seed, or None, for each. Without
    a seed the generators go on. `options`: `scene`, `grasp`, `line_of_sight` and `unknowns` as the single
    environment has them, for all environments that are reset (`unknowns` also (num_envs, 11), a draw for
    each), and `reset_mask`. `set_scene` puts any scene into any slot, for
    good.

    ## Look-ahead

    `get_state()` copies where all environments stand, generators too, and `set_state` returns there, any
    number of times; `state.repeated(k, n)` is the state of n environments like the k-th, to try n
    continuations at once.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        physics: str = "rod",
        scene: str | Mapping[str, Any] | Scene | None = None,
        grasp: str | Mapping[str, float] = "agent",
        resolution: str | None = None,
        obs: str = "state",
        render_mode: None = None,
        task: Mapping[str, Any] | TaskConfig | None = None,
        ranges: Mapping[str, Any] | SceneRanges | None = None,
        sensors: Mapping[str, Any] | Sensors | None = None,
        grip: str | None = None,
        unknowns: Unknowns = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
    ):
        """Raises ValueError (ConfigError) for what is not allowed."""
        check_choices(
            ("physics", physics, ("rod",)),
            ("resolution", resolution, (None, *physics_kind("rod").resolutions)),
            ("obs", obs, ("state",)),
            ("render_mode", render_mode, (None,)),
            ("autoreset_mode", autoreset_mode, (*MODES, *(mode.value for mode in MODES))),
        )
        for name, number in (("num_envs", num_envs), ("threads", 1 if threads is None else threads)):
            if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
                raise ValueError(f"{name} = {number!r}, allowed a whole number from 1 on")
        self.num_envs = int(num_envs)
        self._settings = settings = read_settings(task, ranges, sensors, grip, unknowns)
        self.task_config, self._ranges = settings.task, settings.ranges
        source, self._grasp = physics_kind("rod").accepted(read_scene(scene)), read_grasp(grasp)
        if ranges is not None and source != "random":
            raise ValueError("ranges: allowed with scene = 'random' alone")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = None
        low, high = bounds(self.task_config)
        self.single_action_space = spaces.Box(-1.0, 1.0, (actions.SIZE,), np.float32)
        self.single_observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        bare = settings.ranges.model_copy(update={"veins": (0, 0)})
        alike = settings.prior(sample_scene(np.random.default_rng(0), bare))
        unknown = settings.unknowns is not None
        self._flaps = Flaps(self.num_envs, settings.task, settings.ranges, settings.sensors, alike, unknown)
        self._sources: list[Scene | str] = [source] * self.num_envs
        self._seeds: list[int | None] = [None] * self.num_envs
        self._special = np.ones(self.num_envs, np.bool_)
        """whose next episode has to be prepared: at first, and where the one under way was an exception"""
        self._begun = np.zeros(self.num_envs, np.bool_)
        self._plain = np.full(self.num_envs, MODES[AutoresetMode.DISABLED], np.int8)
        announce(advance_blocks, "the rods' kernels", COMPILES)
        self._workers = Workers(threads or cores())

    # --- Episodes

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode everywhere, or where options["reset_mask"] says; see the class.

        Raises ValueError for other options, Diverged where a grasp that was asked for cannot be squeezed.
        """
        options = dict(options or {})
        mask = read_mask(options.pop("reset_mask", None), self.num_envs)
        each = read_seeds(seed, self.num_envs)
        asked = read_options(options, self.num_envs)
        self._begun &= ~mask  # should one of them fail
        for k in np.flatnonzero(mask):
            if each[k] is not None or self._seeds[k] is None:
                generator, self._seeds[k] = seeding.np_random(each[k])
                self._flaps.lanes.rng[k] = state_of(generator)
            if options or self._special[k]:
                z = asked.unknowns
                self._prepare(int(k), asked._replace(unknowns=z[k] if z is not None and z.ndim == 2 else z))
        self._begin(mask)
        return self._flaps.told.observation.copy(), infos_of(self._flaps.told.info, mask)

    def step(self, actions: ArrayLike) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """One step of all.

        Raises ValueError for what are no actions, ResetNeeded before the first reset, and for environments
        that are over where nothing begins anew by itself.
        """
        chosen = read_actions(actions, self.num_envs)
        flaps, told, over = self._flaps, self._flaps.told, self._flaps.lanes.over
        if not self._begun.all():
            raise ResetNeeded("reset the environments first")
        if self.autoreset_mode == AutoresetMode.DISABLED and over.any():
            which = ", ".join(map(str, np.flatnonzero(over)[:5]))
            raise ResetNeeded(f"environments that are over, {which}: reset them with reset_mask first")
        modes = np.full(self.num_envs, MODES[self.autoreset_mode], np.int8)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            for k in np.flatnonzero(over & self._special):
                self._prepare(int(k))
        elif self._special.any():
            modes[self._special] = MODES[AutoresetMode.DISABLED]
        self._workers.run(act_range, flaps, chosen, modes)
        self._workers.run(advance_range, flaps)
        self._workers.run(settle_range, flaps, False)
        self._workers.run(show_range, flaps, ~told.renewed, modes)
        if told.renewed.any():
            self._begin(told.renewed)
        ended = told.terminated | told.truncated
        late = ended & self._special if self.autoreset_mode == AutoresetMode.SAME_STEP else None
        if late is not None and late.any():
            told.last_observation[late], told.last_info[late] = told.observation[late], told.info[late]
            self._begun &= ~late  # should one of them fail
            for k in np.flatnonzero(late):
                self._prepare(int(k))
            self._begin(late)
        infos = infos_of(told.info, np.ones(self.num_envs, np.bool_))
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            last = np.full(self.num_envs, None, dtype=object)
            for k in np.flatnonzero(ended):
                last[k] = told.last_observation[k].copy()
            infos |= {"final_obs": last, "_final_obs": ended.copy()}
            infos |= {"final_info": infos_of(told.last_info, ended), "_final_info": ended.copy()}
        return (
            told.observation.copy(),
            told.reward.copy(),
            told.terminated.copy(),
            told.truncated.copy(),
            infos,
        )

    def set_scene(self, k: int, scene: str | Mapping[str, Any] | Scene | None) -> None:
        """Give environment k this scene, "random" for a new one each time, from its next episode on.

        Raises ValueError (SceneError) for another k, what is no scene or of a law that the rod does not know.
        """
        if not 0 <= k < self.num_envs:
            raise ValueError(f"k = {k!r}, allowed 0 to {self.num_envs - 1}")
        self._sources[k] = physics_kind("rod").accepted(read_scene(scene))
        self._special[k] = True

    def _prepare(self, k: int, asked: Options = NOTHING) -> None:
        """Have environment k's next episode begin on what is asked for, else on what is its own."""
        scene, line = asked.scene or self._sources[k], asked.line_of_sight
        grip = asked.grasp or self._grasp
        special = any(value is not None for value in asked)
        self._special[k] = True  # should this fail
        if scene == "random" and (line is not None or not self._suits_all(grip)):
            # drawn here, as the single environment draws it
            scene = self._flaps.sample(k, self._ranges)
            special = True
        if line is not None and isinstance(scene, Scene):
            scene = Scene.from_data(scene.dump() | {"line_of_sight": line})
        if isinstance(scene, Scene):
            self._flaps.put(k, self._settings.prior(scene))
            if grip == "spring":
                stable = spring_grasps(scene)
                if not stable:
                    raise Diverged(f"environment {k}: the spring model knows no grasp of its flap")
                grip = held(scene, stable[0], self.task_config)
            if isinstance(grip, Grasp):
                grip.check_inside(scene.tissue.length, scene.tissue.height)
                patch_ends(scene, grip.x)
        else:
            self._flaps.put_random(k)
        self._flaps.give(k, grip if isinstance(grip, Grasp) else None)
        self._flaps.ask(k, asked.unknowns)
        self._special[k] = special

    def _suits_all(self, grip: Grasp | str) -> bool:
        """Whether all random flaps can be grasped like this, without a look at each."""
        if not isinstance(grip, Grasp):
            return grip == "agent"
        length, height = self._ranges.length[0], self._ranges.height[0]
        low, high = jaw_range(length, Jaws().width)
        return low <= grip.x <= high and (grip.force is not None or grip.compression < height)

    def _begin(self, mask: Flags) -> None:
        flaps, told = self._flaps, self._flaps.told
        self._begun &= ~mask  # should one of them fail
        told.renewed[:], told.failed[:] = mask, False
        self._workers.run(begin_range, flaps)
        if told.failed.any():
            k = int(told.failed.argmax())
            raise SceneError(f"environment {k}: no room for the veins of a random flap")
        if not np.isnan(flaps.lanes.given[mask]).all():
            self._workers.run(take_range, flaps)
            self._workers.run(advance_range, flaps)
            self._workers.run(settle_range, flaps, True)
            if told.failed.any():
                raise Diverged(f"environment {int(told.failed.argmax())}: the grasp could not be squeezed")
        self._workers.run(show_range, flaps, told.renewed, self._plain)
        self._begun |= mask

    # --- Look-ahead

    def get_state(self) -> VectorState:
        """Where all stand. Raises ResetNeeded before the first reset."""
        if not self._begun.all():
            raise ResetNeeded("reset the environments first")
        return VectorState(
            self.task_config,
            self._settings.set_here,
            self._flaps.state(),
            tuple(self._sources),
            tuple(self._seeds),
            self._special.copy(),
            self._grasp,
        )

    def set_state(self, state: VectorState) -> None:
        """Have all go on from there, with the scenes and the grasp of their next episodes.

        Raises TypeError for what is no state, ValueError for one of another number of environments, of
        another task or of other unknowns; nothing has changed then.
        """
        if not isinstance(state, VectorState):
            raise TypeError(f"state is a {type(state).__name__}, allowed a VectorState")
        if len(state.sources) != self.num_envs:
            raise ValueError(f"state of {len(state.sources)} environments, allowed {self.num_envs}")
        self._settings.check_same_task(state.task)
        if state.unknowns != self._settings.set_here:
            raise ValueError("state: of environments with other unknowns")
        self._flaps.set_state(state.arrays)
        self._sources, self._seeds = list(state.sources), list(state.seeds)
        self._special[:], self._grasp = state.special, state.grasp
        self._begun[:] = True

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seed of each, None where it has not been reset."""
        return tuple(self._seeds)

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads; a later step starts them anew."""
        del kwargs
        self._workers.close()


@dataclass(frozen=True, repr=False, eq=False)
class VectorState:
    """Where n environments stood. It can be pickled; not to be changed."""

    task: TaskConfig
    unknowns: dict[str, Any] | None
    """as `Settings.set_here`"""
    arrays: dict[str, NDArray[Any]]
    """what each is made of, by name, n rows each"""
    sources: tuple[Scene | str, ...]
    seeds: tuple[int | None, ...]
    special: Flags
    grasp: Grasp | str

    def repeated(self, k: int, n: int) -> VectorState:
        """The state of n environments that all stand where the k-th does. Raises ValueError for no such k."""
        if not 0 <= k < len(self.sources):
            raise ValueError(f"k = {k!r}, allowed 0 to {len(self.sources) - 1}")
        if n < 1:
            raise ValueError(f"n = {n!r}, allowed a whole number from 1 on")
        arrays = {name: np.repeat(array[k : k + 1], n, axis=0) for name, array in self.arrays.items()}
        special = np.full(n, self.special[k])
        return VectorState(
            self.task,
            self.unknowns,
            arrays,
            (self.sources[k],) * n,
            (self.seeds[k],) * n,
            special,
            self.grasp,
        )
