"""How trainings went, from the policies that they ended with.

`python -m baselines.benchmark.curves POLICIES OUT` writes training.csv, a line for each evaluation of each
seed, and training.png into the folder OUT.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from baselines.benchmark.charts import curve_chart
from baselines.jobs.files import csv_text, output_folder, written_whole
from baselines.learning.policies import JSON, load_policy

Curves = Mapping[str, Mapping[int, Sequence[Mapping[str, Any]]]]
"""By the policy's name and its seed."""


def read_curves(folder: Path) -> Curves:
    """Of every policy under a folder. Raises PolicyError."""
    found: dict[str, dict[int, Sequence[Mapping[str, Any]]]] = {}
    for file in sorted(folder.rglob(JSON)):
        policy = load_policy(file.parent)
        found.setdefault(policy.name, {})[int(policy.training["seed"])] = policy.training["curve"]
    return found


def as_csv(curves: Curves) -> str:
    """All of them; a column that a curve lacks is empty there."""
    lines = [
        {"policy": name, "seed": seed, **line}
        for name, seeds in curves.items()
        for seed, curve in sorted(seeds.items())
        for line in curve
    ]
    return csv_text(lines)


def main(arguments: Sequence[str]) -> None:
    """POLICIES, OUT."""
    policies, out = map(Path, arguments)
    curves = read_curves(policies)
    if not curves:
        raise SystemExit(f"{policies}: holds no policy")
    picture = curve_chart({name: list(seeds.values()) for name, seeds in curves.items()})
    contents = {"training.csv": as_csv(curves).encode(), "training.png": picture}
    with output_folder(out), ExitStack() as together:
        for name, content in contents.items():
            together.enter_context(written_whole(out / name)).write_bytes(content)


if __name__ == "__main__":
    main(sys.argv[1:])
