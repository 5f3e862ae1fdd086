"""`retract evaluate`: what a trained policy does on frozen scenes, certified."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from baselines.cli.console import announce_compilation, exit_codes
from baselines.cli.work import BenchmarkOption, JobsOption, expected, frozen_scenes, run_with_bar


def evaluate_command(
    policy: Annotated[Path, typer.Option(help="Folder of a trained policy, or the name of a shipped one.")],
    split: Annotated[str, typer.Option(help="Which of the frozen scenes.")] = "validation",
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many.")] = None,
    transfer: Annotated[bool, typer.Option("--transfer", help="Play it on Bullet too.")] = False,
    jobs: JobsOption = None,
    benchmark: BenchmarkOption = None,
) -> None:
    """Certify what a trained policy does on frozen scenes."""
    with exit_codes(), expected():
        from baselines.benchmark.methods import Method, compete
        from baselines.benchmark.report import in_text
        from baselines.benchmark.scores import summaries
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import tasks_of

        about = load_benchmark(frozen_scenes(benchmark))
        tasks = tasks_of(about, [Method.trained(policy)], [split], scenes, transfer)
        announce_compilation()
        rows = run_with_bar(tasks, compete, None, jobs, None, split)
        for row in rows:
            strain = "" if row["max_strain"] is None else f", strain {row['max_strain']:.3f}"
            typer.echo(f"{split} {row['number']}: {row['reason']}{strain}")
        typer.echo(in_text(summaries(rows, about.seed, about.bootstrap)))
