"""`retract benchmark`: planners, policies and methods from elsewhere, ranked on frozen scenes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from baselines.cli.console import RESULTS, BadInput, announce_compilation, exit_codes, usable_folder
from baselines.cli.work import (
    BenchmarkOption,
    ClusterOption,
    JobsOption,
    check_physics,
    command_line,
    expected,
    frozen_scenes,
    going_on,
    run_with_bar,
)


def benchmark_command(
    policies: Annotated[
        Path | None,
        typer.Option(help="Folder that holds trained policies, at any depth; else the shipped ones."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this one, by name, or MODULE:FUNCTION of your own; again for another. `all`: all that "
            "there are."
        ),
    ] = None,
    split: Annotated[
        list[str] | None, typer.Option(help="Of the frozen scenes, or NAME:COUNT of them; again for another.")
    ] = None,
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many of each split, for a try.")] = None,
    limit: Annotated[
        float | None,
        typer.Option(help="Seconds that a method has for a scene; the benchmark's if not given."),
    ] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer/--no-transfer", help="Whether policies are played on Bullet too.")
    ] = True,
    out: Annotated[Path, typer.Option(help="Folder for the report, and the journal.")] = RESULTS,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    benchmark: BenchmarkOption = None,
) -> None:
    """Rank all planners, trained policies, and methods of your own, on frozen scenes. A run that stopped goes
    on."""
    with exit_codes(), expected():
        from baselines.benchmark.contest import ACT, compete
        from baselines.benchmark.references import load_references
        from baselines.benchmark.report import write_report
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import check_installed, chosen, methods_of, tasks_of
        from baselines.learning.policies import TRAINED, load_policy

        import_module("rliable.metrics")  # what the report needs, before hours of work and not after
        about = load_benchmark(frozen_scenes(benchmark))
        if limit is not None:
            about = about.limited_to(limit)
        check_physics(about.policy_physics, about.policy_resolution)
        methods = chosen(methods_of(policies or TRAINED), method)
        check_installed(methods)
        if transfer and any(one.kind in ACT for one in methods):
            _check_bullet()
        tasks = tasks_of(about, methods, split or list(about.splits), scenes, transfer)
        with usable_folder(out), going_on(lambda: "the same command goes on where it stopped"):
            announce_compilation("fem", "planning", about.policy_physics)
            rows = run_with_bar(tasks, compete, out / ".benchmark.jsonl", jobs, cluster, "benchmark")
            curves: dict[str, list[Any]] = {}
            for one in methods:
                if one.kind == "policy":
                    curves.setdefault(one.name, []).append(load_policy(one.folder).training["curve"])
            stored = load_references(about.resolution)
            known = {scene: reference.strain for scene, reference in stored.items()}
            written = write_report(rows, out, about, command_line(), curves, known)
        typer.echo("written: " + ", ".join(str(path) for path in written))


def _check_bullet() -> None:
    """Raise BadInput where PyBullet is missing, which policies are to be played on too."""
    try:
        check_physics("bullet")
    except ImportError as missing:
        raise BadInput(f"{missing}; or leave that out with --no-transfer") from None
