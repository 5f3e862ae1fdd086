"""Limits as costs: environments whose rewards are less by what each cost comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from baselines.learning.vec_env import BatchVecEnv


class Penalised(VecEnvWrapper):
    """The reward r of each step becomes r - sum of multiplier x cost.

    A step costs 1 for each limit that is broken in it. `spent` are the sums of the episodes that are over;
    where a broken limit ends the episode, their mean is the share of episodes that break it.
    """

    def __init__(self, venv: VecEnv, costs: Sequence[str], multiplier: float):
        super().__init__(venv)
        self.multipliers = dict.fromkeys(costs, multiplier)
        self.spent: dict[str, list[float]] = {name: [] for name in costs}
        self._running = {name: np.zeros(self.num_envs) for name in costs}

    def reset(self) -> Any:
        for sums in self._running.values():
            sums[:] = 0
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = self.venv.step_wait()
        told: Mapping[str, Any]
        if isinstance(self.venv, BatchVecEnv):
            told = self.venv.costs
        else:
            told = {name: np.array([i["cost_terms"][name] for i in infos]) for name in self.multipliers}
        penalty = np.zeros(self.num_envs)
        for name, multiplier in self.multipliers.items():
            cost: NDArray[np.float64] = (told[name] > 0).astype(float)
            penalty += multiplier * cost
            sums = self._running[name]
            sums += cost
            self.spent[name] += sums[dones].tolist()
            sums[dones] = 0
        return observations, (rewards - penalty).astype(np.float32), dones, infos
