"""Warm times of retractions and plans, times and memory of whole processes: python -m benchmarks.speed.

Every figure is the best of the runs that fit into `--seconds`, at least one. Warm: kernels loaded, nothing
else kept.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

from benchmarks._reference import CASES, SQUEEZE, Case
from benchmarks._report import ROOT, machine, progress, table
from planners import NoPlan, Plan, plan
from planners.search import PRUNING, generate_and_test
from retract_env.physics.fem import FemPhysics
from retract_env.scene import load_scene

T = TypeVar("T")

RETRACTIONS = {"homogeneous": CASES[0], "ten_veins": CASES[4]}
PLANS = ("homogeneous", "ten_veins", "twenty_veins")
PARTS = ("mesh", "assembly", "equilibrium", "measures")
"""of the work, as the physics counts it"""
PAPER = {"ten_veins": (286, 76), "twenty_veins": (819, 95)}
"""s, without and with pruning. Sec. V-D."""
COLD = "ten_veins"


def best(work: Callable[[], T], budget: float) -> tuple[float, float, T]:
    """Least wall-clock, s, of the runs that fit into `budget` s, with that run's processor time, s, and
    result."""
    runs: list[tuple[float, float, T]] = []
    while not runs or sum(r[0] for r in runs) + runs[-1][0] < budget:
        cpu, start = time.process_time(), time.perf_counter()
        result = work()
        runs.append((time.perf_counter() - start, time.process_time() - cpu, result))
    return min(runs, key=lambda run: run[0])


def retract(case: Case) -> FemPhysics:
    """Mesh, rest, squeeze and all increments of a case, at fine."""
    scene, path = case.load()
    physics = FemPhysics(scene, case.x, "fine")
    physics.reset()
    for part in range(1, SQUEEZE + 1):
        physics.move_to(path.pose_at(part / SQUEEZE), part / SQUEEZE)
    physics.turn()
    for k in range(2, case.increments + 2):
        physics.move_to(path.pose_at(k), float(k))
    return physics


def retractions(budget: float) -> None:
    rows = []
    for name, case in RETRACTIONS.items():
        progress(f"one retraction, {name}")
        seconds, cpu, physics = best(partial(retract, case), budget)
        counts = physics.equilibrium.counts
        parts = [f"{physics.seconds[part]:.2f}" for part in PARTS]
        work = (len(physics.model.free), counts["iterations"], counts["factorisations"])
        rows.append((case.name, f"{seconds:.2f}", f"{cpu:.2f}", *parts, *work))
    head = ("one retraction", "wall s", "cpu s", *PARTS, "unknowns", "iterations", "factorised")
    print(f"\n{SQUEEZE} increments of squeeze and 48 of motion at fine\n\n{table(head, rows)}", flush=True)


def planned(name: str, pruning: str, workers: int) -> Plan | NoPlan:
    """`plan` as users call it, pruning as told."""
    told = partial(generate_and_test, pruning=pruning)
    with patch("planners.generate_and_test", told):
        try:
            return plan(load_scene(name), "ctc", workers=workers)
        except NoPlan as none:
            return none


def plans(names: Sequence[str], workers: Sequence[int], budget: float) -> None:
    rows: list[tuple[object, ...]] = []
    for name in names:
        found = set()
        for count in workers:
            unpruned = math.nan
            for pruning in reversed(PRUNING):
                progress(f"plan {name}, {count} workers, pruning {pruning}")
                seconds, cpu, result = best(partial(planned, name, pruning, count), budget)
                if pruning == "none":
                    unpruned = seconds
                increments = sum(c.increments for c in result.candidates)
                parts = ["" for _ in PARTS]
                if isinstance(result, Plan):
                    parts = [f"{result.timings.get(part, 0.0):.2f}" for part in PARTS]
                    found.add((result.grasp, result.certificate.max_strain))
                ratio = f"{unpruned / seconds:.1f}"
                rows.append((name, count, pruning, f"{seconds:.2f}", ratio, f"{cpu:.2f}", *parts, increments))
        winners = ", ".join(f"{1e3 * g.x:.2f} mm with strain {e:.4f}" for g, e in found) or "none"
        progress(f"certified grasp of {name}: {winners}" + (" (they should agree)" if len(found) > 1 else ""))
    head = ("plan", "workers", "pruning", "wall s", "ratio", "cpu s", *PARTS, "increments")
    print(f"\nratio: to no pruning; {', '.join(PARTS)}: s of work, over all threads\n\n{table(head, rows)}")
    told = "; ".join(f"{name} {a} s without and {b} s with pruning" for name, (a, b) in PAPER.items())
    print(f"\nthe paper, V-D: {told}", flush=True)


def run_process(arguments: Sequence[str], cache: str) -> tuple[float, float]:
    """Wall-clock, s, and peak memory, MiB (nan where the system does not tell), of `retract` in a process."""
    code = "import sys; from baselines.cli.app import main; sys.exit(main())"
    start = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
        stdout=subprocess.DEVNULL,
    )
    peak = math.nan
    if hasattr(os, "wait4"):
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        peak = usage.ru_maxrss / 2 ** (20 if sys.platform == "darwin" else 10)  # bytes there, KiB elsewhere
    if child.wait():
        raise RuntimeError(f"retract {' '.join(arguments)} ended with {child.returncode}")
    return time.perf_counter() - start, peak


def processes(budget: float) -> None:
    rows: list[tuple[object, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        command = ["plan", COLD, "--out", str(Path(folder) / "out")]
        kinds = {
            "plan, kernels not yet compiled": (command, 0.0),
            "plan, kernels cached": (command, budget),
            "plan --no-pictures, kernels cached": ([*command, "--no-pictures"], budget),
            "--help": (["--help"], budget),
        }
        for name, (arguments, allowed) in kinds.items():
            progress(f"process: retract {name}")
            seconds, _, (_, peak) = best(
                partial(run_process, arguments, str(Path(folder) / "numba")), allowed
            )
            rows.append((f"retract {name}", f"{seconds:.2f}", f"{peak:.0f}"))
    print(f"\nwhole processes, {COLD}\n\n{table(('command', 'wall s', 'peak MiB'), rows)}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each figure; default: %(default)s")
    parser.add_argument(
        "--parts", choices=("retractions", "plans", "processes"), nargs="+", help="default: all"
    )
    parser.add_argument("--scenes", choices=PLANS, nargs="+", default=PLANS, help="to plan for; default: all")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="default: 1 2")
    options = parser.parse_args(arguments)
    if min(options.workers) < 1:
        parser.error("--workers: allowed at least 1")
    wanted = options.parts or ("retractions", "plans", "processes")
    print(machine())
    retract(Case("homogeneous", "ctc", -0.025, 0.0011, increments=2))  # loads the kernels
    if "retractions" in wanted:
        retractions(options.seconds)
    if "plans" in wanted:
        plans(options.scenes, options.workers, options.seconds)
    if "processes" in wanted:
        processes(options.seconds)


if __name__ == "__main__":
    main()
