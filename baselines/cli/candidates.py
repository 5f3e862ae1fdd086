"""The table of candidates while a plan is made: live in a terminal; elsewhere lines and a last table."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from baselines.cli.words import SHORT
from planners.base import DISMISSED

if TYPE_CHECKING:
    from planners.base import Candidate
    from retract_env.grasp import Grasp

MM = MN = 1e3
PLAIN_WIDTH = 100
"""columns of the table where no terminal sets them"""

_COLUMNS = (
    "#",
    "grasp\nmm",
    "compression\nmm",
    "score\nJ/m2",
    "strain",
    "friction",
    "clearance\nmm",
    "status",
    "s",
)


def outcome(candidate: Candidate) -> str:
    """What is being done with a candidate, or why it was dropped, in words."""
    if candidate.status != "done" or candidate.reason is None:
        return candidate.status
    return SHORT.get(candidate.reason, candidate.reason)


class CandidateTable:
    """Context manager; `update` may be called from any thread."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = Console() if console is None else console
        self._candidates: tuple[Candidate, ...] = ()
        self._chosen: Grasp | None = None
        self._told: set[int] = set()
        self._lock = threading.Lock()
        self._live: Live | None = None
        if self.console.is_terminal:
            self._live = Live(console=self.console, get_renderable=self.render, refresh_per_second=8)
        else:
            self.console.width = PLAIN_WIDTH

    def __enter__(self) -> CandidateTable:
        if self._live is not None:
            self._live.start(refresh=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        elif (
            kind is None or issubclass(kind, Exception)
        ) and self._candidates:  # not where a user breaks off
            self.console.print(self.render())

    def update(self, candidates: Sequence[Candidate]) -> None:
        """Show this state of the candidates."""
        with self._lock:
            self._candidates = tuple(sorted(candidates, key=lambda c: c.index))
            if self._live is None:
                for candidate in self._candidates:
                    if candidate.status == "done" and candidate.index not in self._told:
                        self._told.add(candidate.index)
                        self.console.print(
                            self._line(candidate), soft_wrap=True, markup=False, highlight=False
                        )

    def choose(self, grasp: Grasp) -> None:
        """Mark the candidate with this grasp as the one chosen."""
        self._chosen = grasp

    def render(self) -> Table:
        """The table as it stands. Candidates come in the order of their score, lengths in mm."""
        table = Table(box=None, pad_edge=False, padding=(0, 2), collapse_padding=True, header_style="bold")
        for column in _COLUMNS:
            table.add_column(column, justify="left" if column == "status" else "right", no_wrap=True)
        for candidate in self._candidates:
            table.add_row(*self._cells(candidate), style=self._style(candidate))
        return table

    def _cells(self, c: Candidate) -> tuple[str | Text, ...]:
        about = "~" if c.reason == DISMISSED else ""  # the rod's numbers
        return (
            str(c.index + 1),
            f"{c.grasp.x * MM:.2f}",
            f"{c.grasp.compression * MM:.2f}" if c.grasp.force is None else f"{c.grasp.force * MN:.1f} mN",
            _number(c.grasp.score, ".3g"),
            about + _number(c.max_strain, ".3f"),
            about + _number(c.required_friction, ".2f"),
            about + _number(c.clearance * MM, ".2f"),
            "chosen" if self._is_chosen(c) else outcome(c),
            f"{c.seconds:.1f}" if c.seconds else "",
        )

    def _style(self, c: Candidate) -> str:
        if self._is_chosen(c):
            return "bold green"
        if c.status == "done":
            return "green" if c.reason == "ok" else "dim"
        return "" if c.status in ("squeezing", "moving") else "bright_black"

    def _is_chosen(self, c: Candidate) -> bool:
        # By value, of which the score is no part.
        grasp = self._chosen
        return grasp is not None and c.grasp == grasp and c.reason == "ok"

    def _line(self, c: Candidate) -> str:
        measured = [
            f"{name} {'~' if c.reason == DISMISSED else ''}{_number(value, form)}"
            for name, value, form in (
                ("strain", c.max_strain, ".3f"),
                ("friction", c.required_friction, ".2f"),
            )
            if not math.isnan(value)
        ]
        facts = ", ".join([f"grasp {c.grasp.x * MM:.2f} mm", outcome(c), *measured, f"{c.seconds:.1f} s"])
        return f"{len(self._told)}/{len(self._candidates)}  {facts}"


def _number(value: float, form: str) -> str:
    return "" if math.isnan(value) else format(value, form)
