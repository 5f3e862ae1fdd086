"""How often a search that relies on the rod ends with another winner: python -m benchmarks.dismissal.

On random flaps, by seeds from --first on, the candidates of a planner of the paper's kind are searched with
pruning "rod" and followed to their ends, each at the same resolution. Every flap is one line of --file, and
flaps that are there already are not searched again, so that it can be broken off at any time. Printed are how
many winners agree, those that do not, and the processor time of both.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import ROOT, machine, progress, table
from planners.base import DISMISSED, NoPlan
from planners.paths import PAPER_PATHS
from planners.proposals import along, stable_grasps
from planners.search import generate_and_test
from retract_env.scene import sample_scene

FILE = ROOT / "out" / "dismissal.jsonl"
WAYS = ("none", "rod")


def searched(seed: int, kind: str, resolution: str) -> dict[str, Any]:
    """What both searches of a flap come to, as plain data."""
    scene = sample_scene(np.random.default_rng(seed))
    proposals = along(scene, stable_grasps(scene), [kind])
    row: dict[str, Any] = {"seed": seed, "kind": kind, "resolution": resolution, "candidates": len(proposals)}
    for pruning in WAYS:
        start = time.process_time()
        try:
            plan = generate_and_test(scene, proposals, kind, resolution, 1, pruning=pruning)
        except NoPlan as none:
            candidates, found = none.candidates, None
        else:
            candidates, found = plan.candidates, {"x": plan.grasp.x, "strain": plan.certificate.max_strain}
        dismissed = sum(c.reason == DISMISSED for c in candidates)
        spent = time.process_time() - start
        row[pruning] = {"winner": found, "dismissed": dismissed, "cpu_seconds": spent}
    return row


def agrees(row: dict[str, Any]) -> bool:
    """Whether both searches have the same winner, or none."""
    whole, rod = (row[way]["winner"] for way in WAYS)
    if whole is None or rod is None:
        return whole is rod
    return bool(whole["x"] == rod["x"] and math.isclose(whole["strain"], rod["strain"], rel_tol=1e-9))


def report(rows: Sequence[dict[str, Any]]) -> str:
    """How many agree, and a table of those that do not."""
    others = [row for row in rows if not agrees(row)]
    spent = [sum(row[way]["cpu_seconds"] for row in rows) for way in WAYS]
    dismissed = sum(row["rod"]["dismissed"] for row in rows)
    lines = [
        f"{len(rows) - len(others)} of {len(rows)} winners agree",
        f"{dismissed} of {sum(row['candidates'] for row in rows)} candidates dismissed by the rod",
        f"{spent[0]:.0f} s of processor time without pruning, {spent[1]:.0f} s with the rod",
    ]
    if others:
        told = [
            (row["seed"], *(json.dumps(row[way]["winner"]) if row[way]["winner"] else "none" for way in WAYS))
            for row in others
        ]
        lines += ["", table(("seed", "winner without pruning", "with the rod"), told)]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=200, help="default: %(default)s")
    parser.add_argument("--first", type=int, default=60_000, help="seed (default: %(default)s)")
    parser.add_argument("--kind", choices=PAPER_PATHS, default="ctc", help="of paths (default: %(default)s)")
    parser.add_argument("--resolution", default="coarse", help="default: %(default)s")
    parser.add_argument("--file", type=Path, default=FILE, help="default: %(default)s")
    options = parser.parse_args(arguments)
    options.file.parent.mkdir(parents=True, exist_ok=True)
    asked = {"kind": options.kind, "resolution": options.resolution}
    seeds = range(options.first, options.first + options.flaps)
    rows: dict[int, dict[str, Any]] = {}
    if options.file.exists():
        for line in options.file.read_text("utf-8").splitlines():
            row = json.loads(line)
            if row["seed"] in seeds and all(row[name] == value for name, value in asked.items()):
                rows[row["seed"]] = row
    for seed in seeds:
        if seed not in rows:
            progress(f"flap {seed}")
            rows[seed] = searched(seed, **asked)
            with options.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[seed]) + "\n")
    print(machine())
    print(report(list(rows.values())))


if __name__ == "__main__":
    main()
