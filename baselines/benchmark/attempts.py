"""What a method does on one scene: it hands in a grasp and a path, and what acts step by step plays.

Every function here takes a task and answers with plain data, so that it works in any process. A policy is
played in the environment on the benchmark's physics, and what its jaws did is what it hands in.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import retract_env  # noqa: F401  (registers the environments)
from baselines.benchmark.external import Nonsense, called, checked, settings_of, understood
from baselines.benchmark.methods import COMPETING, UNTRAINED, Method, method_of
from baselines.jobs.journal import Row, WorkItem
from baselines.learning.policies import load_policy
from planners.base import DISMISSED, PROMISING, NoPlan
from planners.certify import FAILURES
from planners.swift.planner import UNSURE
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import Decide, Rollout, rollout
from retract_env.scenarios import draws
from retract_env.scene import Scene

BULLET = PHYSICS["bullet"].env_id
SETTINGS = ("grip", "sensors", "task")
"""Of an environment, what a policy may choose."""


UNSOLVED = "unsolved"
NOTHING_FOUND = (*FAILURES, UNSURE, UNSOLVED)
"""Why a planner hands in nothing: what most of its candidates failed by; "unsure": its rod finds a limit
broken; "unsolved": its own problem had no solution, no mesh, or took too long."""


@dataclass
class HandedIn:
    """What a method hands in, and what it spent on it."""

    grasp: Grasp | None = None
    path: JawPath | None = None
    reason: str = ""
    """why there is nothing to judge"""
    detail: str = ""
    """what is wrong with it, where a reason does not say it all"""
    evaluations: int = 0
    """equilibria that were computed"""
    seconds: float = 0.0
    """of processor time"""
    decisions: int = 0
    """actions of a policy"""
    decision_seconds: float = 0.0

    def to_json(self) -> Row:
        """Plain data."""
        grasp = None if self.grasp is None else {"x": self.grasp.x, **self.grasp.firmness}
        return self.__dict__ | {"grasp": grasp, "path": None if self.path is None else self.path.to_json()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> HandedIn:
        """The inverse."""
        grasp = None if data["grasp"] is None else Grasp(**data["grasp"])
        path = None if data["path"] is None else JawPath.from_json(data["path"])
        return cls(**{**data, "grasp": grasp, "path": path})


@dataclass
class _Timed:
    """A policy and the processor time that it takes."""

    policy: Decide
    seconds: float = 0.0
    calls: int = 0

    def __call__(self, observation: NDArray[Any]) -> NDArray[Any]:
        start = time.process_time()
        action = self.policy(observation)
        self.seconds += time.process_time() - start
        self.calls += 1
        return action


class _Sane:
    """A policy from elsewhere, whose actions and settings are looked at before the environment is given them.

    Raises Nonsense where they are none.
    """

    def __init__(self, policy: Callable[[Any], Any]):
        self.policy, self.env = policy, {"kwargs": settings_of(policy)}

    def __call__(self, observation: NDArray[Any]) -> NDArray[Any]:
        found: NDArray[Any] = checked(self.policy(observation))
        return found


def hand_in(task: WorkItem) -> Row:
    """What a method hands in for a scene, a `HandedIn` as plain data."""
    method, scene = method_of(task), Scene.from_data(task["scene"])
    start = _processor_time()
    try:
        if method.kind == "planner":
            handed = _planned(method, scene, task)
        elif method.kind == "external":
            handed = _from_elsewhere(method, scene, task)
        else:
            handed = _played(acting(method, task), scene, task)
    except NoPlan as none:
        unsaid = ("pruned", PROMISING, DISMISSED)
        reasons = Counter(str(c.reason) for c in none.candidates if c.reason not in unsaid)
        commonest = min(reasons, key=lambda r: (-reasons[r], r)) if reasons else "not_visible"
        known = commonest in NOTHING_FOUND
        handed = HandedIn(
            reason=commonest if known else UNSOLVED,
            detail="" if known else commonest,
            evaluations=sum(c.increments for c in none.candidates),
        )
    except Nonsense as problem:
        handed = HandedIn(reason="returned", detail=str(problem))
    handed.seconds = _processor_time() - start
    return handed.to_json()


def _processor_time() -> float:
    """s that this process has computed, and those that it began and waited for: what a clock says would be
    another number on a busy machine."""
    return time.process_time() + sum(os.times()[2:4])


def _planned(method: Method, scene: Scene, task: WorkItem) -> HandedIn:
    """A planner's plan. Raises NoPlan."""
    best = COMPETING[method.name](scene, resolution=task["resolution"], workers=1, on_update=None)
    return HandedIn(best.grasp, best.path, evaluations=sum(c.increments for c in best.candidates))


