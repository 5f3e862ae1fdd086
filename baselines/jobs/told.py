"""Long work and how far it is: a bar in a terminal, elsewhere a line at least every half minute."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from baselines.jobs.journal import Journal, Row, Work, WorkItem, key_of, run_tasks
from retract_env.errors import ConfigError

TOLD_EVERY = 30.0
"""s, at most, between lines where there is no terminal to draw a bar in."""


class Told:
    """Context manager: counts what is done of a whole, and tells of it.

    In no terminal a thread of its own tells, so that a long piece of work does not look like a standstill.
    """

    def __init__(self, title: str, total: int, console: Console, unit: str = ""):
        """unit: what is counted, told with its rate."""
        self.title, self.total, self.console, self.unit = title, total, console, unit
        self.before = self.done = 0
        self.note = ""
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        speed = [TextColumn("{task.fields[speed]}")] if unit else []
        self.bar = Progress(*columns, *speed, console=console, disable=not console.is_terminal)
        self._begun = time.monotonic()
        self._told = self._begun
        self._over = threading.Event()
        self._teller = threading.Thread(target=self._tell_now_and_then, daemon=True)

    def __enter__(self) -> Told:
        self.bar.start()
        self._line = self.bar.add_task(self.title, total=self.total, speed="")
        if not self.console.is_terminal:
            self._teller.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._teller.is_alive():
            self._teller.join()
        self.bar.stop()

    def begin(self, before: int) -> None:
        """The work begins, of which an earlier run has done so much."""
        self.before, self._begun = before, time.monotonic()
        if before:
            self.say(f"{before} of {self.total} {self.unit}".rstrip() + " were done before")
        self.update(before)

    def update(self, done: int, note: str | None = None) -> None:
        """So much is done, those before included; note: what else there is to say, until another note."""
        self.done = done
        if note is not None:
            self.note = note
        description = f"{self.title}: {self.note}" if self.note else self.title
        self.bar.update(self._line, completed=done, description=description, speed=self._speed())

    def another(self, _: Row) -> None:
        """One more task is done."""
        self.update(self.done + 1)
        if not self.console.is_terminal and (
            self.done == self.total or time.monotonic() - self._told > TOLD_EVERY
        ):
            self.say(self.how_far())

    def how_far(self) -> str:
        """What is done, how fast, how long the rest will take, and the newest note."""
        spent, fresh = time.monotonic() - self._begun, self.done - self.before
        parts = [f"{self.done} of {self.total} {self.unit}".rstrip()]
        if fresh <= 0:
            parts.append(f"after {spent:.0f} s")
        else:
            if self.unit:
                parts.append(self._speed())
            parts.append(f"{(self.total - self.done) * spent / fresh:.0f} s left")
        return ", ".join([*parts, self.note] if self.note else parts)

    def _speed(self) -> str:
        """How much is done a second; nothing while that is not known."""
        spent, fresh = time.monotonic() - self._begun, self.done - self.before
        if fresh <= 0 or spent <= 0:
            return ""
        rate = fresh / spent
        return f"{rate:.0f} {self.unit}/s" if rate >= 100 else f"{rate:.3g} {self.unit}/s"

    def say(self, text: str) -> None:
        """A line under the title."""
        self._told = time.monotonic()
        self.console.print(f"{self.title}: {text}", highlight=False, soft_wrap=True)

    def _tell_now_and_then(self) -> None:
        while not self._over.wait(max(0.0, self._told + TOLD_EVERY - time.monotonic())):
            if time.monotonic() - self._told >= TOLD_EVERY:  # nobody else told in the meantime
                self.say(self.how_far())


def run_told(
    tasks: Sequence[WorkItem],
    work: Work,
    journal: Path | None,
    workers: int,
    cluster: bool,
    title: str,
    console: Console,
) -> list[Row]:
    """`run_tasks`, with the progress told on the console."""
    keys = {key_of(task) for task in tasks}
    before = len(keys & set(Journal(journal).rows))
    with Told(title, len(keys), console) as told:
        told.begin(before)
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
