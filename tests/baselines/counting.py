"""Work for `run_tasks` that leaves traces, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.jobs.journal import run_tasks


def square(task: Mapping[str, Any]) -> dict[str, Any]:
    """Squares `n`; each call is a line in `trace`. Where the file `bomb` is, the worker takes it and dies."""
    with Path(task["trace"]).open("a") as file:
        file.write(f"{task['n']}\n")
    if "bomb" in task and Path(task["bomb"]).exists():
        if task["once"]:
            Path(task["bomb"]).unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(task.get("seconds", 0.0))
    return {"n": task["n"], "square": task["n"] ** 2}


def fails(task: Mapping[str, Any]) -> dict[str, Any]:
    """The first raises when the second has begun, which leaves its process' number and takes a minute."""
    trace = Path(task["trace"])
    if task["n"] == 0:
        while not trace.exists():
            time.sleep(0.02)
        raise ValueError("a work's own")
    trace.write_text(str(os.getpid()))
    time.sleep(60)
    return {}


def tasks(folder: Path, count: int = 6, **more: Any) -> list[dict[str, Any]]:
    """Tasks that leave their traces in a folder."""
    return [{"n": n, "trace": str(folder / "trace"), **more} for n in range(count)]


def main() -> None:
    """Arguments: folder, seconds of each task, processes."""
    folder, seconds, jobs = Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    run_tasks(tasks(folder, seconds=seconds), square, folder / "journal", jobs)


if __name__ == "__main__":
    main()
