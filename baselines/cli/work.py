"""What the commands that do long work share: options, errors as one line, a bar, how to go on."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from baselines.cli.console import BadInput, Interrupted, writing

RUNS = Path("runs")
"""Where training runs and what is demonstrated are kept unless told otherwise."""
EXTRA = ("minari", "rliable", "sb3_contrib", "stable_baselines3", "tensorboard", "torch")
"""Packages of the extra `rl`."""

JobsOption = Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores if not given.")]
ClusterOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that does the work, or `auto`.")
]
BenchmarkOption = Annotated[
    Path | None, typer.Option("--benchmark", help="The frozen scenes; those that are shipped if not given.")
]
PhysicsOption = Annotated[
    str, typer.Option(help="Of the environment that is played in: fem, rod, bullet, or one that was added.")
]


def check_physics(name: str, resolution: str | None = None) -> None:
    """Raise BadInput for an unknown physics or resolution, ImportError for one that is not installed."""
    from retract_env.physics.registry import physics_kind

    try:
        kind = physics_kind(name)
        kind.check(resolution or kind.resolution)
    except ValueError as problem:
        raise BadInput(str(problem)) from None


def frozen_scenes(given: Path | None) -> Path:
    """The benchmark's file: the one given, or else the shipped one."""
    from retract_env.config import CONFIGS

    return CONFIGS / "benchmark.yaml" if given is None else given


def run_with_bar(
    tasks: list[dict[str, Any]],
    work: Any,
    journal: Path | None,
    jobs: int | None,
    cluster: str | None,
    title: str,
) -> list[dict[str, Any]]:
    """Rows of all tasks, with a bar. Raises BadInput where both processes and a cluster are asked for."""
    from rich.console import Console

    from baselines.jobs.told import connected, run_told
    from retract_env.threads import cores

    if jobs is not None and cluster is not None:
        raise BadInput("--jobs and --cluster: allowed one of them, the cluster has its own workers")
    with nullcontext() if cluster is None else connected(cluster):
        return run_told(tasks, work, journal, jobs or cores(), cluster is not None, title, Console())


def command_line() -> str:
    """The command as it was given, for the files that it writes."""
    return shlex.join(["retract", *sys.argv[1:]])


@contextmanager
def going_on(how: Callable[[], str]) -> Iterator[None]:
    """Whoever interrupts the block is told how to go on; how: a sentence, "" where nothing was begun."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(how()) from None


@contextmanager
def expected() -> Iterator[None]:
    """What may be wrong with what the user gave, or is not installed, as BadInput."""
    from retract_env.errors import ConfigError

    try:
        with writing(Path()):
            yield
    except ModuleNotFoundError as missing:
        if (missing.name or "").split(".")[0] not in EXTRA:
            raise
        raise BadInput(f"this needs {missing.name}: pip install 'retract[rl]'") from None
    except (ConfigError, ImportError, ConnectionError) as problem:
        raise BadInput(str(problem)) from None
