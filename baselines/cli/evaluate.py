"""`retract evaluate`: what a trained policy does on frozen scenes, certified."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from baselines.cli.console import announce_compilation, exit_codes
from baselines.cli.work import (
    BenchmarkOption,
    JobsOption,
    check_physics,
    expected,
    frozen_scenes,
    run_with_bar,
)

if TYPE_CHECKING:
    from baselines.benchmark.references import Reference


def evaluate_command(
    policy: Annotated[Path, typer.Option(help="Folder of a trained policy, or the name of a shipped one.")],
    split: Annotated[str, typer.Option(help="Which of the frozen scenes.")] = "validation",
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many.")] = None,
    transfer: Annotated[bool, typer.Option("--transfer", help="Play it on Bullet too.")] = False,
    physics: Annotated[
        str | None,
        typer.Option(
            help="In which it plays, of the benchmark's if not given: fem, rod, or one that was added."
        ),
    ] = None,
    jobs: JobsOption = None,
    benchmark: BenchmarkOption = None,
) -> None:
    """Certify what a trained policy does on frozen scenes, beside the best retractions known there."""
    with exit_codes(), expected():
        from baselines.benchmark.contest import compete
        from baselines.benchmark.methods import Method
        from baselines.benchmark.ranking import in_text
        from baselines.benchmark.references import load_references
        from baselines.benchmark.scores import summaries
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import tasks_of

        import_module("rliable.metrics")  # what scores need, before the work and not after
        about = load_benchmark(frozen_scenes(benchmark))
        if physics is not None:
            about = about.played_in(physics)
        check_physics(about.policy_physics, about.policy_resolution)
        tasks = tasks_of(about, [Method.trained(policy)], [split], scenes, transfer, survival=False)
        announce_compilation("fem", about.policy_physics)
        rows = run_with_bar(tasks, compete, None, jobs, None, split)
        known = load_references(about.resolution)
        for row in rows:
            typer.echo(f"{split} {row['number']}: {_outcome(row, known.get(row['scene_hash']))}")
        missing = sum(row["scene_hash"] not in known for row in rows)
        best = None if missing else {scene: reference.strain for scene, reference in known.items()}
        typer.echo(in_text(summaries(rows, best, about.seed, about.bootstrap)))
        if missing:
            typer.echo(f"no score and no excess: {missing} of {len(rows)} scenes have no reference")


def _outcome(row: Mapping[str, Any], reference: Reference | None) -> str:
    """The verdict, and the strain beside the least one known."""
    text = str(row["reason"])
    if row["max_strain"] is not None:
        text += f", strain {row['max_strain']:.3f}"
    if reference is not None:
        text += f", best known {reference.strain:.3f} by {reference.method}"
    return text
