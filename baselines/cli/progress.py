"""How far work is whose length is not known: one line in a terminal, elsewhere one now and then."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from planners.base import Candidate

TOLD_EVERY = 5.0
"""s between two lines, where there is no terminal."""


class Under:
    """Context manager for work under way; its methods may be called from any thread."""

    def __init__(self, work: str, console: Console | None = None) -> None:
        """work: what is being done."""
        self.console = Console() if console is None else console
        self.work, self.increments, self.done = work, 0, ""
        self._lock = threading.Lock()
        self._told = time.monotonic()
        self._line = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
            console=self.console,
            transient=True,
            disable=not self.console.is_terminal,
        )
        self._task = self._line.add_task(work, total=None)

    def __enter__(self) -> Under:
        self._line.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.stop()

    def step(self) -> None:
        """Another increment of a simulation."""
        with self._lock:
            self.increments += 1
            self._tell()

    def judged(self, done: int, of: int) -> None:
        """So many flaps have been judged by finite elements, which is said where there are any."""
        with self._lock:
            self.done = f", {done} of {of} by finite elements" if of else ""
            self._tell()

    def candidates(self, candidates: Sequence[Candidate]) -> None:
        """These have been tried, or are being tried."""
        with self._lock:
            done = sum(candidate.status == "done" for candidate in candidates)
            self.done = f", {done} of {len(candidates)} candidates"
            self.increments = sum(candidate.increments for candidate in candidates)
            self._tell()

    def _tell(self) -> None:
        increments = f", {self.increments} increments" if self.increments else ""
        said = f"{self.work}{self.done}{increments}"
        self._line.update(self._task, description=said)
        if not self.console.is_terminal and time.monotonic() - self._told >= TOLD_EVERY:
            self._told = time.monotonic()
            self.console.print(f"  {said}", soft_wrap=True, markup=False, highlight=False)
