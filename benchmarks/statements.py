"""Do plans fail as often as their robust statements say? python -m benchmarks.statements.

Plans of four kinds on validation flaps, fragile ones among them, are stated on a mesh, and then followed on
it on fresh draws of another seed. A statement is wrong where so many failures would have a probability below
1 % if the bound were right; its own count of failures should be near to what is found.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.stats import binom

from baselines.benchmark.splits import load_benchmark
from benchmarks._report import machine, progress, table
from planners import NoPlan, plan
from planners.certify import stated
from planners.certify.robust import outcome
from planners.side_by_side import Stop, side_by_side
from retract_env.scenarios import draws
from retract_env.scene import Scene, Uncertainty
from retract_env.threads import cores

KINDS = ("swift", "swift by force", "swift, all known", "eased")
SEED = 77_000_000
"""of the fresh draws"""


def row(number: int, scene: Scene, kind: str, mesh: str, count: int) -> list[object] | None:
    """What is said of one plan, and what is found; None where there is no plan."""
    planned = scene
    if kind.endswith("known"):
        planned = scene.model_copy(update={"uncertainty": Uncertainty.none()})
    grip = "force" if kind.endswith("force") else "position"
    try:
        found = plan(planned, "eased" if kind == "eased" else "swift", mesh, grip=grip)
    except NoPlan:
        return None
    said = stated(found.certificate, scene, found.grasp, found.path).robust
    assert said is not None
    stop = Stop()
    ends = side_by_side(
        lambda z: outcome(scene, found.grasp, found.path, z, mesh, stop),
        draws(count, SEED + number),
        cores(),
        stop,
    )
    failed = sum(end != "ok" for end in ends)
    expected = sum(said["failures"].values()) / said["samples"]
    right = float(binom.sf(failed - 1, count, said["bound"])) > 0.01
    return [number, kind, said["bound"], expected, failed / count, "yes" if right else "no"]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plans", type=int, default=20)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--mesh", default="coarse")
    options = parser.parse_args(arguments)
    print(machine())
    flaps = load_benchmark("benchmark").splits["validation"].scenes(-(-options.plans // len(KINDS)))
    rows = []
    for number in range(options.plans):
        kind = KINDS[number % len(KINDS)]
        progress(f"plan {number}: {kind}")
        found = row(number, flaps[number // len(KINDS)], kind, options.mesh, options.draws)
        if found is not None:
            rows.append(found)
    head = ["plan", "kind", "fails at most", "counted as failing", "fails", "the bound holds"]
    print(table(head, rows))
    gaps = np.array([[r[3], r[4]] for r in rows], float)
    print(f"counted as failing less failing, mean: {float(np.mean(gaps[:, 0] - gaps[:, 1])):.3f}")


if __name__ == "__main__":
    main()
