"""What the push of jaws' pads and of the fixed block changes: python -m benchmarks.contact.

The same motions on the first flaps of `test`, with these pushes and without. Where nothing is touched in any
increment, certificates have to be the same.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

from baselines.benchmark.splits import load_benchmark
from benchmarks._report import machine, on_one_thread, progress, table
from planners.certify import REASONS, Retraction
from planners.paths import PATHS
from retract_env.fem import contact
from retract_env.grasp import Grasp
from retract_env.scene import Scene

KINDS = ("ctc", "circular", "linear60")
PLACES, CLOSED = (-0.9, -0.7, -0.5), (0.2, 0.33)
"""Of grasps, over the flap's length; and by which part of its height the jaws close."""


def moved(scene: Scene, grasp: Grasp, kind: str, resolution: str) -> tuple[Retraction, bool]:
    """A retraction at its end, and whether block or pads pushed in an increment."""
    retraction = Retraction(scene, grasp, PATHS[kind](scene, grasp), resolution)
    touched = []

    def look() -> None:
        assert retraction.physics is not None
        touched.append(any(retraction.physics.model.contact.touches(retraction.physics.displacements)))

    retraction.squeeze(look)
    if not retraction.ended:
        retraction.move(on_increment=look)
    return retraction, any(touched)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=30, help="how many of the split test")
    parser.add_argument("--resolution", default="coarse")
    options = parser.parse_args(arguments)
    stiffness = contact.PAD_STIFFNESS, contact.BLOCK_STIFFNESS
    counts: dict[tuple[str, bool], Counter[str]] = {(k, w): Counter() for k in KINDS for w in (False, True)}
    work, touching = Counter[bool](), Counter[str]()
    greatest, differ = 0.0, 0
    for number, scene in enumerate(load_benchmark("benchmark").splits["test"].scenes(options.flaps)):
        for place in PLACES:
            for closed in CLOSED:
                grasp = Grasp(place * scene.tissue.length, closed * scene.tissue.height)
                for kind in KINDS:
                    progress(f"flap {number}, {kind}")
                    found = {}
                    for pushes in (False, True):
                        contact.PAD_STIFFNESS, contact.BLOCK_STIFFNESS = stiffness if pushes else (0.0, 0.0)
                        retraction, touched = moved(scene, grasp, kind, options.resolution)
                        found[pushes] = retraction
                        counts[kind, pushes][str(retraction.reason)] += 1
                        assert retraction.physics is not None
                        work[pushes] += retraction.physics.equilibrium.counts["iterations"]
                    touching[kind] += touched
                    if not touched:
                        differ += found[False].reason != found[True].reason
                        for name in ("max_strain", "required_friction"):
                            old, new = (getattr(found[pushes], name) for pushes in (False, True))
                            greatest = max(greatest, abs(new - old))
    print(machine())
    named = [reason for reason in REASONS if any(c[reason] for c in counts.values())]
    rows = [
        (kind, "yes" if w else "no", touching[kind] if w else "", *(c[r] for r in named))
        for (kind, w), c in counts.items()
    ]
    print(table(("path", "pads and block push", "touch", *named), rows))
    print(f"Of others {differ} end otherwise; their strain and friction change by {greatest:.1g} at most.")
    print(f"Newton iterations: {work[False]} without, {work[True]} with")


if __name__ == "__main__":
    on_one_thread("benchmarks.contact", sys.argv[1:])
    main()
