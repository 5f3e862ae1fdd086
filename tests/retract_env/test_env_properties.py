"""Whatever an agent does, in whatever scene: no crash, no NaN, every promise of the spaces kept."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.rollout import rollout
from retract_env.scene import LineOfSight
from retract_env.task import SIZE, SLICES, TaskConfig, Weights, default_scene
from tests.retract_env.playing import BULLET, FEM, ROD

seeds = st.integers(0, 2**31 - 1)


def coarse(name: str, **options: Any) -> Any:
    if name == BULLET:
        pytest.importorskip("pybullet")
    return gym.make(name, resolution=None if name == ROD else "coarse", **options).unwrapped


def check_episode(env: Any, policy: Any, seed: int, options: dict[str, Any] | None = None) -> str:
    """Play it and check all that an episode promises; returns how it ended."""
    played = rollout(env, policy, seed=seed, options=options)
    low, high = TaskConfig().reward_range
    assert 1 <= len(played) <= TaskConfig().steps
    assert played.terminated != played.truncated
    for seen in played.observations:
        assert seen in env.observation_space
    assert np.isfinite(played.rewards).all()
    assert ((played.rewards >= low) & (played.rewards <= high)).all() and low <= played.total <= high
    last = played.infos[-1]
    for info in played.infos:
        assert set(info) == set(last) and set(info["reward_terms"]) == set(Weights.model_fields)
        assert 0 <= info["exposure"] <= 1 and math.isfinite(info["clearance"])
        assert math.isfinite(info["max_strain"]) and not math.isnan(info["required_friction"])
        assert info["cost"] in (0, 1, 2)
    for reward, info in zip(played.rewards, played.infos[1:], strict=True):
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
    assert np.diff([info["max_strain"] for info in played.infos]).min() >= 0
    if last["is_success"]:
        assert played.terminated and not last["failure"] and last["cost"] == 0
        assert last["exposure"] == pytest.approx(1, abs=1e-9) and last["clearance"] >= 0
    assert played.terminated == (last["is_success"] or last["failure"] in ("strain", "slip", "release"))
    assert (last["cost"] > 0) == (last["failure"] in ("strain", "slip", "release"))
    assert (
        played.truncated == (len(played) == TaskConfig().steps or last["failure"] == "diverged")
        or played.terminated
    )
    return last["failure"] or ("ok" if last["is_success"] else "time")


class Rough:
    """Actions of a random kind and size: jitter, one direction held, corners of the box."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)
        self.kind = int(self.rng.integers(3))
        self.held = self.rng.uniform(-1, 1, 3)

    def __call__(self, seen: Any) -> Any:
        if seen.shape == (SIZE,) and not seen[SLICES["holding"]]:
            return self.rng.uniform(-1, 1, 3).astype(np.float32)
        if self.kind == 0:
            return self.rng.uniform(-1, 1, 3).astype(np.float32)
        if self.kind == 1:
            return (self.held + 0.2 * self.rng.standard_normal(3)).astype(np.float32)
        return self.rng.choice([-1.0, 1.0], 3).astype(np.float32)


class Upwards:
    """Lifts with some noise, so that episodes last."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)

    def __call__(self, seen: Any) -> Any:
        if not seen[SLICES["holding"]]:
            return np.array([self.rng.uniform(-0.8, 0.4), self.rng.uniform(-0.6, 0), 0.0], np.float32)
        lift = np.array([self.rng.uniform(-0.2, 0.6), 0.9, self.rng.uniform(-1, -0.5)])
        return (self.rng.uniform(0.3, 1) * lift).astype(np.float32)


@pytest.mark.parametrize("name", [FEM, BULLET, ROD])
@settings(max_examples=8, deadline=None, derandomize=True)
@given(seeds, st.sampled_from([Rough, Upwards]))
def test_random_actions_in_random_scenes(name: str, seed: int, policy: Any) -> None:
    env = coarse(name, scene="random")
    check_episode(env, policy(seed), seed)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", [FEM, BULLET, ROD])
@settings(max_examples=100, deadline=None)
@given(seeds, st.sampled_from([Rough, Upwards]), st.sampled_from(["agent", "spring"]))
def test_many_random_actions_in_random_scenes(name: str, seed: int, policy: Any, grasp: str) -> None:
    env = coarse(name, scene="random", grasp=grasp)
    check_episode(env, policy(seed), seed)
    env.close()


@pytest.mark.parametrize("name", [FEM, pytest.param(BULLET, marks=pytest.mark.slow), ROD])
@pytest.mark.parametrize("first", list(product([-1.0, 1.0], repeat=2)), ids=str)
def test_extremes_held_to_the_end(name: str, first: tuple[float, float]) -> None:
    """Each corner of the grasps, then each corner of the moves for as long as it lasts."""
    env = coarse(name)
    ends = set()
    for corner in product([-1.0, 1.0], repeat=3):
        moves = [np.array(corner, np.float32)] * TaskConfig().steps
        held = iter([np.array([*first, 0.0], np.float32), *moves])
        ends.add(check_episode(env, lambda _, held=held: next(held), 0))
    assert ends & {"strain", "slip", "release"}
    env.close()


@pytest.mark.parametrize("seed", range(3))
def test_lifting_succeeds_now_and_then(seed: int) -> None:
    """So that the checks above see every sort of end. The flap is low and the line flat."""
    scene = default_scene()
    scene = scene.model_copy(
        update={
            "line_of_sight": LineOfSight.at(-0.02, 0.3),
            "limits": scene.limits.model_copy(update={"friction": 2.0}),
        }
    )
    env = coarse(FEM, scene=scene.dump())
    ends = {check_episode(env, Upwards(seed), seed) for seed in range(10 * seed, 10 * seed + 6)}
    assert "ok" in ends
    env.close()
