"""What is told of long work where there is no terminal."""

from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from baselines.jobs import told
from baselines.jobs.told import Told


@pytest.fixture
def text() -> io.StringIO:
    return io.StringIO()


def test_lines_come_even_while_nothing_gets_done(text: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(told, "TOLD_EVERY", 0.05)
    with Told("bench", 4, Console(file=text)) as work:
        work.begin(1)
        deadline = time.monotonic() + 10
        while text.getvalue().count("\n") < 3:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        work.update(3, "half a good one")
        while "half a good one" not in text.getvalue():
            assert time.monotonic() < deadline
            time.sleep(0.01)
    lines = text.getvalue().splitlines()
    assert lines[0] == "bench: 1 of 4 were done before"
    assert lines[1].startswith("bench: 1 of 4, after ")
    assert lines[-1].startswith("bench: 3 of 4, ") and lines[-1].endswith(" s left, half a good one")
    count = text.getvalue().count("\n")
    time.sleep(0.2)
    assert text.getvalue().count("\n") == count, "it tells on after the end"


def test_what_has_a_unit_is_told_with_its_rate(text: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    with Told("ppo", 300, Console(file=text), unit="steps") as work:
        work.begin(100)
        monkeypatch.setattr(work, "_begun", time.monotonic() - 10)
        work.update(200)
        words = work.how_far().split(", ")
    assert words[0] == "200 of 300 steps"
    assert words[1].endswith(" steps/s") and float(words[1].split()[0]) == pytest.approx(10, rel=0.05)
    assert words[2].endswith(" s left") and float(words[2].split()[0]) == pytest.approx(10, abs=1)


def test_the_last_task_is_told_at_once(text: io.StringIO) -> None:
    with Told("bench", 2, Console(file=text)) as work:
        work.another({})
        assert text.getvalue() == ""
        work.another({})
        assert text.getvalue().startswith("bench: 2 of 2, ")
