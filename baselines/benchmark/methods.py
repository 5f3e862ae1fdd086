"""What competes: planners, trained policies, a random one, and doing nothing. Each hands in grasp and path.

A policy is played in the environment on the benchmark's physics, and what its jaws did is what it hands in. The certifier judges
all alike. `compete` is the work of one method on one scene, for `run_tasks`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import retract_env  # noqa: F401  (registers the environments)
from baselines.jobs.journal import Row, WorkItem
from baselines.learning.policies import TENSORS, load_policy, policy_folder
from planners import NoPlan, certify, plan
from planners.base import PROMISING
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import Decide, rollout
from retract_env.scene import Scene

BULLET = PHYSICS["bullet"].env_id


def _random(item: WorkItem) -> Decide:
    rng = np.random.default_rng([item["seed"], item["number"]])
    return lambda _: rng.uniform(-1, 1, 3).astype(np.float32)


def _nothing(_: WorkItem) -> Decide:
    return lambda _: np.zeros(3, np.float32)


UNTRAINED: dict[str, Callable[[WorkItem], Decide]] = {"random": _random, "nothing": _nothing}
"""What plays in the environment without having learned: from a scene's work item, as `compete` has it."""


@dataclass(frozen=True)
class Method:
    """One competitor, as plain data for tasks."""

    kind: str
    """planner, policy, or one of UNTRAINED"""
    name: str
    """what tables call it"""
    run: int = 0
    """seed of the training, for a policy"""
    folder: str = ""
    """of a policy"""
    content: str = ""
    """hash of a policy's tensors, so that another one under the same name is another task"""

    @classmethod
    def trained(cls, folder: Path) -> Method:
        """The policy in a folder, or a shipped one by its name. Raises PolicyError."""
        import hashlib

        folder = policy_folder(folder)
        policy = load_policy(folder)
        content = hashlib.sha256((folder / TENSORS).read_bytes()).hexdigest()[:16]
        return cls("policy", policy.name, int(policy.training["seed"]), str(folder), content)


@dataclass
class HandedIn:
    """What a method hands in, and what it spent on it."""

    grasp: Grasp | None = None
    path: JawPath | None = None
    reason: str = ""
    """why there is nothing to judge"""
    evaluations: int = 0
    """equilibria that were computed"""
    seconds: float = 0.0
    decisions: int = 0
    """actions of a policy"""
    decision_seconds: float = 0.0


@dataclass
class _Timed:
    """A policy and the time that it takes."""

    policy: Decide
    seconds: float = 0.0
    calls: int = field(default=0)

    def __call__(self, observation: NDArray[Any]) -> NDArray[Any]:
        start = time.perf_counter()
        action = self.policy(observation)
        self.seconds += time.perf_counter() - start
        self.calls += 1
        return action


def compete(task: WorkItem) -> Row:
    """One method on one scene, judged. The row's `timing` alone differs from run to run.

    task: method, split, number, scene, resolution, policy_physics, policy_resolution, lead_out, seed,
    transfer.
    """
    method, scene = Method(**task["method"]), Scene.from_data(task["scene"])
    handed = _planned(method, scene, task) if method.kind == "planner" else _played(method, scene, task)
    row: Row = {
        "method": method.name,
        "run": method.run,
        "split": task["split"],
        "number": task["number"],
        "scene_hash": scene.hash,
        "certified": False,
        "reason": handed.reason,
        "max_strain": None,
        "required_friction": None,
        "clearance": None,
        "strain_limit": scene.limits.strain,
        "friction_limit": scene.limits.friction,
        "evaluations": handed.evaluations,
        "decisions": handed.decisions,
        "transfer": _transferred(method, scene, task) if task["transfer"] else None,
    }
    if handed.grasp is not None and handed.path is not None:
        judged = certify(scene, handed.grasp, handed.path, task["resolution"])
        row |= {
            "certified": judged.certified,
            "reason": judged.reason,
            "max_strain": judged.max_strain,
            "required_friction": min(judged.required_friction, 1e9),  # JSON has no infinity
            "clearance": judged.clearance,
        }
    row["timing"] = {"seconds": handed.seconds, "decision_seconds": handed.decision_seconds}
    return row


def _planned(method: Method, scene: Scene, task: WorkItem) -> HandedIn:
    start = time.perf_counter()
    try:
        best = plan(scene, method.name, task["resolution"], workers=1)
    except NoPlan as none:
        reasons = Counter(str(c.reason) for c in none.candidates if c.reason not in ("pruned", PROMISING))
        commonest = min(reasons, key=lambda r: (-reasons[r], r)) if reasons else "not_visible"
        spent = sum(c.increments for c in none.candidates)
        return HandedIn(reason=commonest, evaluations=spent, seconds=time.perf_counter() - start)
    spent = sum(c.increments for c in best.candidates)
    return HandedIn(best.grasp, best.path, "", spent, time.perf_counter() - start)


def acting(method: Method, task: WorkItem) -> Decide:
    """Who plays. Raises PolicyError."""
    return load_policy(method.folder) if method.kind == "policy" else UNTRAINED[method.kind](task)


def _played(method: Method, scene: Scene, task: WorkItem) -> HandedIn:
    """What the jaws did, and a few moves more like the last where the environment, on a coarser mesh, saw the
    target: the certifier stops at visibility."""
    start = time.perf_counter()
    timed = _Timed(acting(method, task))
    name = PHYSICS[task["policy_physics"]].env_id
    env: Any = gym.make(name, resolution=task["policy_resolution"], disable_env_checker=True).unwrapped
    try:
        played = rollout(env, timed, seed=0, options={"scene": scene.dump(), "grasp": "agent"})
        grasp, path = env.episode.grasp, env.episode.path
    finally:
        env.close()
    if path is not None and played.success and len(path) > 2:
        path = led_out(path, task["lead_out"])
    handed = HandedIn(grasp, path, "" if path is not None else "diverged", len(played))
    handed.seconds = time.perf_counter() - start
    handed.decisions, handed.decision_seconds = timed.calls, timed.seconds
    return handed


def led_out(path: JawPath, moves: int) -> JawPath:
    """The path with its last move made so many times more."""
    poses = path.poses
    more = poses[-1] + np.arange(1, moves + 1)[:, None] * (poses[-1] - poses[-2])
    return JawPath.from_poses(np.concatenate([poses, more]), path.kind)


def _transferred(method: Method, scene: Scene, task: Mapping[str, Any]) -> str:
    """What became of a policy on the other physics: "ok", a failure, or "not_visible"."""
    env = gym.make(BULLET, disable_env_checker=True)
    try:
        played = rollout(env, acting(method, task), seed=0, options={"scene": scene.dump()})
    finally:
        env.close()
    return "ok" if played.success else played.infos[-1]["failure"] or "not_visible"
