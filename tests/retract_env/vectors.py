"""Vector environments on rods, the single ones that they have to agree with, and what is done in both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from retract_env.env import TissueRetractEnv
from retract_env.task import SLICES
from retract_env.vector import TissueRetractVectorEnv
from tests.retract_env.playing import ROD

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
HELD = {"x": -0.03, "compression": 1e-3}


def vector(count: int, **options: Any) -> TissueRetractVectorEnv:
    """As users make it; on one thread unless told otherwise."""
    envs = gym.make_vec(ROD, num_envs=count, **({"threads": 1} | options))
    assert isinstance(envs, TissueRetractVectorEnv)
    return envs


def singles(
    count: int, mode: AutoresetMode = NEXT, scenes: Sequence[Any] | None = None, **options: Any
) -> SyncVectorEnv[Any, Any]:
    """Single environments one after the other, each with a scene of its own where scenes are given."""
    own = [options if scenes is None else options | {"scene": scene} for scene in scenes or [None] * count]
    made: list[Callable[[], Any]] = [partial(TissueRetractEnv, "rod", **each) for each in own]
    return SyncVectorEnv(made, autoreset_mode=mode)


def same(one: Any, other: Any, where: str = "") -> None:
    """Assert that all bits are the same, types, shapes and keys too."""
    if isinstance(one, dict):
        assert isinstance(other, dict) and one.keys() == other.keys(), where
        for key in one:
            same(one[key], other[key], f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{where}[{k}]")
    elif isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray), where
        assert (one.dtype, one.shape) == (other.dtype, other.shape), where
        if one.dtype == object:
            same(one.tolist(), other.tolist(), where)
        else:
            assert one.tobytes() == other.tobytes(), f"{where}: {one} {other}"
    else:
        assert type(one) is type(other) and one == other, f"{where}: {one} {other}"


def alike(said: Iterable[Any]) -> None:
    """Assert that of all of them."""
    first, *others = said
    assert others
    for other in others:
        same(first, other)


class Player:
    """Actions for many flaps: some of them lift well, some badly, some do anything.

    What is done to environment k depends on the seed, on k, and on what it shows, on no other one.
    """

    def __init__(self, seed: int, count: int):
        self.rngs = [np.random.default_rng([seed, k]) for k in range(count)]

    def __call__(self, observations: Floats) -> Floats:
        return np.array([self._one(k, seen) for k, seen in enumerate(observations)], np.float32)

    def _one(self, k: int, seen: Floats) -> Array:
        rng = self.rngs[k]
        noise = rng.uniform(-1, 1, 3)
        if k % 4 == 3:
            return noise
        if not seen[SLICES["holding"]]:
            firm = -0.2 if k % 4 < 2 else -0.9  # too light to hold for long
            return np.array([2 * (1 + float(seen[SLICES["target"]][0])) - 0.7, firm, 0.0]) + 0.15 * noise
        lift = np.array([0.35, 0.9, -0.75]) if k % 4 else np.array([0.2, 0.6, -0.4])
        return lift + 0.1 * noise


def play(envs: Any, player: Player, steps: int, seed: Any = 0, options: Any = None) -> list[Any]:
    """All that they say in so many steps, resets where nothing begins anew by itself included."""
    said: list[Any] = [envs.reset(seed=seed, options=options)]
    observations = said[0][0]
    disabled = envs.metadata["autoreset_mode"] == DISABLED
    for _ in range(steps):
        said.append(envs.step(player(observations)))
        observations, over = said[-1][0], said[-1][2] | said[-1][3]
        if disabled and over.any():
            said.append(envs.reset(options={"reset_mask": over}))
            observations = said[-1][0]
    return said


def row(said: list[Any], k: int) -> list[Any]:
    """What environment k says in what all say."""

    def of(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: of(item) for key, item in value.items()}
        return value[k] if value.dtype != object else value.tolist()[k]

    return [[of(part) for part in one] for one in said]


def ends(said: list[Any]) -> set[str]:
    """How episodes ended in what all say: "ok", "time", or which limit broke."""
    found: set[str] = set()
    for one in said:
        if len(one) == 5 and (one[2] | one[3]).any():
            infos = one[4].get("final_info", one[4])
            for k in np.flatnonzero(one[2] | one[3]):
                why = infos["failure"][k] or ("ok" if infos["is_success"][k] else "time")
                found.add(why)
    return found
