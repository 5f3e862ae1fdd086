"""What `retract plan ten_veins` takes in a fresh process, pictures included: python -m benchmarks.cold.

Cold: every run is a process of its own, which finds kernels and bytecode on disk from an earlier one.
Seconds are of the wall clock; processor seconds, which tell more on a busy machine, are of the process and of
those that it started and waited for. With `--against FOLDER` runs of another checkout take turns with these.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from benchmarks._report import ROOT, machine, progress, table

CONSOLE = "import sys; from baselines.cli import main; sys.exit(main())"
SCENE = "ten_veins"
STATEMENTS = ("pass", "import retract_env", "import planners", "import baselines.cli.app")
SAID = re.compile(r"^time: ([\d.]+) s; (.*)$")
PHASE = re.compile(r"([a-z ]+) ([\d.]+) s")
STARTED, BETWEEN, ENDED = "before the clock starts", "between", "after the last line"


@dataclass
class Run:
    """One process from its start to its end."""

    wall: float
    cpu: float
    stages: dict[str, float] = field(default_factory=dict)
    """s of wall clock, as the console says, with what it does not say around it"""


def run(command: Sequence[str], tree: Path) -> Run:
    """Run Python with these arguments on a checkout. Raises where the command fails."""
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # installed packages have theirs
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *command], env=environment, cwd=tree, stdout=subprocess.PIPE, text=True
    )
    stages: dict[str, float] = {}
    said, last = 0.0, start
    assert process.stdout is not None
    with process.stdout as lines:
        for line in lines:
            last = time.perf_counter()
            if found := SAID.match(line):
                said = float(found[1])
                stages = {name.strip(): float(s) for name, s in PHASE.findall(found[2])}
    _, status, used = os.wait4(process.pid, 0)
    end = time.perf_counter()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} in {tree}: exit {process.returncode}")
    if stages:
        between = max(0.0, said - sum(stages.values()))
        stages = {STARTED: last - start - said, **stages, BETWEEN: between, ENDED: end - last}
    return Run(end - start, used.ru_utime + used.ru_stime, stages)


def commands(planner: str | None, out: Path) -> dict[str, list[str]]:
    """What is measured, by the name that it has in the table."""
    chosen = [] if planner is None else ["--planner", planner]
    plan = ["-c", CONSOLE, "plan", SCENE, "--out", str(out), *chosen]
    names = {statement: ["-c", statement] for statement in STATEMENTS}
    return {**names, "plan, no pictures": [*plan, "--no-pictures"], "plan": plan}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=7, help="processes of each kind")
    parser.add_argument("--planner", help="the console's own choice if not given")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turns")
    options = parser.parse_args(arguments)
    print(machine() + "\n")
    trees = {"here": ROOT} | ({"there": options.against.resolve()} if options.against else {})
    runs: defaultdict[tuple[str, str], list[Run]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for name, command in commands(options.planner, Path(folder)).items():
            for k in range(options.runs + 1):
                for where, tree in trees.items():
                    progress(f"{name}, {where}, {k} of {options.runs}")
                    found = run(command, tree)
                    if k:  # the first one compiles
                        runs[name, where].append(found)
    rows = [
        [
            name, where, min(r.wall for r in found), median(r.wall for r in found),
            min(r.cpu for r in found), median(r.cpu for r in found),
        ]
        for (name, where), found in runs.items()
    ]  # fmt: skip
    head = ["fresh process", "", "least, s", "median, s", "processor, least, s", "median, s"]
    print(table(head, rows) + "\n")
    stages = list(dict.fromkeys(name for found in runs.values() for r in found for name in r.stages))
    rows = [
        [stage, *(median(r.stages.get(stage, 0.0) for r in runs["plan", where]) for where in trees)]
        for stage in stages
    ]
    print(table(["stage of plan, median s", *trees], rows))


if __name__ == "__main__":
    main()
