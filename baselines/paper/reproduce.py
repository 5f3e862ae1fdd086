"""`retract reproduce`: do the work of a study, with a bar and the time left, and write what was found."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from baselines.jobs.journal import Journal, Row, Work, key_of, run_tasks
from baselines.paper.experiments import Experiment, evaluate
from baselines.paper.studies import STUDIES, study
from baselines.paper.study import write
from planners.search import cores
from retract_env.errors import ConfigError

TOLD_EVERY = 30.0
"""s, between lines where there is no terminal to draw a bar in."""


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


def run_told(
    tasks: Sequence[Mapping[str, Any]],
    work: Work,
    journal: Path | None,
    workers: int,
    cluster: bool,
    title: str,
    console: Console,
) -> list[Row]:
    """`run_tasks`, with the progress told on the console."""
    keys = {key_of(task) for task in tasks}
    with Told(title, len(keys), len(keys & set(Journal(journal).rows)), console) as told:
        return run_tasks(tasks, work, journal, workers, cluster, told.another)


@contextmanager
def connected(address: str) -> Iterator[None]:
    """A Ray cluster to work on. Raises ConfigError without Ray, ConnectionError without the cluster."""
    try:
        import ray
    except ImportError:
        raise ConfigError("--cluster needs Ray: pip install 'retract[cluster]'") from None
    ray.init(address=address, logging_level=logging.WARNING, log_to_driver=False)
    try:
        yield
    finally:
        ray.shutdown()


class Told:
    """Context manager: a bar in a terminal, else a line now and then."""

    def __init__(self, title: str, total: int, before: int, console: Console):
        """total: tasks; before: those done in an earlier run."""
        self.title, self.total, self.before, self.done, self.console = title, total, before, before, console
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self.bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self._begun = self._told = time.monotonic()

    def __enter__(self) -> Told:
        if self.before:
            self._say(f"{self.before} of {self.total} were done before")
        self.bar.start()
        self._task = self.bar.add_task(self.title, total=self.total, completed=self.before)
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def another(self, _: Row) -> None:
        """One more task is done."""
        self.done += 1
        self.bar.update(self._task, completed=self.done)
        now = time.monotonic()
        if not self.console.is_terminal and (now - self._told > TOLD_EVERY or self.done == self.total):
            self._told = now
            left = (self.total - self.done) * (now - self._begun) / (self.done - self.before)
            self._say(f"{self.done} of {self.total}, {left:.0f} s left")

    def _say(self, text: str) -> None:
        self.console.print(f"{self.title}: {text}", highlight=False, soft_wrap=True)
