"""The benchmark: methods times frozen scenes, each pair a task whose row the journal keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from baselines.benchmark.methods import UNTRAINED, Method
from baselines.benchmark.splits import Benchmark, BenchmarkError
from baselines.jobs.journal import Row
from baselines.jobs.version import code_version
from baselines.learning.policies import JSON

TRANSFERRED = ("policy",)
"""Kinds of methods that are played on the other physics too."""


def methods_of(benchmark: Benchmark, policies: Path | None) -> list[Method]:
    """All planners of the benchmark, every policy under a folder, and what plays without having learned.

    Raises BenchmarkError, and PolicyError for a folder that holds no sound policy.
    """
    from planners import PLANNERS

    names = (*benchmark.planners, *benchmark.slow_planners)
    for name in names:
        if name not in PLANNERS:
            raise BenchmarkError(f"planners: {name!r}, allowed {', '.join(PLANNERS)}")
    found = [Method("planner", name) for name in names]
    if policies is not None:
        folders = sorted(file.parent for file in policies.rglob(JSON))
        if not folders:
            raise BenchmarkError(f"{policies}: holds no policy")
        trained = [Method.trained(folder) for folder in folders]
        seen: dict[tuple[str, int], str] = {}
        for method in trained:
            other = seen.setdefault((method.name, method.run), method.folder)
            if other != method.folder:
                raise BenchmarkError(
                    f"{method.folder} and {other}: both are {method.name}, seed {method.run}"
                )
        found += sorted(trained, key=lambda m: (m.name, m.run))
    return [*found, *(Method(kind, kind) for kind in UNTRAINED)]


def chosen(methods: Sequence[Method], names: Sequence[str] | None) -> list[Method]:
    """The methods of these names, or all. Raises BenchmarkError for a name that none has."""
    known = list(dict.fromkeys(method.name for method in methods))
    for name in names or ():
        if name not in known:
            raise BenchmarkError(f"method = {name!r}, allowed {', '.join(known)}")
    return [method for method in methods if not names or method.name in names]


def tasks_of(
    benchmark: Benchmark,
    methods: Sequence[Method],
    splits: Sequence[str],
    most: int | None = None,
    transfer: bool = False,
) -> list[dict[str, Any]]:
    """One task for each method and scene that it is judged on, for `methods.compete`.

    splits: names, each alone or with how many of its scenes, as in "shifted:20"; most: scenes of each of the
    others; transfer: whether policies are played on Bullet too. Raises BenchmarkError for an unknown split,
    or one whose scenes have changed.
    """
    tasks = []
    for asked in splits:
        name, colon, count = asked.partition(":")
        if name not in benchmark.splits or (colon and not (count.isdecimal() and int(count) > 0)):
            allowed = ", ".join(benchmark.splits)
            raise BenchmarkError(f"split = {asked!r}, allowed {allowed}, each with :COUNT or without")
        for number, scene in enumerate(benchmark.splits[name].scenes(int(count) if colon else most)):
            for method in methods:
                if method.name in benchmark.slow_planners and number >= benchmark.splits[name].slow:
                    continue
                tasks.append(
                    {
                        "method": asdict(method),
                        "split": name,
                        "number": number,
                        "scene": scene.dump(),
                        "resolution": benchmark.resolution,
                        "policy_physics": benchmark.policy_physics,
                        "policy_resolution": benchmark.policy_resolution,
                        "lead_out": benchmark.lead_out,
                        "seed": benchmark.seed,
                        "transfer": transfer and method.kind in TRANSFERRED,
                        "code": code_version(),
                    }
                )
    return tasks


def numbers(rows: Sequence[Row]) -> list[Row]:
    """The rows without what depends on the machine: the same for any number of workers, run after run."""
    return [{key: value for key, value in row.items() if key != "timing"} for row in rows]
