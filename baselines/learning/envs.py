"""The environments that agents learn in: many side by side, their observations normalised."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize

from baselines.learning.policies import Policy
from baselines.learning.vec_env import BatchVecEnv
from retract_env.env import TissueRetractEnv
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import rollout
from retract_env.threads import single_threaded

if TYPE_CHECKING:
    from baselines.learning.recipe import EnvSettings, Recipe


class Judged(gym.Wrapper[Any, Any, Any, Any]):
    """An environment that can be asked to play a policy, so that those side by side share an evaluation.

    The last info of an episode has `episode_terms`: the terms of the reward, each summed over the episode.
    """

    def __init__(self, env: gym.Env[Any, Any], rank: int, of: int):
        super().__init__(env)
        self.rank, self.of = rank, of
        self._terms: dict[str, float] = {}

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        self._terms = {}
        return super().reset(**arguments)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(action)
        for name, value in info["reward_terms"].items():
            self._terms[name] = self._terms.get(name, 0.0) + value
        if terminated or truncated:
            info = info | {"episode_terms": self._terms}
        return observation, reward, terminated, truncated, info

    def play(self, policy: Policy, scenes: Sequence[Mapping[str, Any] | None]) -> list[dict[str, Any]]:
        """Outcome of an episode in each scene that is this environment's share; None is its own scene."""
        share = list(enumerate(scenes))[self.rank :: self.of]
        return [outcome(self.unwrapped, policy, scene, number) for number, scene in share]


def outcome(
    env: gym.Env[Any, Any], policy: Policy, scene: Mapping[str, Any] | None, seed: int
) -> dict[str, Any]:
    """What became of one episode: success, failure, total reward, greatest strain over its limit, steps.

    seed: of the sensors' noise and of what is not known, where the policy's environment has any.
    """
    played = rollout(env, policy, seed=seed, options=None if scene is None else {"scene": scene})
    last = played.infos[-1]
    limit = cast(TissueRetractEnv, env.unwrapped).episode.task.scene.limits.strain
    return {
        "success": played.success,
        "failure": last["failure"] or ("" if played.success else "not_visible"),
        "total": played.total,
        "strain": last["max_strain"] / limit,
        "steps": len(played),
    }


def make_env(settings: EnvSettings, rank: int, of: int) -> gym.Env[Any, Any]:
    """One environment with its statistics of episodes."""
    if multiprocessing.parent_process() is not None:
        # Ctrl-C reaches the whole group of processes; when to end is the parent's to say
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    env = gym.make(PHYSICS[settings.physics].env_id, disable_env_checker=True, **settings.arguments)
    return Monitor(Judged(env, rank, of))


def make_envs(recipe: Recipe, count: int) -> VecNormalize:
    """`count` environments: in one process where the physics computes many at once or there is but one, else
    each in a process of its own."""
    kind = PHYSICS[recipe.task.physics]
    envs: VecEnv
    if kind.vector:
        batch = gym.make_vec(kind.env_id, count, autoreset_mode="SameStep", **recipe.task.arguments)
        envs = BatchVecEnv(batch)
    else:
        makers: list[Callable[[], gym.Env[Any, Any]]] = [
            partial(make_env, recipe.task, rank, count) for rank in range(count)
        ]
        if count == 1:
            envs = DummyVecEnv(makers)
        else:
            with single_threaded():
                envs = SubprocVecEnv(makers)
    seen = recipe.observation
    return VecNormalize(
        recipe.learner.environment(envs), norm_reward=False, clip_obs=seen.clip, epsilon=seen.floor**2
    )


def judge(
    envs: VecNormalize, policy: Policy, scenes: Sequence[Mapping[str, Any] | None]
) -> list[dict[str, Any]]:
    """Outcomes in the order of the scenes; the episodes under way are lost."""
    if isinstance(envs.unwrapped, BatchVecEnv):  # a single one is fast enough there
        return play(policy, scenes, policy.env["id"], policy.env["kwargs"])
    shares = envs.env_method("play", policy, scenes)
    return [shares[k % envs.num_envs][k // envs.num_envs] for k in range(len(scenes))]


def play(
    policy: Policy, scenes: Sequence[Mapping[str, Any] | None], env_id: str, arguments: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Outcomes of an episode in each scene in one environment made for it; None is its own scene."""
    env = gym.make(env_id, disable_env_checker=True, **arguments)
    try:
        return [outcome(env, policy, scene, number) for number, scene in enumerate(scenes)]
    finally:
        env.close()


def play_on_fem(policy: Policy, scenes: Sequence[Mapping[str, Any] | None]) -> list[dict[str, Any]]:
    """Outcomes on coarse finite elements, all else as the policy was trained."""
    return play(policy, scenes, PHYSICS["fem"].env_id, {**policy.env["kwargs"], "resolution": None})


def seed_of(*numbers: int) -> int:
    """One seed from several, below 2^31."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0] >> 1)
