"""Work in a process of its own, and in one word what became of it."""

from __future__ import annotations

import atexit
import math
import warnings
from collections.abc import Callable
from typing import Any

from baselines.jobs.apart import Apart, in_one_line
from baselines.jobs.journal import Row, WorkItem

_BESIDE = Apart(silent=True)
atexit.register(_BESIDE.close)


def apart(work: Callable[[Any], Row], task: WorkItem, limit: float) -> Row:
    """What the work says of the task, within a limit, s; else that it took longer, raised or died.

    Every row has `outcome`; those that must not be have one of WRONG.
    """
    answer = _BESIDE.call(_strictly, (work, dict(task)), limit)
    if answer.trouble:
        return {"outcome": answer.trouble, "detail": answer.detail}
    row: Row = answer.value
    return row


WRONG = ("time", "raised", "died", "unsound")
"""It took too long, raised what it may not raise or warned, killed its process, or is no number."""


def _strictly(asked: tuple[Callable[[Any], Row], dict[str, Any]]) -> Row:
    """With warnings as errors."""
    work, task = asked
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return work(task)


def refused(problem: ValueError) -> Row:
    """The row of a clear refusal, which is one line and not endless."""
    text = str(problem)
    if not text or "\n" in text or len(text) > 1000:
        return {"outcome": "unsound", "detail": f"a refusal that is not one line: {in_one_line(problem)}"}
    return {"outcome": "refused", "detail": text}


def sound(*numbers: float) -> bool:
    """Whether all are numbers."""
    return all(math.isfinite(number) for number in numbers)
