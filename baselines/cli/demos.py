"""`retract demos`: plans played through the environment, as a data set to learn from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from baselines.cli.console import BadInput, announce_compilation, exit_codes, usable_folder
from baselines.cli.work import (
    RUNS,
    ClusterOption,
    JobsOption,
    PhysicsOption,
    check_physics,
    command_line,
    expected,
    going_on,
    run_with_bar,
)


def demos_command(
    dataset: Annotated[str, typer.Option(help="Name of the Minari data set to make.")] = "",
    planner: Annotated[str, typer.Option(help="Whose plans are demonstrated.")] = "ctc",
    count: Annotated[int, typer.Option(min=1, help="Scenes, from number --first on.")] = 300,
    first: Annotated[int, typer.Option(min=0, help="Number of the first scene.")] = 0,
    resolution: Annotated[
        Literal["fine", "medium", "coarse"], typer.Option(help="Mesh of the certificates.")
    ] = "coarse",
    physics: PhysicsOption = "fem",
    journal: Annotated[
        Path | None, typer.Option(help="File that keeps what is done; RUNS/demos-PLANNER.jsonl if not given.")
    ] = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
) -> None:
    """Play certified plans through the environment and keep them as a Minari data set."""
    with exit_codes(), expected():
        from baselines.jobs.version import code_version
        from baselines.learning import demos
        from planners import PLANNERS

        if planner not in PLANNERS:
            raise BadInput(f"unknown planner {planner!r}, allowed {', '.join(PLANNERS)}")
        name = dataset or f"tissue-retract/{planner}-v0"
        check_physics(physics)
        demos.check_free(name)
        kept = journal or RUNS / f"demos-{planner}.jsonl"
        tasks = [
            {
                "planner": planner,
                "resolution": resolution,
                "physics": physics,
                "seed": first + k,
                "code": code_version(),
            }
            for k in range(count)
        ]
        with usable_folder(kept.parent), going_on(lambda: "the same command goes on where it stopped"):
            announce_compilation("fem", "planning", physics)
            rows = run_with_bar(tasks, demos.demonstrate, kept, jobs, cluster, name)
        typer.echo(demos.summary(rows))
        written = demos.write_dataset(name, rows, tasks[0], command_line())
        typer.echo(f"written: {written} episodes into {name}")
