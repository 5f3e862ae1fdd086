"""Errors of coarse, medium and fine against converged values: python -m benchmarks.accuracy.

Converged values, how they were made and how sure they are: _reference.py and reference.json. `--converge`
makes them anew, which takes some minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks._reference import CASES, METRICS, STORED, Array, Case, converge, errors, follow, store
from benchmarks._report import machine, progress, table
from retract_env.errors import Diverged
from retract_env.fem.model import FlapModel
from retract_env.mesh import RESOLUTIONS

TARGETS = {"eps_max %": 2.0, "N %": 5.0, "shape %": 1.0}
"""Errors that `fine` is to stay below."""


def _two_layers(depth: float, *_: object, **__: object) -> Array:
    return np.array([0.0, depth / 4, depth / 2])


FINER: dict[str, Callable[[], AbstractContextManager[Any]]] = {
    "2 layers over the depth": lambda: patch("retract_env.fem.prism.depth_breaks", _two_layers),
    "6 points in a triangle": lambda: patch(
        "retract_env.physics.fem.FemPhysics.flap", partial(FlapModel, triangle_points=6)
    ),
}
"""Refinements that `fine` does without."""


def compare(references: Sequence[dict[str, Any]], names: Sequence[str]) -> None:
    """Print the errors of each resolution and case, and those of fine against the targets."""
    rows: list[tuple[object, ...]] = []
    fine: list[tuple[Case, dict[str, float], dict[str, float]]] = []
    for stored in references:
        case, reference = Case(**stored["case"]), stored["reference"]
        progress(case.name)
        for name in names:
            track = follow(case, RESOLUTIONS[name], reference["progress"][-1])
            found = errors(track, reference, case.length)
            if name == "fine":
                fine.append((case, found, stored["spread"]))
            rows.append((case.name, name, track.unknowns, *_digits(found), f"{track.seconds:.1f}"))
            if track.progress[-1] < reference["progress"][-1]:
                print(f"{case.name}, {name}: diverged after progress {track.progress[-1]:g}")
        rows.append((case.name, "not sure by", "", *_digits(stored["spread"]), ""))
    print(table(("case", "mesh", "unknowns", *METRICS, "s"), rows))
    for name, target in TARGETS.items() if fine else ():
        case, found, spread = max(fine, key=lambda f: abs(f[1][name]))
        verdict = "met" if abs(found[name]) <= target else "missed"
        print(f"\nfine, {name} within {target:g}: {verdict}; ", end="")
        print(
            f"worst {abs(found[name]):.2f} in {case.name}, whose reference is not sure by {spread[name]:.2f}",
            end="",
        )
    print()


def refine(references: Sequence[dict[str, Any]]) -> None:
    """Print by how much fine changes with more layers and more quadrature points."""
    rows: list[tuple[object, ...]] = []
    for stored in references:
        case, stations = Case(**stored["case"]), stored["reference"]["progress"]
        progress(f"{case.name}, finer integration")
        plain = follow(case, RESOLUTIONS["fine"], stations[-1])
        base = {k: v.tolist() for k, v in plain.at(stations).items()} | {"max_strain": max(plain.strain)}
        for name, changed in FINER.items():
            with changed():
                track = follow(case, RESOLUTIONS["fine"], stations[-1])
            rows.append((case.name, name, track.unknowns, *_digits(errors(track, base, case.length))))
    print("\n" + table(("case", "change of fine by", "unknowns", *METRICS), rows))


def _digits(found: dict[str, float]) -> list[str]:
    return [f"{found[name]:.{3 if name == 'friction' else 2}f}" for name in METRICS]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--converge", action="store_true", help="make the reference anew, some minutes a case"
    )
    parser.add_argument(
        "--cases", type=int, nargs="+", help=f"numbers from 0 to {len(CASES) - 1}; default: all"
    )
    parser.add_argument(
        "--meshes", choices=list(RESOLUTIONS), nargs="+", default=["coarse", "medium", "fine"]
    )
    options = parser.parse_args(arguments)
    chosen = range(len(CASES)) if options.cases is None else options.cases
    if not set(chosen) <= set(range(len(CASES))):
        parser.error(f"--cases: allowed 0 to {len(CASES) - 1}")
    known: dict[Case, dict[str, Any]] = {}
    if STORED.exists():
        known = {Case(**c["case"]): c for c in json.loads(STORED.read_text("utf-8"))["cases"]}
    print(machine())
    for case in (CASES[i] for i in chosen):
        if options.converge:
            try:
                known[case] = converge(case)
            except Diverged as problem:
                print(f"no reference: {problem}")
            store([known[c] for c in CASES if c in known])
        elif case not in known:
            print(f"{case.name}: no reference, make it with --converge")
        elif known[case]["scene_hash"] != case.load()[0].hash:
            print(f"{case.name}: the scene has changed since its reference, make it anew with --converge")
            del known[case]
    references = [known[CASES[i]] for i in chosen if CASES[i] in known]
    compare(references, options.meshes)
    refine(references[:1] + [r for r in references if r["case"]["scene"] == "ten_veins"][:1])


if __name__ == "__main__":
    main()
