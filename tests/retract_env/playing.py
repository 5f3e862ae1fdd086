"""Episodes that mostly lift, and a digest of all that an environment says in them."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import gymnasium as gym
import numpy as np

import retract_env  # noqa: F401  (registers the environments)

FEM, BULLET, ROD = "TissueRetractFEM-v0", "TissueRetract-v0", "TissueRetractRod-v0"
LIFT = np.array([0.1, 0.9, -0.9], np.float32)


def play(env: gym.Env[Any, Any], seed: int, steps: int = 6) -> list[Any]:
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
    text = json.dumps(plain, default=np.ndarray.tolist)
    return hashlib.sha256(text.encode()).hexdigest()
