"""Times of the rivals and of whole studies: python -m benchmarks.studies.

Kernels are loaded before the clock starts, except in whole studies, whose processes load them themselves. The
aims hold for two cores with nothing else to do.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence

from benchmarks._report import ROOT, machine, progress, table
from planners import NoPlan, plan
from planners.deform_closure import NODES, PAIRS, brute_force
from retract_env.scene import load_scene
from retract_env.spring import SpringModel
from retract_env.threads import cores

FLAPS = ("homogeneous", "ten_veins", "twenty_veins")
AIMS = {"brute force": "20 s (the paper: 992 s)", "fig8": "60 s"}


def timed(work: Callable[[], object]) -> tuple[str, str]:
    """Wall-clock and processor time, s."""
    cpu, start = time.process_time(), time.perf_counter()
    work()
    return f"{time.perf_counter() - start:.2f}", f"{time.process_time() - cpu:.2f}"


def stiffness(flaps: Sequence[str]) -> None:
    rows: list[tuple[str, ...]] = []
    for name in flaps:
        scene = load_scene(name)
        brute_force(scene, 3, 200)
        progress(f"{PAIRS} pairs at {NODES} nodes, {name}")
        rows.append((name, "brute force", *timed(lambda s=scene: brute_force(s)), AIMS["brute force"]))  # type: ignore[misc]
        tissue = scene.tissue
        SpringModel(tissue).stable_grasps()
        rows.append((name, "spring model", *timed(lambda t=tissue: SpringModel(t).stable_grasps()), ""))  # type: ignore[misc]
    print(f"\n{table(('flap', 'stiffness and stable grasps', 'wall s', 'cpu s', 'aim'), rows)}", flush=True)


def searches(flaps: Sequence[str], names: Sequence[str], workers: int) -> None:
    rows: list[tuple[object, ...]] = []
    for name in flaps:
        scene = load_scene(name)
        for planner in names:
            progress(f"{planner} on {name}")
            cpu, start = time.process_time(), time.perf_counter()
            try:
                found = plan(scene, planner, workers=workers)
                told = f"{found.certificate.max_strain:.3f}", f"{found.certificate.required_friction:.2f}"
            except NoPlan:
                told = "none", ""
            spent = f"{time.perf_counter() - start:.1f}", f"{time.process_time() - cpu:.1f}"
            rows.append((name, planner, *told, *spent))
    print(
        f"\n{workers} workers\n\n{table(('flap', 'planner', 'strain', 'friction', 'wall s', 'cpu s'), rows)}"
    )


def studies(names: Sequence[str], workers: int) -> None:
    rows: list[tuple[str, ...]] = []
    for name in names:
        progress(f"retract reproduce {name}")
        code = "import sys; from baselines.cli.app import main; sys.exit(main())"
        with tempfile.TemporaryDirectory() as out:
            command = [sys.executable, "-c", code, "reproduce", name, "--out", out, "--workers", str(workers)]
            start, before = time.perf_counter(), os.times()
            subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            spent, after = time.perf_counter() - start, os.times()
        cpu = sum(after[2:4]) - sum(before[2:4])  # children and their children
        rows.append((f"retract reproduce {name}", f"{spent:.1f}", f"{cpu:.1f}", AIMS.get(name, "")))
    print(f"\n{workers} workers\n\n{table(('command', 'wall s', 'cpu s', 'aim'), rows)}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--flaps", choices=FLAPS, nargs="+", default=FLAPS, help="default: all")
    parser.add_argument(
        "--planners", nargs="*", default=["ctc", "light_grip", "deform_closure"], help="default: %(default)s"
    )
    parser.add_argument("--studies", nargs="*", default=["fig8"], help="default: %(default)s")
    parser.add_argument("--workers", type=int, default=cores(), help="default: one a core")
    options = parser.parse_args(arguments)
    print(machine())
    stiffness(options.flaps)
    if options.planners:
        searches(options.flaps, options.planners, options.workers)
    if options.studies:
        studies(options.studies, options.workers)


if __name__ == "__main__":
    main()
