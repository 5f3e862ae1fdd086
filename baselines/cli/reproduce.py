"""`retract reproduce`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from baselines.cli.console import RESULTS, BadInput, announce_compilation, exit_codes, usable_folder
from baselines.cli.verdict import ResolutionOption
from baselines.cli.work import expected
from baselines.paper.studies import STUDIES


def reproduce_command(
    name: Annotated[str, typer.Argument(help=f"{', '.join(STUDIES)}, or all.")],
    out: Annotated[Path, typer.Option(help="Folder for tables, pictures and texts.")] = RESULTS,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; as many as cores if not given.")
    ] = None,
    resolution: ResolutionOption = "fine",
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that does the work, or `auto`.")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Do again what an earlier run has done.")] = False,
) -> None:
    """Repeat a figure of the paper, or a study of our own. An interrupted run goes on where it stopped."""
    with exit_codes(), ExitStack() as stack:
        if cluster is not None and workers is not None:
            raise BadInput("--workers and --cluster: allowed one of them, the cluster has its own workers")
        from baselines.paper import reproduce

        with expected():
            asked = reproduce.names(name)
            folder = stack.enter_context(usable_folder(out))
            announce_compilation("fem", "planning")
            written = reproduce.reproduce(asked, folder, resolution, workers, cluster, fresh)
        typer.echo("written: " + ", ".join(str(path) for path in written))
