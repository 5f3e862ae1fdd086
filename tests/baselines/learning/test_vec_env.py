"""The adapter for Stable-Baselines3: what single environments do, side by side, to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from baselines.learning.vec_env import NOTHING, BatchVecEnv
from retract_env.task import SIZE, default_scene
from tests.baselines.trained import easy_scene

ROD = "TissueRetractRod-v0"
SHORT: dict[str, Any] = {"scene": "random", "task": {"steps": 5}}
"""Episodes that end by the time as well as by limits."""


def batch(count: int, **arguments: Any) -> BatchVecEnv:
    return BatchVecEnv(gym.make_vec(ROD, count, autoreset_mode="SameStep", **(SHORT | arguments)))


@pytest.fixture
def envs() -> Iterator[BatchVecEnv]:
    made = batch(3)
    yield made
    made.close()


def single_ones(count: int, **arguments: Any) -> DummyVecEnv:
    def make() -> gym.Env[Any, Any]:
        return Monitor(gym.make(ROD, disable_env_checker=True, **(SHORT | arguments)))

    return DummyVecEnv([make] * count)


def assert_alike(mine: dict[str, Any], theirs: dict[str, Any]) -> None:
    """A last info, as the single environment and its monitor have it."""
    assert set(mine) == set(theirs) | {"episode_terms"}
    for name, value in theirs.items():
        if name == "terminal_observation":
            assert np.array_equal(mine[name], value)
        elif name == "episode":
            assert mine[name]["l"] == value["l"] and mine[name]["r"] == pytest.approx(value["r"], abs=2e-6)
            assert mine[name]["t"] >= 0
        else:
            assert mine[name] == value and type(mine[name]) is type(value), name
    assert sum(mine["episode_terms"].values()) == pytest.approx(mine["episode"]["r"], abs=1e-5)


@pytest.mark.parametrize("grasp", ["agent", "spring"])
def test_it_does_what_single_environments_do(grasp: str) -> None:
    count = 5 if grasp == "agent" else 2
    ours, theirs = batch(count, grasp=grasp), single_ones(count, grasp=grasp)
    rng, ends, cut = np.random.default_rng(0), 0, 0
    for made in (ours, theirs):
        made.seed(3)
    assert np.array_equal(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    for _ in range(24):
        actions = rng.uniform(-0.5, 0.5, (count, 3)).astype(np.float32)
        (seen, rewards, dones, infos), wanted = ours.step(actions), theirs.step(actions)
        assert rewards.dtype == np.float32
        for got, expected in zip((seen, rewards, dones), wanted[:3], strict=True):
            assert got.dtype == expected.dtype and np.array_equal(got, expected)
        for k in range(count):
            if dones[k]:
                assert_alike(infos[k], wanted[3][k])
                cut += infos[k]["TimeLimit.truncated"]
            else:
                assert infos[k] is NOTHING and NOTHING == {}
        ends += int(dones.sum())
    assert 0 < cut < ends or grasp == "spring"
    for made in (ours, theirs):
        made.close()


def test_options_are_used_once_and_may_differ() -> None:
    """Each kind is reset in turn; seeds and options as with single environments."""
    scene = default_scene().dump()
    each = [{"scene": scene}, {}, {"scene": easy_scene()}, {"scene": scene}]
    ours, theirs = batch(4), single_ones(4)
    for options in (each, {"scene": scene}, {}):
        for made in (ours, theirs):
            made.seed(1)
            made.set_options(options)
        assert np.array_equal(ours.reset(), theirs.reset())
        assert ours._options == [{}] * 4 and ours._seeds == [None] * 4
        assert np.array_equal(ours.reset(), theirs.reset())
    for made in (ours, theirs):
        made.close()


def test_environments_are_asked_by_their_numbers(envs: BatchVecEnv) -> None:
    assert envs.get_attr("num_envs", 0) == [3] and envs.render_mode is None
    assert [space.shape for space in envs.get_attr("action_space")] == [(3,)] * 3
    assert not envs.has_attr("nothing_of_the_kind")
    assert envs.env_is_wrapped(Monitor) == [True] * 3 and envs.env_is_wrapped(gym.Wrapper, [1]) == [False]
    envs.set_attr("note", "all share it")
    assert envs.get_attr("note", [0, 2]) == ["all share it"] * 2
    with pytest.raises(ValueError, match=r"^note: all environments share it"):
        envs.set_attr("note", 0, [1])
    envs.env_method("set_scene", easy_scene(), indices=[1])
    envs.seed(0)
    first, second = envs.reset(), envs.reset()
    assert np.array_equal(first[1], second[1]) and not np.array_equal(first[0], second[0])


def test_it_takes_episodes_that_follow_in_the_same_step_alone() -> None:
    made = gym.make_vec(ROD, 2)
    with pytest.raises(ValueError, match=r"^autoreset_mode = .*, allowed "):
        BatchVecEnv(made)
    made.close()


def test_normalising_monitoring_and_stacking_wrap_it() -> None:
    """The wrappers of Stable-Baselines3 do to it what they do to single environments."""
    made = []
    for inner in (batch(3), single_ones(3)):
        with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
            monitored = VecMonitor(inner)
        made.append(VecFrameStack(VecNormalize(monitored), 2))
    rng = np.random.default_rng(1)
    for envs in made:
        envs.seed(0)
    first, second = (envs.reset() for envs in made)
    assert np.array_equal(first, second) and first.shape == (3, 2 * SIZE)
    for _ in range(12):
        actions = rng.uniform(-0.5, 0.5, (3, 3)).astype(np.float32)
        ours, theirs = (envs.step(actions) for envs in made)
        for k in range(3):
            assert np.array_equal(ours[k], theirs[k])
        for mine, other in zip(ours[3], theirs[3], strict=True):
            assert mine.get("episode", {}).get("l") == other.get("episode", {}).get("l")
            if "terminal_observation" in other:
                assert np.array_equal(mine["terminal_observation"], other["terminal_observation"])
    for envs in made:
        envs.close()


def test_an_agent_learns_in_it_and_its_returns_are_logged() -> None:
    envs = batch(8)
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=2, seed=0, device="cpu")
    model.learn(512)
    assert model.num_timesteps == 512 and len(model.ep_info_buffer or ()) > 20
    assert NOTHING == {}
    returns, lengths = evaluate_policy(model, envs, 10, return_episode_rewards=True)
    assert len(returns) == len(lengths) >= 10 and all(1 <= length <= 5 for length in lengths)
    envs.close()
