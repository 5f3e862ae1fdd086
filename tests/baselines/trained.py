"""Policies and recipes small enough for tests."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from baselines.learning.policies import Policy
from baselines.learning.recipe import Recipe
from retract_env.scene import LineOfSight
from retract_env.task import SIZE, actions, default_scene


def policy(seed: int = 0, sizes: tuple[int, ...] = (8, 5), **changes: Any) -> Policy:
    """Random weights."""
    rng = np.random.default_rng(seed)
    ends = (SIZE, *sizes, actions.SIZE)

    def draw(*shape: int) -> Any:
        return rng.standard_normal(shape).astype(np.float32)

    given: dict[str, Any] = {
        "name": "toy",
        "weights": tuple(draw(n, m) / 8 for m, n in pairwise(ends)),
        "biases": tuple(draw(n) for n in ends[1:]),
        "mean": draw(SIZE),
        "deviation": np.exp(draw(SIZE)),
        "clip": 10.0,
        "activation": "tanh",
        "output": "clip",
        "env": {"id": "TissueRetractFEM-v0", "kwargs": {}},
        "training": {"seed": seed, "curve": [{"steps": 1, "success": 0.5}]},
    }
    return Policy(**given | changes)


def easy_scene() -> dict[str, Any]:
    """Homogeneous, a line that little lifting clears, and limits that hardly any motion breaks."""
    line = LineOfSight.at(-0.02, np.radians(35)).model_dump(mode="json")
    return default_scene().dump() | {"line_of_sight": line, "limits": {"strain": 0.9, "friction": 5.0}}


PPO: dict[str, Any] = {
    "learning_rate": 1e-3,
    "rollout": 256,
    "batch_size": 64,
    "epochs": 10,
    "gamma": 0.98,
    "gae_lambda": 0.95,
    "clip_range": 0.2,
    "entropy_weight": 0.0,
    "value_weight": 0.5,
    "max_gradient": 0.5,
    "log_std": -0.5,
    "target_kl": None,
    "critic_first": 0,
}
SAC: dict[str, Any] = {
    "learning_rate": 2e-3,
    "buffer": 5000,
    "warmup": 100,
    "batch_size": 128,
    "tau": 0.02,
    "gamma": 0.95,
    "train_every": 1,
    "updates": 1,
    "entropy_weight": 0.02,
    "target_entropy": -3.0,
    "log_std": 0.0,
    "critic_first": 0,
}
LEARNERS: dict[str, dict[str, Any]] = {
    "ppo": PPO,
    "ppo_lagrangian": PPO
    | {"allowed": {"strain": 0.01, "friction": 0.01}, "multiplier": 1.0, "multiplier_rate": 0.1},
    "sac": SAC,
    "tqc": SAC | {"critics": 2, "quantiles": 10, "dropped": 1},
    "bc": {
        "policy": "ppo",
        "dataset": "toy/easy-v0",
        "learning_rate": 1e-3,
        "batch_size": 64,
        "weight_decay": 0.0,
        "grasp_weight": 10.0,
        "stiffness_noise": 0.0,
    },
}


def recipe(algorithm: str, steps: int, every: int, checkpoint: int | None = None, **learner: Any) -> Recipe:
    """For the easy scene, held by the spring model's grasp."""
    return Recipe.from_data(
        {
            "name": algorithm,
            "algorithm": algorithm,
            "steps": steps,
            "task": {"scene": easy_scene(), "grasp": "spring"},
            "network": {"sizes": [64, 64], "activation": "tanh" if algorithm in ("ppo", "bc") else "relu"},
            "evaluation": {"every": every, "checkpoint": checkpoint, "scenes": 1},
            "learner": LEARNERS[algorithm] | learner,
        }
    )
