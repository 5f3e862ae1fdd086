"""`retract benchmark`: planners and policies compared on frozen scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from baselines.cli.console import RESULTS, announce_compilation, exit_codes, usable_folder
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
        list[str] | None, typer.Option(help="Of the methods only this one; again for another.")
    ] = None,
    split: Annotated[
        list[str] | None, typer.Option(help="Of the frozen scenes, or NAME:COUNT of them; again for another.")
    ] = None,
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many of each split.")] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer/--no-transfer", help="Whether policies are played on Bullet too.")
    ] = True,
    out: Annotated[Path, typer.Option(help="Folder for the report, and the journal.")] = RESULTS,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    benchmark: BenchmarkOption = None,
) -> None:
    """Compare planners, trained policies, a random one and doing nothing. A run that stopped goes on."""
    with exit_codes(), expected():
        from baselines.benchmark.methods import compete
        from baselines.benchmark.references import load_references
        from baselines.benchmark.report import write_report
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import chosen, methods_of, tasks_of
        from baselines.learning.policies import TRAINED, load_policy

        about = load_benchmark(frozen_scenes(benchmark))
        check_physics(about.policy_physics, about.policy_resolution)
        methods = chosen(methods_of(about, policies or TRAINED), method)
        tasks = tasks_of(about, methods, split or list(about.splits), scenes, transfer)
        announce_compilation("fem", about.policy_physics)
        with usable_folder(out), going_on(lambda: "the same command goes on where it stopped"):
            rows = run_with_bar(tasks, compete, out / ".benchmark.jsonl", jobs, cluster, "benchmark")
            curves: dict[str, list[Any]] = {}
            for one in methods:
                if one.kind == "policy":
                    curves.setdefault(one.name, []).append(load_policy(one.folder).training["curve"])
            stored = load_references(about.resolution)
            known = {scene: reference.strain for scene, reference in stored.items()}
            written = write_report(
                rows, out, about.resolution, command_line(), curves, known, about.seed, about.bootstrap
            )
        typer.echo("written: " + ", ".join(str(path) for path in written))
