"""How far certificates differ between processors: python -m benchmarks.machines.

The same retractions on the first flaps of `test`, in processes that compile kernels for other instructions,
and have MKL and OpenBLAS keep to them: what a machine without the later ones does. On one machine with one of
these sets certificates are the same to the last bit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from typing import Any

from baselines.benchmark.splits import load_benchmark
from benchmarks._report import ROOT, machine, progress, table
from planners.certify import Certificate, certify
from planners.certify.trial import ROUNDING, differences
from planners.paths import PATHS
from retract_env.grasp import Grasp

SETS = {
    "this processor's": {},
    "AVX2": {
        "NUMBA_CPU_NAME": "x86-64",
        "NUMBA_CPU_FEATURES": "+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,-fma",
        "MKL_CBWR": "AVX2,STRICT",
        "OPENBLAS_CORETYPE": "Haswell",
    },
    "SSE2": {
        "NUMBA_CPU_NAME": "x86-64",
        "NUMBA_CPU_FEATURES": "+sse2,-avx,-avx2,-fma",
        "MKL_CBWR": "COMPATIBLE",
        "OPENBLAS_CORETYPE": "Prescott",
    },
}
"""Instruction sets, and the variables that have kernels, factorisation and NumPy keep to them."""
KINDS = ("ctc", "circular", "linear60")
PLACES = (-0.8, -0.5)
"""Of grasps, over the flap's length."""
CLOSED = 0.25


def judged(flaps: int, resolution: str) -> list[dict[str, Any]]:
    """Certificates as plain data, flap by flap."""
    out = []
    for scene in load_benchmark("benchmark").splits["test"].scenes(flaps):
        for place in PLACES:
            grasp = Grasp(place * scene.tissue.length, CLOSED * scene.tissue.height)
            for kind in KINDS:
                out.append(certify(scene, grasp, PATHS[kind](scene, grasp), resolution).to_json())
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=20, help="how many of the split test")
    parser.add_argument("--resolution", default="fine")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.here:
        json.dump(judged(options.flaps, options.resolution), sys.stdout)
        return
    command = [sys.executable, "-m", "benchmarks.machines", "--here", "--flaps", str(options.flaps)]
    found: dict[str, list[dict[str, Any]]] = {}
    for name, variables in SETS.items():
        progress(f"{options.flaps} flaps with {name}")
        with tempfile.TemporaryDirectory() as kept:
            asked = os.environ | variables | {"NUMBA_CACHE_DIR": kept}
            done = subprocess.run(
                [*command, "--resolution", options.resolution], env=asked, cwd=ROOT, check=True,
                stdout=subprocess.PIPE,
            )  # fmt: skip
        found[name] = json.loads(done.stdout)
    first, rows = next(iter(found.values())), []
    fields: Counter[str] = Counter()
    for name, theirs in found.items():
        both = list(zip(first, theirs, strict=True))
        told = [differences(Certificate.from_json(a), Certificate.from_json(b)) for a, b in both]
        fields.update(line.partition(" = ")[0] for lines in told for line in lines)
        rows.append(
            (
                name,
                len(both),
                sum(a["hash"] == b["hash"] for a, b in both),
                sum(a["reason"] != b["reason"] for a, b in both),
                sum(map(bool, told)),
                *(
                    max(_apart(a[quantity], b[quantity]) for a, b in both)
                    for quantity in ("max_strain", "required_friction", "clearance")
                ),
            )
        )
    print(machine())
    head = ("instructions", "certificates", "same bits", "other verdicts", "refused", "strain", "friction")
    print(table((*head, "clearance, m"), rows))
    print(
        f"Greatest differences from the first. Refused: by `--check`, which allows {ROUNDING:g}; because of"
    )
    print(", ".join(f"{field} ({count})" for field, count in fields.most_common(12)) or "nothing")


def _apart(one: float | str, other: float | str) -> float:
    """What is infinite is a word in JSON."""
    return 0.0 if one == other else abs(float(one) - float(other))


if __name__ == "__main__":
    main()
