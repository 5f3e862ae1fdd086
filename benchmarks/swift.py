"""Plans that survive what is not known, and their cost: python -m benchmarks.swift [--flaps N].

On the shipped scenes with veins: `ctc`, `swift` by position and by force, the robust statement on top of
each, all warm and in one run. With --flaps, for so many test flaps: `swift` with all known against
`fem_gradient`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from baselines.benchmark.splits import load_benchmark
from benchmarks._report import machine, progress, table
from planners import NoPlan, Plan, plan
from planners.certify import stated
from retract_env.scene import Scene, Uncertainty, load_scene

SCENES = ("ten_veins", "twenty_veins")
WAYS = (("ctc", "position"), ("swift", "position"), ("swift", "force"))
REPEATS = 3


def timed(scene: Scene, planner: str, grip: str) -> tuple[Plan, float]:
    """The plan, and the seconds that it took."""
    start = time.perf_counter()
    found = plan(scene, planner, grip=grip)
    return found, time.perf_counter() - start


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=0, help="test flaps to compare with fem_gradient on")
    options = parser.parse_args(arguments)
    print(machine())
    rows = []
    for name in SCENES:
        scene = load_scene(name)
        for planner, grip in WAYS:
            progress(f"{name}, {planner}, {grip}")
            timed(scene, planner, grip)  # kernels, once
            seconds, said = [], []
            for _ in range(REPEATS):
                found, took = timed(scene, planner, grip)
                seconds.append(took)
                start = time.perf_counter()
                robust = stated(found.certificate, scene, found.grasp, found.path).robust
                said.append(time.perf_counter() - start)
            assert robust is not None
            strain = found.certificate.max_strain
            bound = f"{100 * robust['bound']:.2f} %"
            rows.append([name, planner, grip, strain, bound, min(seconds), max(seconds), min(said)])
    head = ["scene", "planner", "grip", "strain", "fails at most", "s, least", "s, most", "statement, s"]
    print(table(head, rows))
    if not options.flaps:
        return
    ratios = []
    for k, scene in enumerate(load_benchmark("benchmark").splits["test"].scenes(options.flaps)):
        progress(f"test flap {k}")
        known = scene.model_copy(update={"uncertainty": Uncertainty.none()})
        try:
            ratios.append(
                plan(known, "swift").certificate.max_strain
                / plan(scene, "fem_gradient").certificate.max_strain
            )
        except NoPlan:
            progress("no plan")
    share = float(np.mean(np.array(ratios) <= 1.02))
    print(
        f"swift with all known over fem_gradient, {len(ratios)} flaps: median {np.median(ratios):.3f}, "
        f"greatest {max(ratios):.3f}, at most 1.02 on {share:.0%}"
    )


if __name__ == "__main__":
    main()
