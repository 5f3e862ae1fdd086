"""What a certificate and a step of the finite-element environment take: python -m benchmarks.certificate.

A certificate at "fine" of the best plan of a planner, kernels loaded, mesh and squeeze included: least CPU
time of some repeats, with what it is made of. Then steps a second of TissueRetractFEM-v0 at "coarse" along
planned paths on random flaps, as in `benchmarks.env`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks._report import machine, on_one_thread, progress, table
from benchmarks.env import measure
from planners import Plan, plan
from planners.certify import Trial
from retract_env.scene import Scene, load_scene

PLANS = (("ten_veins", "ctc"), ("ten_veins", "eased"), ("twenty_veins", "ctc"))
PARTS = ("mesh", "assembly", "equilibrium", "measures")


def judged(scene: Scene, best: Plan) -> tuple[float, Trial]:
    """CPU time, s, and the trial at its end."""
    start = time.thread_time()
    trial = Trial(scene, best.grasp, best.path, "fine")
    trial.squeeze()
    trial.move()
    trial.certificate()
    return time.thread_time() - start, trial


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="of a certificate; default: %(default)s")
    parser.add_argument("--seconds", type=float, default=5.0, help="of steps; default: %(default)s")
    options = parser.parse_args(arguments)
    print(machine())
    rows: list[tuple[object, ...]] = []
    for name, planner in PLANS:
        progress(f"{name}, {planner}")
        scene = load_scene(name)
        best = plan(scene, planner, workers=1)
        seconds, trial = min((judged(scene, best) for _ in range(options.repeats)), key=lambda run: run[0])
        assert trial.physics is not None
        physics = trial.physics
        counts = physics.equilibrium.counts
        rows.append(
            (
                f"{name}, {planner}",
                f"{seconds:.2f}",
                *(f"{physics.seconds[part]:.2f}" for part in PARTS),
                len(trial.frames),
                counts["iterations"],
                counts["factorisations"],
                f"{trial.max_strain:.6f}",
                f"{trial.required_friction:.5f}",
            )
        )
    heads = ("certificate", "cpu s", *PARTS, "equilibria", "iterations", "factorised", "strain", "friction")
    print(f"\n{table(heads, rows)}\n", flush=True)
    progress("steps of the environment")
    measure("fem", "coarse", "random", 0.0)  # loads the kernels
    times, _ = measure("fem", "coarse", "random", options.seconds)
    new, again, grasp = (1e3 * float(np.median(t)) for t in (times.new, times.again, times.grasp))
    print(f"TissueRetractFEM-v0, random flaps: {len(times.steps) / sum(times.steps):.0f} steps/s; ms of a")
    print(f"reset on a new flap {new:.0f}, on the same {again:.0f}, of a first action {grasp:.0f}")


if __name__ == "__main__":
    on_one_thread("benchmarks.certificate", sys.argv[1:])
    main()
