"""Who competes: planners, trained policies, methods from elsewhere, a random policy, and doing nothing."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, MutableMapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from baselines.benchmark.external import found_at
from baselines.benchmark.splits import BenchmarkError
from baselines.jobs.journal import PLACE, WorkItem
from baselines.learning.policies import content_of, load_policy, policy_folder
from planners import PLANNERS
from planners.base import Plan
from planners.swift.planner import plan_swift
from retract_env.config import brief
from retract_env.rollout import Decide

COMPETING: MutableMapping[str, Callable[..., Plan]] = ChainMap(
    {"swift_force": partial(plan_swift, grip="force")},
    PLANNERS,
)
"""Planners by the names that tables have for them: all of PLANNERS, and `swift` with the other grip."""
NEEDS = {"elastica": "casadi"}
"""Planners that need a module which may be missing."""


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
    """planner, policy, external, or one of UNTRAINED"""
    name: str
    """what tables call it"""
    run: int = 0
    """seed of the training, for a policy"""
    folder: str = ""
    """of a policy; that an external method's module or package lies in"""
    content: str = ""
    """hash of a policy's files, or of an external method's: another one of that name is another task"""

    @classmethod
    def trained(cls, folder: Path) -> Method:
        """The policy in a folder, or a shipped one by its name.

        Raises PolicyError, and BenchmarkError for one that never learned to choose its grasp, as it is to do
        here.
        """
        folder = policy_folder(folder)
        policy = load_policy(folder)
        if (grasp := policy.env.get("kwargs", {}).get("grasp", "agent")) != "agent":
            raise BenchmarkError(
                f"{folder}: env.kwargs.grasp = {brief(grasp)}, allowed 'agent' in a benchmark"
            )
        return cls("policy", policy.name, int(policy.training["seed"]), str(folder), content_of(folder))

    @classmethod
    def external(cls, named: str) -> Method:
        """What "module:function" names, which is not run for that. Raises BenchmarkError."""
        folder, content = found_at(named)
        return cls("external", named, 0, str(folder), content)


def method_of(item: WorkItem) -> Method:
    """Who is to do it."""
    return Method(**item["method"], folder=item[PLACE])


def work_item(method: Method, **item: Any) -> dict[str, Any]:
    """A task of `baselines.benchmark.contest.compete`, plain data, with defaults for what is not said."""
    said = asdict(method)
    place = said.pop("folder")
    defaults: dict[str, Any] = {
        "split": "",
        "split_version": 0,
        "split_hash": "",
        "number": 0,
        "resolution": "fine",
        "policy_physics": "fem",
        "policy_resolution": "coarse",
        "lead_out": 0,
        "seed": 0,
        "limit": 600.0,
        "survival": None,
        "played": 0,
        "transfer": False,
        "code": "",
    }
    if unknown := item.keys() - defaults.keys() - {"scene"}:
        raise ValueError(f"work_item: unknown {', '.join(sorted(unknown))}")
    return defaults | item | {"method": said, PLACE: place}