def _from_elsewhere(method: Method, scene: Scene, task: WorkItem) -> HandedIn:
    """A plan, or a policy that is played. Raises Nonsense, and whatever the method raises."""
    found = understood(called(method.name, method.folder, scene))
    return HandedIn(*found) if isinstance(found, tuple) else _played(_Sane(found), scene, task)


def acting(method: Method, task: WorkItem) -> Decide | None:
    """Who plays, new for each episode; None for a method that hands in a plan. Raises PolicyError."""
    if method.kind == "policy":
        return load_policy(method.folder)
    if method.kind == "external":
        found = understood(called(method.name, method.folder, Scene.from_data(task["scene"])))
        return None if isinstance(found, tuple) else _Sane(found)
    return UNTRAINED[method.kind](task)


def _played(policy: Decide | None, scene: Scene, task: WorkItem) -> HandedIn:
    """What the jaws did, and a few moves more like the last where the environment, on a coarser mesh, saw the
    target: the certifier stops at visibility."""
    assert policy is not None
    timed = _Timed(policy)
    env = _environment(task, policy)
    try:
        options = {"scene": scene.dump(), "grasp": "agent"}
        played = rollout(env, timed, seed=task["number"], options=options)
        grasp, path = env.episode.grasp, env.episode.path
    finally:
        env.close()
    if path is not None and played.success and len(path) > 2:
        path = led_out(path, task["lead_out"])
    handed = HandedIn(grasp, path, "" if path is not None else "diverged", evaluations=len(played))
    handed.decisions, handed.decision_seconds = timed.calls, timed.seconds
    return handed


def led_out(path: JawPath, moves: int) -> JawPath:
    """The path with its last move made so many times more."""
    poses = path.poses
    more = poses[-1] + np.arange(1, moves + 1)[:, None] * (poses[-1] - poses[-2])
    return JawPath.from_poses(np.concatenate([poses, more]), path.kind)


def transferred(task: WorkItem) -> Row:
    """What became of a policy on PyBullet: "ok", a failure, or "not_visible"; None for what is no policy."""
    policy = acting(method_of(task), task)
    if policy is None:
        return {"transfer": None}
    env = gym.make(BULLET, disable_env_checker=True, **_settings(policy))
    try:
        played = rollout(env, policy, seed=task["number"], options={"scene": task["scene"]})
    finally:
        env.close()
    return {"transfer": _end_of(played)}


def played_on_draws(task: WorkItem) -> Row:
    """In how many of the first draws of what is not known a policy that acts step by step succeeds, on the
    benchmark's physics; None for what is no policy. It is not told the draw."""
    first = task["number"] * task["played"]  # so that no two episodes have the same noise
    ends: list[str] = []
    env: Any = None
    with ExitStack() as closing:
        for number, z in enumerate(draws(task["played"], task["survival"]["seed"] + task["number"]), first):
            if (policy := acting(method_of(task), task)) is None:
                return {"closed_loop": None}
            if env is None:
                env = _environment(task, policy)
                closing.callback(env.close)
            options = {"scene": task["scene"], "grasp": "agent", "unknowns": z}
            ends.append(_end_of(rollout(env, policy, seed=number, options=options)))
    return {"closed_loop": ends.count("ok") / len(ends)}


def _settings(policy: Decide) -> dict[str, Any]:
    """What a policy's environment is like wherever it plays, as its attribute `env` says: what its jaws hold
    by, its sensors, its task."""
    given = getattr(policy, "env", {}).get("kwargs", {})
    return {name: given[name] for name in SETTINGS if name in given}


def _environment(task: WorkItem, policy: Decide) -> Any:
    """The environment on the benchmark's physics, for a policy."""
    name = PHYSICS[task["policy_physics"]].env_id
    settings = _settings(policy) | {"resolution": task["policy_resolution"]}
    return gym.make(name, disable_env_checker=True, **settings).unwrapped


def _end_of(played: Rollout) -> str:
    return "ok" if played.success else str(played.infos[-1]["failure"] or "not_visible")
