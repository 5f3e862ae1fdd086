"""The benchmark: methods times frozen scenes, each pair a task whose row the journal keeps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from baselines.benchmark.contest import ACT
from baselines.benchmark.methods import COMPETING, NEEDS, UNTRAINED, Method, work_item
from baselines.benchmark.splits import Benchmark, BenchmarkError
from baselines.jobs.journal import Row
from baselines.jobs.version import code_version
from baselines.learning.policies import JSON

ALL = "all"
"""In the place of a method's name: every one that there is."""


def methods_of(policies: Path | None) -> list[Method]:
    """All planners, every policy under a folder, and what plays without having learned.

    Raises BenchmarkError, also for a policy whose name is another method's, whose rows it would be taken for,
    and PolicyError for a folder that holds no sound policy.
    """
    found = [Method("planner", name) for name in COMPETING]
    if policies is not None:
        folders = sorted(file.parent for file in policies.rglob(JSON))
        if not folders:
            raise BenchmarkError(f"{policies}: holds no policy")
        trained = [Method.trained(folder) for folder in folders]
        seen: dict[tuple[str, int], str] = {}
        taken = (*COMPETING, *UNTRAINED, ALL)
        for method in trained:
            if method.name in taken or ":" in method.name:
                raise BenchmarkError(
                    f"{method.folder}: name = {method.name!r}, allowed one without ':' and none of "
                    f"{', '.join(taken)}"
                )
            other = seen.setdefault((method.name, method.run), method.folder)
            if other != method.folder:
                raise BenchmarkError(
                    f"{method.folder} and {other}: both are {method.name}, seed {method.run}"
                )
        found += sorted(trained, key=lambda m: (m.name, m.run))
    return [*found, *(Method(kind, kind) for kind in UNTRAINED)]


def chosen(methods: Sequence[Method], names: Sequence[str] | None) -> list[Method]:
    """The methods of these names, or all of them where no name is given; "module:function" is one that is
    not among them. Raises BenchmarkError for a name that none has."""
    known = list(dict.fromkeys(method.name for method in methods))
    names = names or [ALL]
    external = [Method.external(name) for name in dict.fromkeys(names) if ":" in name]
    for name in names:
        if name not in (*known, ALL) and ":" not in name:
            close = get_close_matches(name, known, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise BenchmarkError(
                f"method = {name!r}, allowed {', '.join(known)}, {ALL}, or module:function{hint}"
            )
    return [*(method for method in methods if ALL in names or method.name in names), *external]


def check_installed(methods: Iterable[Method]) -> None:
    """Raise BenchmarkError for a planner that needs what is not installed: before hours of work."""
    for method in methods:
        module = NEEDS.get(method.name) if method.kind == "planner" else None
        if module is not None and find_spec(module) is None:
            raise BenchmarkError(
                f"method = {method.name!r} needs {module}: pip install 'retract[optimize]', or name the "
                "methods that are to compete with --method"
            )


def tasks_of(
    benchmark: Benchmark,
    methods: Sequence[Method],
    splits: Sequence[str],
    most: int | None = None,
    transfer: bool = False,
    survival: bool = True,
) -> list[dict[str, Any]]:
    """One task for each method and scene, for `contest.compete`: one scene after the other, each with all
    methods, so that a run that is stopped has compared them on the first ones.

    splits: names, each alone or with how many of its scenes, as in "shifted:20"; most: scenes of each of the
    others, at most; transfer: whether policies are played on Bullet too; survival: whether draws of what is
    not known are judged. Raises BenchmarkError for an unknown split, one that is asked for twice, more scenes
    than it has, or scenes that have changed.
    """
    tasks = []
    seen: set[str] = set()
    for asked in splits:
        name, colon, count = asked.partition(":")
        if name not in benchmark.splits or (colon and not (count.isdecimal() and int(count) > 0)):
            allowed = ", ".join(benchmark.splits)
            raise BenchmarkError(f"split = {asked!r}, allowed {allowed}, each with :COUNT or without")
        if name in seen:
            raise BenchmarkError(f"split = {asked!r}, allowed each split once")
        seen.add(name)
        split = benchmark.splits[name]
        try:
            scenes = split.scenes(int(count) if colon else min(most or split.count, split.count))
        except BenchmarkError as error:
            raise BenchmarkError(f"split = {asked!r}: {error}") from None
        for number, scene in enumerate(scenes):
            tasks += [
                work_item(
                    method=method,
                    split=name,
                    split_version=split.version,
                    split_hash=split.hash,
                    number=number,
                    scene=scene.dump(),
                    resolution=benchmark.resolution,
                    policy_physics=benchmark.policy_physics,
                    policy_resolution=benchmark.policy_resolution,
                    lead_out=benchmark.lead_out,
                    seed=benchmark.seed,
                    limit=benchmark.limit,
                    survival=benchmark.survival.model_dump() if survival else None,
                    played=benchmark.played if survival and method.kind in ACT else 0,
                    transfer=transfer and method.kind in ACT,
                    code=code_version(),
                )
                for method in methods
            ]
    return tasks


def numbers(rows: Sequence[Row]) -> list[Row]:
    """The rows without what depends on the machine: the same for any number of workers, run after run."""
    return [{key: value for key, value in row.items() if key != "timing"} for row in rows]
