"""Limits as costs, and the multipliers that weigh them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from baselines.learning.algorithms import PPOLagrangian
from baselines.learning.costs import Penalised
from baselines.learning.vec_env import BatchVecEnv
from tests.baselines.trained import LEARNERS

COUNT, STEPS = 3, 24
GIVEN: dict[str, Any] = {"scene": "random", "task": {"limits": "cost", "steps": 8}}


def rods() -> VecEnv:
    name = "retract_env:TissueRetractRod-v0"
    return BatchVecEnv(gym.make_vec(name, COUNT, autoreset_mode="SameStep", **GIVEN))


def singles() -> VecEnv:
    return DummyVecEnv([lambda: gym.make("retract_env:TissueRetractRod-v0", **GIVEN)] * COUNT)


def played(envs: VecEnv) -> tuple[np.ndarray[Any, Any], Penalised | None]:
    """Rewards (STEPS, COUNT) of the same actions, hard on the tissue."""
    rng = np.random.default_rng(3)
    envs.seed(5)
    envs.reset()
    rewards = [envs.step(rng.uniform(-1, 1, (COUNT, 3)).astype(np.float32))[1].copy() for _ in range(STEPS)]
    envs.close()
    return np.array(rewards), envs if isinstance(envs, Penalised) else None


def test_the_reward_is_less_by_what_costs_come_to() -> None:
    """Costs of rods side by side are those of single environments, episodes' last steps among them."""
    plain, _ = played(rods())
    free, watched = played(Penalised(rods(), ["strain", "friction"], 0.0))
    assert watched is not None
    assert np.array_equal(free, plain)
    dear, same = played(Penalised(rods(), ["strain", "friction"], 2.0))
    assert same is not None and same.spent == watched.spent
    single, alone = played(Penalised(singles(), ["strain", "friction"], 2.0))
    assert np.array_equal(single, dear)
    assert alone is not None and alone.spent == same.spent
    assert len(same.spent["friction"]) == COUNT * STEPS // 8
    # all episodes are over after the last step
    spent = sum(sum(costs) for costs in same.spent.values())
    assert spent > 0
    assert (plain - dear).sum() == pytest.approx(2.0 * spent, rel=1e-5)


@pytest.mark.parametrize(("spent", "up"), [(0.5, True), (0.001, False)])
def test_a_multiplier_grows_where_episodes_cost_too_much_and_falls_where_less(spent: float, up: bool) -> None:
    learner = PPOLagrangian.from_data(LEARNERS["ppo_lagrangian"])
    costs = Penalised(rods(), ["strain", "friction"], 1.0)
    costs.spent["friction"] = [spent] * 4
    recorded: dict[str, float] = {}
    logger = SimpleNamespace(record=recorded.__setitem__)
    model = SimpleNamespace(get_env=lambda: costs, logger=logger)
    learner.before_rollout(model)
    costs.close()
    assert costs.multipliers["strain"] == 1.0  # no episode was over
    change = np.log(costs.multipliers["friction"]) / learner.multiplier_rate
    assert change == pytest.approx(1.0 if up else -0.9)
    assert recorded["costs/friction"] == pytest.approx(spent) and costs.spent["friction"] == []
