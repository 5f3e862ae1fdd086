"""Speed of the planar rod against PyElastica and dismech-newton: python -m benchmarks.against_pyelastica.

Both are public codes for rods that bend and stretch, and PyElastica's shear too. Neither is a dependency:

    pip install --target build/elastica --no-deps pyelastica tqdm cma dismech-newton "newton~=1.6.0" warp-lang
    PYTHONPATH=.:build/elastica python -m benchmarks.against_pyelastica

All codes get the same flap, weight, jaws, number of elements and first guess of each pose, and one thread.
PyElastica computes the motion towards the equilibrium, with the time step and the damping that lead there
soonest. dismech-newton, on the CPU, takes steps in time so long that they are steps of its solver towards the
equilibrium, with as many iterations in each as are fastest. It has no bed like ours and does not shear, so it
is measured against our rod without a bed and almost without shear as well.

Theirs have arrived as soon as every node is within the tolerance of where it will come to rest, which they
are told; ours goes on to its own tolerance, near rounding. Their clamps hold the middles of elements, and
where it is stretched PyElastica's rod keeps its volume. So shapes differ a little, by half with twice the
elements.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import product

import numpy as np

from benchmarks._report import machine, on_one_thread, progress, table
from benchmarks._rods import (
    BED,
    LENGTH,
    POSES,
    SHEAR,
    UNSHEARABLE,
    Array,
    Motion,
    Relaxing,
    rolled,
    settled,
    timed,
    with_retract,
)

Make = Callable[[Motion, float, float], Relaxing]

PYELASTICA = ("PyElastica", "benchmarks._rods_pyelastica", "PyElastica")
DISMECH = ("dismech-newton", "benchmarks._rods_dismech", "DiSMech")
SETTINGS: dict[str, tuple[str, Sequence[float], Sequence[float]]] = {
    "PyElastica": ("step {:g} of sound's, damping {:g}", (0.6, 0.7, 0.8, 0.9), (0.2, 0.3, 0.4, 0.5)),
    "dismech-newton": ("{:g} iterations a step, exact {:g}", (1, 2, 3, 4, 6), (0, 1)),
}
"""What a code can choose from, two numbers each"""
CAREFUL = {"PyElastica": (0.5, 0.3), "dismech-newton": (10, 1)}
"""Settings to find out where it comes to rest"""
MOST, STILL = 300, 1e-6
"""Advances of a pose, and how far one moves a node at rest, h"""


def installed(name: str, module: str, code: str) -> Make | None:
    """The code, or None and a line about what to install."""
    try:
        make: Make = getattr(import_module(module), code)
    except ImportError as missing:
        print(f"{name} is not installed, {missing.name} is missing: pip install {name.lower()}")
        return None
    return make


def theirs(
    name: str, make: Make, motion: Motion, ours: Array, tolerance: float, repeats: int
) -> tuple[float, float, float, str]:
    """Seconds by the fastest settings, advances of a pose, distance to our equilibria, h; the settings."""
    progress(f"{name}, {motion.flaps} flaps: to rest")
    rest = settled(make(motion, *CAREFUL[name]), motion, MOST, STILL)
    apart = max(
        float(np.linalg.norm(there.sections - nodes[..., :2], axis=-1).max())
        for there, nodes in zip(rest, ours, strict=True)
    )
    text, ones, others = SETTINGS[name]
    best = (np.inf, 0, (0.0, 0.0))
    for choice in product(ones, others):
        progress(f"{name}, {motion.flaps} flaps: {text.format(*choice)}")
        seconds, advances = timed(make(motion, *choice), motion, rest, tolerance * LENGTH, MOST)
        best = min(best, (seconds, advances, choice))
    code = make(motion, *best[2])
    seconds = min(best[0], *(timed(code, motion, rest, tolerance * LENGTH, MOST)[0] for _ in range(repeats)))
    return seconds, best[1] / POSES, apart, text.format(*best[2])


def compare(flaps: int, elements: int, tolerance: float, repeats: int) -> None:
    """Print one table."""
    motion = rolled(elements, flaps)
    ours: dict[str, tuple[float, Array]] = {}
    for name, bed, shear in (("retract", BED, SHEAR), ("retract, as dismech-newton", 0.0, UNSHEARABLE)):
        runs = [with_retract(motion, bed, shear) for _ in range(10 * repeats)]
        ours[name] = min(run[0] for run in runs), runs[0][1]
    (quick, shapes), (stiff, unsheared) = ours.values()
    rows: list[tuple[object, ...]] = []
    each = 1e6 / POSES / flaps
    for name, (seconds, _) in ours.items():
        rows.append((name, seconds * each, seconds / quick, seconds / stiff, "", "", ""))
    for described, nodes in ((PYELASTICA, shapes), (DISMECH, unsheared)):
        make = installed(*described)
        if make:
            name = described[0]
            seconds, steps, apart, settings = theirs(name, make, motion, nodes, tolerance, repeats)
            apart *= 100 / LENGTH
            rows.append((name, seconds * each, seconds / quick, seconds / stiff, steps, settings, apart))
    print(f"\n{flaps} flaps side by side, {elements} elements, {POSES} poses; one thread\n")
    head = ("code", "us each", "by retract's", "by 2nd row's", "advances", "settings", "apart % of length")
    print(table(head, rows), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--flaps", type=int, nargs="+", default=[1, 16], help="side by side, 1-16; default: %(default)s"
    )
    parser.add_argument("--elements", type=int, default=16, help="default: %(default)s")
    parser.add_argument("--tolerance", type=float, default=1e-3, help="of length; default: %(default)s")
    parser.add_argument("--repeats", type=int, default=3, help="the fastest counts; default: %(default)s")
    options = parser.parse_args(arguments)
    if not all(1 <= flaps <= 16 for flaps in options.flaps) or options.elements < 4:
        parser.error("--flaps: allowed 1-16; --elements: 4 or more")
    if options.repeats < 1 or not options.tolerance > 0:
        parser.error("--repeats and --tolerance: allowed above 0")
    on_one_thread("benchmarks.against_pyelastica", sys.argv[1:] if arguments is None else arguments)
    print(machine())
    with_retract(rolled(options.elements, 1))  # compiles kernels
    for flaps in options.flaps:
        compare(flaps, options.elements, options.tolerance, options.repeats)


if __name__ == "__main__":
    main()
