"""Work in a process of its own: whatever it does, whoever asked for it goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baselines.jobs import apart as module
from baselines.jobs.apart import Apart, ApartError, in_one_line


def square(n: int) -> int:
    return n * n


def process(_: None) -> int:
    return os.getpid()


def fail(text: str) -> None:
    raise ValueError(text)


def leave(code: int) -> None:
    os._exit(code)


def exit_politely(_: None) -> None:
    sys.exit("had enough")


def kill(number: int) -> None:
    os.kill(os.getpid(), number)


def sleep(_: None) -> None:
    time.sleep(1000)


def not_plain(_: None) -> object:
    return {1, 2}


def infinite(_: None) -> float:
    return float("inf")


def chatter(file: str) -> None:
    """Say something on the console, and begin a process that sleeps; its number goes into the file."""
    os.write(1, b"noise")
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    Path(file).write_text(str(other.pid))
    time.sleep(1000)


def fork_and_leave(file: str) -> None:
    """Leave a process behind that holds all the pipes; its number goes into the file."""
    if (child := os.fork()) == 0:
        time.sleep(1000)
    Path(file).write_text(str(child))
    os._exit(3)


def goes_on(file: Path) -> bool:
    """Whether the process whose number is in the file outlives its parent by five seconds."""
    status = Path(f"/proc/{file.read_text()}/stat")
    for _ in range(100):  # whoever inherits it may take a moment to bury it
        if not status.exists() or status.read_text().split()[2] == "Z":
            return False
        time.sleep(0.05)
    return True


def test_what_it_does_is_done_one_after_the_other_in_another_process() -> None:
    with Apart() as apart:
        assert apart.call(square, 3, 60).value == 9
        there = apart.call(process, None, 60).value
        assert there == apart.call(process, None, 60).value != os.getpid()


def test_whatever_happens_there_is_told_and_the_next_is_done() -> None:
    signals = [(kill, signal.SIGSEGV, "died", "signal 11, SIGSEGV")] if os.name == "posix" else []
    cases: list[tuple[Callable[[Any], Any], Any, str, str]] = [
        (fail, "so\nmuch", "raised", "ValueError: so much (test_apart.py, line "),
        (exit_politely, None, "raised", "SystemExit: had enough ("),
        (not_plain, None, "raised", "TypeError: "),
        (infinite, None, "raised", "ValueError: "),
        (leave, 7, "died", "exit code 7"),
        (leave, 0, "died", "exit code 0"),
        *signals,
    ]
    with Apart(silent=True) as apart:
        for function, argument, trouble, detail in cases:
            answer = apart.call(function, argument, 60)
            assert (answer.trouble, answer.value) == (trouble, None)
            assert answer.detail.startswith(detail) and "\n" not in answer.detail
            assert apart.call(square, 3, 60).value == 9


@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX's")
def test_who_hangs_is_ended_with_all_that_it_began(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "pid"
    with Apart(silent=True, may_fork=True) as apart:
        answer = apart.call(chatter, str(file), 3)
        assert (answer.trouble, answer.detail) == ("time", "nothing within 3 s")
        assert apart.call(square, 2, 60).value == 4
    assert capfd.readouterr().out == ""
    assert not goes_on(file)


@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX's")
def test_who_dies_is_missed_at_once_and_ended_with_all_that_it_began(tmp_path: Path) -> None:
    """Though what it began keeps its pipes open."""
    file = tmp_path / "pid"
    with Apart(silent=True, may_fork=True) as apart:
        answer = apart.call(fork_and_leave, str(file), 60)
        assert (answer.trouble, answer.detail) == ("died", "exit code 3")
        assert not goes_on(file)


def test_one_that_died_with_nothing_to_do_is_replaced() -> None:
    with Apart() as apart:
        os.kill(apart.call(process, None, 60).value, signal.SIGTERM)
        apart._process.join(10)
        assert apart.call(square, 3, 60).value == 9


def test_a_process_that_cannot_be_begun_is_nobodys_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as short, Apart() as apart:
        short.setattr(module, "STARTING", 1e-3)
        with pytest.raises(ApartError, match=r"^a process could not be begun: time, nothing within 0.001 s$"):
            apart.call(square, 3, 60)
    with Apart() as apart:
        monkeypatch.setattr("multiprocessing.context.SpawnProcess.start", fail)
        with pytest.raises(ValueError, match="SpawnProcess"):  # what was wrong with it, and not with its end
            apart.call(square, 3, 60)


def test_a_long_word_is_cut() -> None:
    assert len(in_one_line(ValueError("x" * 5000))) < 400
