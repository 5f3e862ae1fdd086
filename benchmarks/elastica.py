"""Time per grasp of the planner `elastica`, and what it gains over CTC: python -m benchmarks.elastica.

Processor times on one core. Program: IPOPT's first solution from the CTC arcs. All: the grip measured, up to
three solutions and their coarse finite-element trials. The certificates of both planners are left out of the
times.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence

from benchmarks._report import machine, on_one_thread, progress, table
from planners.base import Contestant, NoPlan
from planners.elastica.grip import measured_grip
from planners.elastica.planner import Elastica
from planners.elastica.program import Unsolved, solve
from planners.paths import ctc
from planners.proposals import stable_grasps
from planners.search import race
from retract_env.grasp import Grasp
from retract_env.scene import LineOfSight, Scene, load_scene

LINES = {
    "homogeneous": ((0.25, 45), (0.15, 45), (0.1, 75)),
    "ten_veins": ((0.25, 45),),
}
"""Where lines of sight meet the bed, over the flap's length, and their slopes, degrees."""
HEAD = (
    "grasp mm",
    "program s",
    "iterations",
    "all s",
    "by the rod",
    "compression / h",
    "eps_max",
    "friction",
)
TARGET = 1.0
"""s, for the program"""


def judged(scene: Scene, contestant: Contestant, resolution: str) -> tuple[float, float, float, float]:
    """Compression over the height, eps_max, friction, and processor seconds until the last proposal was
    handed in; nan where it is not certified."""
    start = time.process_time()
    try:
        plan = race(scene, [contestant], "benchmark", resolution, 1)
    except NoPlan:
        return math.nan, math.nan, math.nan, time.process_time() - start
    certificate = plan.certificate
    return (
        plan.grasp.compression / scene.tissue.height,
        certificate.max_strain,
        certificate.required_friction,
        plan.timings["proposing"],
    )


def row(scene: Scene, grasp: Grasp, resolution: str) -> tuple[object, ...]:
    grip = measured_grip(scene, grasp)
    start = time.process_time()
    try:
        first = solve(scene, grasp, grip)
        iterations, strain = str(first.iterations), first.strain
    except Unsolved as problem:
        iterations, strain = str(problem), math.nan
    program = time.process_time() - start

    path = ctc(scene, grasp)
    part, eps, friction, everything = judged(scene, Elastica(scene, grasp, path), resolution)
    _, *paper, _ = judged(scene, Contestant(grasp, path), resolution)
    return (
        f"{1e3 * grasp.x:.1f}",
        program,
        iterations,
        everything,
        strain,
        part,
        f"{eps:.4f} ({paper[0]:.4f})",
        f"{friction:.3f} ({paper[1]:.3f})",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", choices=LINES, nargs="+", default=list(LINES), help="default: all")
    parser.add_argument("--resolution", default="fine", help="of the certificates; default: %(default)s")
    options = parser.parse_args(arguments)
    print(machine())
    warm = load_scene("homogeneous")
    grasp = Grasp(-0.7 * warm.tissue.length, warm.tissue.height / 4)
    grip = measured_grip(warm, grasp)  # loads the kernels
    start = time.process_time()
    solve(warm, grasp, grip)
    print(f"\nthe program written down, compiled and solved once: {time.process_time() - start:.2f} s")
    times = []
    for name in options.scenes:
        for target, slope in LINES[name]:
            progress(f"{name}, line to {target:.0%} at {slope} degrees")
            scene = load_scene(name)
            line = LineOfSight.at(-target * scene.tissue.length, math.radians(slope))
            scene = scene.model_copy(update={"line_of_sight": line})
            rows = [row(scene, grasp, options.resolution) for grasp in stable_grasps(scene)]
            times += [r[1] for r in rows if isinstance(r[1], float)]
            print(
                f"\n{name}, B at {target:.0%}, {slope} degrees; CTC in brackets\n\n{table(HEAD, rows)}",
                flush=True,
            )
    quick = sum(t < TARGET for t in times)
    mean = sum(times) / len(times)
    print(
        f"\nprogram: mean {mean:.2f} s, {quick} of {len(times)} under {TARGET:g} s, worst {max(times):.2f} s"
    )


if __name__ == "__main__":
    on_one_thread("benchmarks.elastica", sys.argv[1:])
    main()
