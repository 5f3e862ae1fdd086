"""Work in a process of its own: how far it is, what came of it, and that it can be given up."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from baselines.play.aside import Aside, Said, Tell


def count(to: int, tell: Tell) -> int:
    for k in range(to):
        tell(k)
    return to


def fail(message: str, tell: Tell) -> None:
    raise ValueError(message)


def wait(file: str, tell: Tell) -> None:
    tell("waiting")
    time.sleep(60)
    Path(file).write_text("waited")


def end(_: Any, tell: Tell) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def aside() -> Iterator[Aside]:
    worker = Aside()
    yield worker
    worker.close()


def heard(worker: Aside, kinds: tuple[str, ...] = ("done", "failed"), limit: float = 100.0) -> list[Said]:
    said: list[Said] = []
    begun = time.monotonic()
    while not said or said[-1].kind not in kinds:
        assert time.monotonic() - begun < limit
        said += worker.poll()
        time.sleep(0.01)
    return said


def test_it_tells_how_far_it_is_and_what_came_of_it(aside: Aside) -> None:
    assert aside.poll() == []
    aside.ask(count, 3)
    assert heard(aside) == [Said("progress", k) for k in range(3)] + [Said("done", 3)]
    assert not aside.busy and aside.poll() == []
    aside.ask(fail, "what is wrong")
    (said,) = heard(aside)
    assert said.kind == "failed" and said.value.startswith("ValueError: what is wrong")
    aside.ask(count, 0)
    assert heard(aside) == [Said("done", 0)]


def test_work_that_is_given_up_is_never_heard_of(aside: Aside, tmp_path: Path) -> None:
    aside.ask(wait, str(tmp_path / "file"))
    heard(aside, ("progress",))
    aside.ask(count, 1)
    assert heard(aside) == [Said("progress", 0), Said("done", 1)]
    aside.close()
    assert aside.poll() == [] and not (tmp_path / "file").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="the process ends itself by SIGKILL")
def test_a_process_that_died_is_told_and_replaced(aside: Aside) -> None:
    aside.ask(end, None)
    assert heard(aside) == [Said("failed", "the process that computed it has died")]
    aside.ask(count, 0)
    assert heard(aside) == [Said("done", 0)]
