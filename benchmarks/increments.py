"""Whether more increments would change a verdict: python -m benchmarks.increments.

Plans of several planners on random flaps are certified as they are handed in, and with every increment of the
motion divided into eight. The certifier looks between its increments itself; what it looks for there is
bounded to a tolerance (`planners.certify.retraction`), which this checks.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks._report import machine, on_one_thread, progress, table
from planners import NoPlan, plan
from planners.certify import Trial
from planners.certify.retraction import FRICTION_TOLERANCE, STRAIN_TOLERANCE
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene, sample_scene

PLANNERS = ("ctc", "circular", "eased", "fem_gradient")
DIVISION = 8


def judged(scene: Scene, grasp: Grasp, path: JawPath, resolution: str, division: int) -> tuple[Trial, float]:
    """A trial at its end, and the s that it took."""
    start = time.thread_time()
    trial = Trial(scene, grasp, path, resolution, division)
    trial.squeeze()
    trial.move()
    return trial, time.thread_time() - start


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=100, help="how many, by seeds from 0")
    parser.add_argument("--planners", nargs="+", default=list(PLANNERS))
    parser.add_argument("--resolution", default="coarse", help="of planning and certificates")
    options = parser.parse_args(arguments)
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in options.planners}
    changed = []
    for seed in range(options.flaps):
        scene = sample_scene(np.random.default_rng(seed))
        for name in options.planners:
            progress(f"flap {seed}, {name}")
            try:
                best = plan(scene, name, options.resolution, workers=1)
            except NoPlan:
                continue
            once, seconds = judged(scene, best.grasp, best.path, options.resolution, 1)
            finely, _ = judged(scene, best.grasp, best.path, options.resolution, DIVISION)
            whole = sum(1 for f in once.frames if f.progress >= 1 and f.progress == round(f.progress))
            found[name].append(
                (
                    finely.required_friction - once.required_friction,
                    100 * (finely.max_strain / once.max_strain - 1),
                    len([f for f in once.frames if f.progress >= 1]) - whole,
                    seconds,
                )
            )
            if once.reason != finely.reason:
                changed.append(f"flap {seed}, {name}: {once.reason}, in finer increments {finely.reason}")
    rows: list[tuple[object, ...]] = []
    for name, values in found.items():
        friction, strain, looks, seconds = np.array(values).T
        rows.append(
            (
                name,
                len(values),
                f"{friction.max():.4f}",
                f"{strain.max():.2f}",
                f"{looks.mean():.1f}",
                int(looks.max()),
                f"{np.median(seconds):.2f}",
            )
        )
    print(machine())
    heads = ("planner", "plans", "friction missed", "strain missed, %", "looks, mean", "most", "s")
    print(table(heads, rows))
    print(f"tolerances: friction {FRICTION_TOLERANCE}, strain {100 * STRAIN_TOLERANCE} %")
    print(f"{len(changed)} verdicts changed" + "".join(f"\n  {line}" for line in changed))


if __name__ == "__main__":
    on_one_thread("benchmarks.increments", sys.argv[1:])
    main()
