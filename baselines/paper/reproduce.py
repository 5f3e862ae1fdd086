"""`retract reproduce`: do the work of a study, with a bar and the time left, and write what was found."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from difflib import get_close_matches
from pathlib import Path

from rich.console import Console

from baselines.jobs.journal import Row
from baselines.jobs.told import connected, run_told
from baselines.paper.experiments import Experiment, evaluate
from baselines.paper.studies import STUDIES, study
from baselines.paper.study import write
from retract_env.errors import ConfigError
from retract_env.threads import cores


def names(asked: str) -> list[str]:
    """The studies of a name, "all" for all. Raises ConfigError for an unknown one."""
    known = [*STUDIES, "all"]
    if asked not in known:
        close = get_close_matches(asked, known, 1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"unknown study {asked!r}, allowed {', '.join(known)}{hint}")
    return list(STUDIES) if asked == "all" else [asked]


def reproduce(
    asked: Sequence[str],
    out: Path,
    resolution: str = "fine",
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    console: Console | None = None,
) -> list[Path]:
    """Do these studies, names in STUDIES, and write each one's files into `out`; returns their paths.

    workers: processes, one a core by default; cluster: address of a Ray cluster that works instead. What an
    earlier run has kept in `out`/.NAME.jsonl is not done again unless `fresh`. Raises OSError, ConfigError
    for what stands in the way of the work, and ConnectionError where the cluster does not answer.
    """
    console = console or Console()
    workers = cores() if workers is None else workers
    written = []
    with nullcontext() if cluster is None else connected(cluster):
        for name in asked:
            asked_for, journal = study(name), out / f".{name}.jsonl"
            if fresh:
                journal.unlink(missing_ok=True)
            title, far = f"{name}: {asked_for.about}", cluster is not None
            rows = done(asked_for.experiments(), resolution, journal, workers, far, title, console)
            written += write(asked_for, rows, out, resolution)
    return written


def done(
    experiments: Sequence[Experiment],
    resolution: str,
    journal: Path,
    workers: int,
    cluster: bool,
    title: str,
    console: Console,
) -> list[Row]:
    """Rows of all experiments, label and result, in their order, with the progress told on the console."""
    works = [experiment.work(resolution) for experiment in experiments]
    rows = run_told(works, evaluate, journal, workers, cluster, title, console)
    return [{**experiment.label, **row} for experiment, row in zip(experiments, rows, strict=True)]
