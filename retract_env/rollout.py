"""The one loop over `env.step`, and the policy that plays a planned jaw path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from retract_env.task import SIZE, SLICES, TaskConfig, actions

Array = NDArray[np.float64]
Decide = Callable[[NDArray[Any]], NDArray[Any]]
"""From an observation to an action. It may remember what it saw in this episode, which began with the
observation that has all its time left."""


@dataclass(frozen=True)
class Rollout:
    """One episode from reset to end: t steps."""

    observations: NDArray[Any]
    """(t + 1, ...)"""
    actions: NDArray[Any]
    """(t, 3)"""
    rewards: Array
    """(t,)"""
    infos: tuple[dict[str, Any], ...]
    """(t + 1)"""
    terminated: bool
    truncated: bool

    @property
    def success(self) -> bool:
        """Whether the target came into view with no limit broken."""
        return bool(self.infos[-1].get("is_success", False))

    @property
    def total(self) -> float:
        """Sum of the rewards."""
        return float(self.rewards.sum())

    def __len__(self) -> int:
        return len(self.rewards)


def rollout(
    env: gym.Env[Any, Any],
    policy: Decide,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Rollout:
    """Play one episode to its end. on_step is called after reset and after each step, say to draw."""
    observation, info = env.reset(seed=seed, options=None if options is None else dict(options))
    observations, infos = [observation], [info]
    chosen: list[NDArray[Any]] = []
    rewards: list[float] = []
    terminated = truncated = False
    on_step()
    while not (terminated or truncated):
        action = policy(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        chosen.append(action)
        rewards.append(float(reward))
        infos.append(info)
        on_step()
    return Rollout(
        np.stack(observations),
        np.array(chosen),
        np.array(rewards),
        tuple(infos),
        terminated,
        truncated,
    )


class Planned(Protocol):
    """What a planner hands in, as far as playing it goes."""

    @property
    def scene(self) -> Scene: ...
    @property
    def grasp(self) -> Grasp: ...
    @property
    def path(self) -> JawPath: ...


class PathPolicy:
    """Plays a grasp and a jaw path from state observations.

    The first action takes the grasp, where the environment has not taken it already. Each later one goes as
    far along the path as one step's limits allow, seen from where the gripper is now, so that errors do not
    add up. At the path's end it waits.
    """

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, config: TaskConfig | None = None):
        """config: that of the environment it plays in, whose limits of a step it keeps."""
        self.scene, self.grasp, self.path, self.config = scene, grasp, path, config or TaskConfig()
        self._progress = 1.0

    @classmethod
    def of(cls, plan: Planned, config: TaskConfig | None = None) -> PathPolicy:
        """The policy that plays a plan."""
        return cls(plan.scene, plan.grasp, plan.path, config)

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """(3,) action. Raises ValueError for an observation that is not the task's state vector."""
        if observation.shape != (SIZE,):
            raise ValueError(f"observation has shape {observation.shape}, allowed that of obs='state'")
        if observation[SLICES["time_left"]] == 1:
            self._progress = 1.0
        if not observation[SLICES["holding"]]:
            return actions.from_grasp(self.grasp, self.scene, self.config).astype(np.float32)
        here = gripper_pose(observation, self.scene)
        self._progress = self._reach(here)
        towards = self.path.pose_at(self._progress)
        return actions.move_towards(towards, here, self.config).astype(np.float32)

    def _reach(self, here: Array) -> float:
        """Progress that one step from `here` attains: just before the path first leaves the step's limits."""
        pieces = 16
        count = max(1, int(np.ceil((self.path.last - self._progress) * pieces)))
        ahead = np.linspace(self._progress, self.path.last, count + 1)
        away = np.abs(_turned(self.path.pose_at(ahead), here)) / self.config.move
        outside = np.flatnonzero(away.max(axis=1) > 1)
        outside = outside[outside > 0]  # where the gripper lags behind, go on all the same
        if len(outside) == 0:
            return float(self.path.last)
        inner, outer = ahead[outside[0] - 1], ahead[outside[0]]
        for _ in range(20):
            middle = (inner + outer) / 2
            within = np.abs(_turned(self.path.pose_at(middle), here) / self.config.move).max() <= 1
            inner, outer = (middle, outer) if within else (inner, middle)
        return float(inner)


def gripper_pose(observation: NDArray[Any], scene: Scene) -> Array:
    """Pose (4,) x, y, theta, separation of the gripper in a state observation, to single precision."""
    seen = {name: observation[part].astype(np.float64) for name, part in SLICES.items()}
    x, y = seen["gripper"] * scene.tissue.length
    theta = np.arctan2(*seen["angle"])
    return np.array([x, y, theta, seen["separation"][0] * scene.tissue.height])


def _turned(poses: Array, here: Array) -> Array:
    """x, y and the shorter turn (..., 3) from `here` to poses (..., 4)."""
    change = (poses - here)[..., :3]
    change[..., 2] = np.pi - (np.pi - change[..., 2]) % (2 * np.pi)
    return change
