"""PPO with limits as constraints: costs with limits of their own, by Lagrange multipliers.

The reward that is learned from is r - sum of multiplier x cost, with one critic for the whole. After each
rollout a multiplier grows where episodes cost more than allowed and falls where they cost less (dual ascent,
Ray, Achiam and Amodei, 2019). Its logarithm does, in proportion to the excess, so that it comes down as fast
as it went up; an excess of more than what is allowed counts as that.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.learning.algorithms.ppo import PPO
from baselines.learning.fields import Part, Rate

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from baselines.learning.costs import Penalised


class Allowed(Part):
    """In how many steps an episode may break a limit, on average; the share of episodes that may, where that
    ends them."""

    strain: Rate
    friction: Rate


class PPOLagrangian(PPO):
    """Proximal policy optimisation under constraints."""

    allowed: Allowed
    multiplier: Rate
    """Of each cost, at the start."""
    multiplier_rate: Rate
    """Greatest change of a multiplier's logarithm after a rollout."""

    def environment(self, envs: VecEnv) -> VecEnv:
        from baselines.learning.costs import Penalised

        return Penalised(envs, list(Allowed.model_fields), self.multiplier)

    def before_rollout(self, model: Any) -> None:
        costs = _costs(model)
        for name, spent in costs.spent.items():
            allowed = getattr(self.allowed, name)
            if spent:
                excess = (float(np.mean(spent)) - allowed) / allowed
                costs.multipliers[name] *= math.exp(self.multiplier_rate * min(1.0, excess))
                model.logger.record(f"costs/{name}", float(np.mean(spent)))
                spent.clear()
            model.logger.record(f"costs/multiplier_{name}", costs.multipliers[name])

    def memory(self, model: Any) -> dict[str, Any]:
        costs = _costs(model)
        return {"multipliers": dict(costs.multipliers), "spent": {k: list(v) for k, v in costs.spent.items()}}

    def remember(self, model: Any, memory: dict[str, Any]) -> None:
        costs = _costs(model)
        costs.multipliers.update(memory["multipliers"])
        costs.spent.update(memory["spent"])


def _costs(model: Any) -> Penalised:
    from baselines.learning.costs import Penalised

    envs = model.get_env()
    while not isinstance(envs, Penalised):
        envs = envs.venv
    return envs
