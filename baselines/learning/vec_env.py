"""A native Gymnasium vector environment as Stable-Baselines3 takes environments: no process for each."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from retract_env.task.rules import TERMS

NOTHING: dict[str, Any] = {}
"""The info of every environment that is not done, one and the same for all: not to be written to."""


class BatchVecEnv(VecEnv):
    """The retraction task for many flaps at once, as Stable-Baselines3's `VecEnv`.

    `BatchVecEnv(gym.make_vec("TissueRetractRod-v0", num_envs=256, autoreset_mode="SameStep"))` does what
    `DummyVecEnv` does with so many single environments: the same observations, rewards (float32) and dones,
    to the last bit. What infos hold is less: a dictionary for each environment in each step would take longer
    than its flap. Environments that are not done share one empty dictionary, `NOTHING`. One that is done has
    the single environment's last info and

    - `terminal_observation`, and `TimeLimit.truncated`: truncated and not terminated;
    - `episode`: return `r`, length `l` and seconds since the start `t`, as `Monitor` has them, so that
      training logs them without `VecMonitor`;
    - `episode_terms`: the terms of the reward, each summed over the episode.

    `reset_infos` are those of the last `reset`. All environments share the vector environment's attributes.
    Where the options of `set_options` differ, each kind is reset in turn.
    """

    def __init__(self, envs: gym.vector.VectorEnv[Any, Any, Any]):
        """envs: what it closes too. Raises ValueError unless episodes follow each other in the same step."""
        if (mode := envs.metadata.get("autoreset_mode")) != AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode = {mode}, allowed {AutoresetMode.SAME_STEP}")
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self.metadata = envs.metadata
        self._actions: NDArray[Any] = np.empty(0)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._terms = {name: np.zeros(self.num_envs) for name in TERMS}
        self._stepped: tuple[Mapping[str, Any], NDArray[np.bool_]] = {}, np.zeros(self.num_envs, np.bool_)
        self._start = time.time()

    def reset(self) -> NDArray[np.float32]:
        """Observations (n, SIZE); seeds and options are those of `seed` and `set_options`, once."""
        each: dict[str, NDArray[np.bool_]] = {}
        for k, options in enumerate(self._options):
            each.setdefault(repr(options), np.zeros(self.num_envs, np.bool_))[k] = True
        for mask in each.values():
            options = {**self._options[int(mask.argmax())], "reset_mask": mask}
            observations: NDArray[np.float32]
            # Gymnasium declares one seed alone; ours take one for each environment
            observations, infos = self.envs.reset(seed=self._seeds, options=options)  # type: ignore[arg-type]
            where = np.flatnonzero(mask)
            for place, info in zip(where, rows(infos, where), strict=True):
                self.reset_infos[place] = info
        self._reset_seeds()
        self._reset_options()
        for counted in (self._returns, self._lengths, *self._terms.values()):
            counted[:] = 0
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Actions (n, 3) of the next `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations (n, SIZE), rewards (n,), dones (n,), and n infos, see the class."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        for name, sums in self._terms.items():
            sums += infos["reward_terms"][name]
        dones = terminated | truncated
        self._stepped = infos, dones
        told = [NOTHING] * self.num_envs
        if dones.any():
            for k, info in self._last(infos, dones, truncated & ~terminated).items():
                told[k] = info
        return observations, rewards.astype(np.float32), dones, told

    def _last(
        self, infos: Mapping[str, Any], dones: NDArray[np.bool_], cut: NDArray[np.bool_]
    ) -> dict[int, dict[str, Any]]:
        """Infos of the episodes that are over, by the number of the environment; begins to count anew."""
        final, seconds = infos["final_info"], round(time.time() - self._start, 6)
        for name, sums in self._terms.items():
            sums += final["reward_terms"][name]  # 0 where none is over
        where = np.flatnonzero(dones)
        numbers = where.tolist()
        totals = [sums[where].tolist() for sums in (self._returns, self._lengths)]
        terms = rows(self._terms, where)
        told = dict(zip(numbers, rows(final, where), strict=True))
        for i, (k, info) in enumerate(told.items()):
            info["episode"] = {"r": round(totals[0][i], 6), "l": totals[1][i], "t": seconds}
            info["episode_terms"] = terms[i]
            info["TimeLimit.truncated"] = bool(cut[k])
            info["terminal_observation"] = infos["final_obs"][k]
        for counted in (self._returns, self._lengths, *self._terms.values()):
            counted[where] = 0
        return told

    @property
    def costs(self) -> dict[str, NDArray[np.float64]]:
        """`cost_terms` of the last step, (n,) each, where it ended an episode those of before the reset."""
        infos, dones = self._stepped
        terms = {k: v for k, v in infos["cost_terms"].items() if not k.startswith("_")}
        if not dones.any():
            return terms
        final = infos["final_info"]["cost_terms"]
        return {name: np.where(dones, final[name], cost) for name, cost in terms.items()}

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the vector environment for each; of `single_NAME` and `NAME` the former.

        Raises AttributeError.
        """
        single = f"single_{attr_name}"
        value = getattr(self.envs, single if hasattr(self.envs, single) else attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment. Raises ValueError for some environments alone."""
        if len(set(self._get_indices(indices))) != self.num_envs:
            raise ValueError(f"{attr_name}: all environments share it, allowed to set for all of them")
        setattr(self.envs.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment that begins with an environment's number, such as
        `set_scene`, for each. Raises AttributeError."""
        method = getattr(self.envs.unwrapped, method_name)
        return [method(k, *method_args, **method_kwargs) for k in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """True for `Monitor` alone, whose statistics the infos have."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]


def rows(infos: Mapping[str, Any], where: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Infos of `gymnasium.vector`, arrays by name, of the environments `where` as single ones have them."""
    names = [name for name in infos if not name.startswith("_")]
    columns = [
        rows(values, where) if isinstance(values, Mapping) else values[where].tolist()
        for values in (infos[name] for name in names)
    ]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
