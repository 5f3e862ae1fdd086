"""Many processes at once that need the same kernels, none of which is on disk yet."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from typing import Any

from baselines.jobs.journal import Row, WorkItem
from benchmarks._report import ROOT

AT_ONCE = (2, 10, 100)
LONGEST = 3600.0
"""s, until all have compiled."""
SCRIPT = """
import numpy as np
from retract_env.compilation import is_cached
from retract_env.scene import load_scene
from retract_env.spring import stiffness
from retract_env.spring.model import SpringModel
there = is_cached(stiffness._integrate)
found = SpringModel(load_scene("ten_veins").tissue).k_eq(np.linspace(-0.05, -0.001, 50))
print(there, found.tobytes().hex())
"""


def cache_tasks(count: int, code: str) -> list[dict[str, Any]]:
    """So many rounds of each number of processes."""
    return [
        {"part": "caches", "processes": processes, "round": k, "code": code}
        for processes in AT_ONCE
        for k in range(count)
    ]


def compiled(task: WorkItem) -> Row:
    """Whether all of them find the same, to the last bit, and whoever comes later what they compiled."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder, "PYTHONPATH": str(ROOT)}
        begun = [_begin(environment) for _ in range(task["processes"])]
        try:
            said = [process.communicate(timeout=LONGEST) for process in begun]
        except subprocess.TimeoutExpired:
            return {"outcome": "time", "detail": f"more than {LONGEST:.0f} s"}
        finally:
            for process in begun:
                process.kill()
                process.wait()
        begun.append(_begin(environment))
        said.append(begun[-1].communicate())
    for process, (_, errors) in zip(begun, said, strict=True):
        if process.returncode:
            how = errors.strip().splitlines() or [f"exit code {process.returncode}"]
            return {"outcome": "raised", "detail": how[-1]}
    words = [out.split() for out, _ in said]
    if len({found for _, found in words}) > 1:
        return {"outcome": "unsound", "detail": "not all processes find the same"}
    if words[-1][0] != "True":
        return {"outcome": "unsound", "detail": "no kernel is on disk in the end"}
    return {"outcome": "same"}


def _begin(environment: dict[str, str]) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", SCRIPT]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
