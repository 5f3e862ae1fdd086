"""Bytes that a fuzzer learns to write, into the readers of `damaged`: it keeps what takes a new way through.

Coverage-guided, by libFuzzer over atheris where that is installed (`pip install atheris`; CPython to 3.13 on
Linux).
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from baselines.jobs.journal import Row, WorkItem
from soak.damaged import READERS, sound_file

LIMIT = 7200.0
"""s, for one kind of file."""


def guided_tasks(runs: int, code: str) -> list[dict[str, Any]]:
    """So many runs for each kind of file; none without atheris."""
    kinds = [] if importlib.util.find_spec("atheris") is None else READERS
    return [{"part": "guided", "kind": kind, "runs": runs, "limit": LIMIT, "code": code} for kind in kinds]


def guided(task: WorkItem) -> Row:
    """What became of one kind: how many were read, and how many refused; or what was neither."""
    with tempfile.TemporaryDirectory() as folder:
        name, sound, beside = sound_file(task["kind"])
        seeds, place = Path(folder) / "seeds", Path(folder) / "place"
        seeds.mkdir()
        place.mkdir()
        (seeds / name).write_bytes(sound)
        for other, content in beside.items():
            (place / other).write_bytes(content)
        command = [sys.executable, "-m", "soak.fuzzed", task["kind"], str(task["runs"]), folder, name]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=task["limit"], check=False, errors="replace"
            )
        except subprocess.TimeoutExpired:
            return {"outcome": "time", "detail": task["kind"]}
    counted = re.search(r"counted: (\d+) read, (\d+) refused", done.stdout)
    if done.returncode or counted is None:
        last = [line for line in done.stderr.splitlines() if line.strip()][-30:]
        why = next((line for line in last if "Error" in line or "ERROR" in line), last[-1] if last else "")
        return {"outcome": "raised", "detail": f"{task['kind']}: exit {done.returncode}: {why}"[:500]}
    ways = re.findall(r"cov: (\d+)", done.stderr)
    read, refused = (int(number) for number in counted.groups())
    return {
        "outcome": "ended",
        "detail": f"{task['kind']}: {ways[0]} to {ways[-1]} branches" if ways else task["kind"],
        "tried": {"read": read, "refused": refused},
    }
