"""Episodes with random actions on wide random scenes, in one process: they end, and leave nothing behind.

A process may grow by MOST_GROWTH over a block, and from the end of the first to that of the last, and may
have no more files open: memory that is lost is soon more than that. On rods 200 blocks came to 4 MB, on
finite elements 4 to 107 MB, as the allocator keeps what the largest flap has needed.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from baselines.jobs.journal import Row, WorkItem
from retract_env.errors import ConfigError, FlapRefused, MeshError
from retract_env.physics.registry import PHYSICS
from soak.outcomes import apart
from soak.scenes import wide_scene

BLOCK = 50
"""Episodes that are one piece of work."""
LIMIT = 1800.0
"""s, for a block."""
MOST_GROWTH = 512
"""MB"""
LONGEST_STEP = {"rod": 5.0, "fem": 180.0, "bullet": 120.0}
"""s of processor time that a reset or a step may take. On finite elements: some 380 Newton iterations are
allowed on a flap twelve times as deep as long, of 21,000 unknowns, each with one or two factorisations of
.25 s."""


def episode_tasks(physics: str, episodes: int, code: str) -> list[dict[str, Any]]:
    """So many episodes, in blocks."""
    return [
        {"part": physics, "first": first, "count": min(BLOCK, episodes - first), "limit": LIMIT, "code": code}
        for first in range(0, episodes, BLOCK)
    ]


def played(task: WorkItem) -> Row:
    """How a block of episodes ended, and what the process holds since."""
    return apart(_played, task, task["limit"])


def _played(task: dict[str, Any]) -> Row:
    name = PHYSICS[task["part"]].env_id
    settings: dict[str, Any] = {} if task["part"] == "rod" else {"resolution": "coarse"}
    env = gym.make(name, disable_env_checker=True, **settings)
    ends: Counter[str] = Counter()
    slowest, steps, unsound = 0.0, 0, ""
    try:
        env.reset(seed=0)  # what is compiled or loaded at first is no step's time
        env.step(np.zeros(3, np.float32))
        before = held()
        for number in range(task["first"], task["first"] + task["count"]):
            rng = np.random.default_rng([number, 2])
            try:
                start = time.process_time()
                seen, info = env.reset(seed=number, options={"scene": wide_scene(number)})
                slowest = max(slowest, time.process_time() - start)
            except (ConfigError, MeshError):
                ends["refused"] += 1
                continue
            over = False
            try:
                while not over:
                    action = rng.uniform(-1, 1, 3).astype(np.float32)
                    start = time.process_time()
                    seen, reward, terminated, truncated, info = env.step(action)
                    slowest = max(slowest, time.process_time() - start)
                    over = terminated or truncated
                    steps += 1
                    if not (env.observation_space.contains(seen) and np.isfinite(float(reward))):
                        unsound = f"episode {number}: an observation or a reward that is out of bounds"
            except FlapRefused:  # as the jaws close
                ends["refused"] += 1
                continue
            ends["ok" if info["is_success"] else str(info["failure"] or "not_visible")] += 1
    finally:
        env.close()
    after = held()
    if slowest > LONGEST_STEP[task["part"]]:
        unsound = f"a step of {slowest:.1f} s"
    unsound = unsound or grown(before, after)
    return {
        "outcome": "unsound" if unsound else "ended",
        "detail": unsound,
        "tried": dict(ends),
        "steps": steps,
        "slowest": slowest,
        "before": before,
        "after": after,
    }


def grown(before: Mapping[str, int], after: Mapping[str, int]) -> str:
    """What a process holds more than it may, of what `held` says; "" where nothing."""
    if after["files"] > before["files"]:
        return f"{after['files']} open files, before {before['files']}"
    memory, least = after["memory"] / 2**20, before["memory"] / 2**20
    return f"{memory:.0f} MB of memory, before {least:.0f}" if memory > least + MOST_GROWTH else ""


def held() -> dict[str, int]:
    """Bytes of memory and open files that this process has."""
    if not Path("/proc/self").exists():
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return {"memory": most * (1 if sys.platform == "darwin" else 1024), "files": 0}
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return {"memory": pages * os.sysconf("SC_PAGE_SIZE"), "files": len(os.listdir("/proc/self/fd"))}
