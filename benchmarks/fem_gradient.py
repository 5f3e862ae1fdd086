"""Times and strains of `fem_gradient` beside other planners': python -m benchmarks.fem_gradient.

Every plan is made once, at fine, kernels loaded before. The planner is asked to take less than 10 s a scene
and to strain the tissue less than any other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

from benchmarks._report import machine, progress, table
from planners import NoPlan, plan
from retract_env.scene import load_scene

NAMES = ("homogeneous", "homogeneous_near", "ten_veins", "twenty_veins")
PLANNERS = ("fem_gradient", "eased", "light_grip", "ctc")


def row(name: str, planner: str, workers: int) -> tuple[object, ...]:
    """One line of the table."""
    progress(f"{planner}, {name}")
    scene = load_scene(name)
    wall, cpu = time.perf_counter(), time.process_time()
    found: list[str]
    try:
        best = plan(scene, planner, workers=workers)
    except NoPlan as none:
        found = [str(none)] + [""] * 3
    else:
        certificate, compression = best.certificate, best.grasp.compression / scene.tissue.height
        found = [f"{certificate.max_strain:.4f}", f"{certificate.required_friction:.3f}"]
        found += [f"{1e3 * best.grasp.x:.1f}", f"{compression:.3f}"]
    seconds = (time.perf_counter() - wall, time.process_time() - cpu)
    return name, planner, *found, *(f"{s:.1f}" for s in seconds)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", nargs="+", choices=NAMES, default=NAMES, help="default: all")
    parser.add_argument("--planners", nargs="+", choices=PLANNERS, default=PLANNERS, help="default: all")
    parser.add_argument("--workers", type=int, default=2, help="default: %(default)s")
    options = parser.parse_args(arguments)
    print(machine())
    plan(load_scene("homogeneous"), "eased", "coarse", 1)  # loads the kernels
    rows = [row(name, planner, options.workers) for name in options.scenes for planner in options.planners]
    head = ("scene", "planner", "eps_max", "friction", "x mm", "compression / h", "wall s", "cpu s")
    print(f"\n{options.workers} workers, at fine\n\n{table(head, rows)}", flush=True)


if __name__ == "__main__":
    main()
