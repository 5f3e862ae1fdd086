"""Tasks are done once, whatever is killed on the way, and answer in their order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from baselines.jobs.journal import Journal, JournalError, key_of, run_tasks
from tests.baselines.counting import fails, square, tasks

ROOT = Path(__file__).resolve().parents[3]
WANTED = [{"n": n, "square": n**2} for n in range(6)]


def traces(folder: Path) -> list[int]:
    return [int(line) for line in (folder / "trace").read_text().split()]


@pytest.mark.parametrize("jobs", [1, 3])
def test_rows_come_in_the_order_of_the_tasks(tmp_path: Path, jobs: int) -> None:
    seen: list[dict[str, int]] = []
    rows = run_tasks(tasks(tmp_path), square, tmp_path / "journal", jobs, on_row=seen.append)
    assert rows == WANTED
    assert sorted(seen, key=lambda row: int(row["n"])) == WANTED
    assert sorted(traces(tmp_path)) == list(range(6))


def test_what_the_journal_has_is_not_done_again(tmp_path: Path) -> None:
    few = tasks(tmp_path)[:4]
    run_tasks(few, square, tmp_path / "journal")
    assert run_tasks(tasks(tmp_path), square, tmp_path / "journal") == WANTED
    assert traces(tmp_path) == list(range(6))


def test_equal_tasks_are_done_once(tmp_path: Path) -> None:
    twice = tasks(tmp_path, 1) * 2
    assert run_tasks(twice, square, None) == [WANTED[0]] * 2
    assert traces(tmp_path) == [0]


def test_who_only_reads_a_journal_leaves_it(tmp_path: Path) -> None:
    """What ends in the middle of a line may be another's who is writing."""
    path = tmp_path / "journal.jsonl"
    text = b'{"key": "a", "row": {"value": 1}}\n{"key": "b", "row": {"val'
    path.write_bytes(text)
    assert Journal(path).rows == {"a": {"value": 1}}
    assert path.read_bytes() == text


def test_a_key_does_not_depend_on_the_order_of_the_fields() -> None:
    assert key_of({"a": 1, "b": [2]}) == key_of({"b": [2], "a": 1}) != key_of({"a": 1, "b": [3]})


def test_a_key_does_not_depend_on_where_files_lie() -> None:
    assert key_of({"a": 1, "place": "here"}) == key_of({"a": 1, "place": "there"}) == key_of({"a": 1})


def test_a_line_that_was_cut_off_is_done_again(tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    run_tasks(tasks(tmp_path), square, journal)
    whole = journal.read_bytes()
    journal.write_bytes(whole[:-7])
    assert run_tasks(tasks(tmp_path), square, journal) == WANTED
    assert journal.read_bytes() == whole
    assert traces(tmp_path) == [*range(6), 5]


@pytest.mark.parametrize("line", [b"nonsense\n", b"[1]\n", b'{"key": 1}\n', b"\xff\n"])
def test_a_foreign_file_is_refused(tmp_path: Path, line: bytes) -> None:
    journal = tmp_path / "journal"
    journal.write_bytes(line)
    with pytest.raises(JournalError, match=r"journal, line 1: not a line of a journal$"):
        Journal(journal)
    assert journal.read_bytes() == line


def test_a_worker_that_dies_costs_only_what_it_was_doing(tmp_path: Path) -> None:
    bomb = tmp_path / "bomb"
    bomb.touch()
    todo = tasks(tmp_path)
    todo[3] |= {"bomb": str(bomb), "once": True}
    assert run_tasks(todo, square, None, jobs=2) == WANTED
    assert not bomb.exists()


def test_a_task_that_always_kills_its_worker_is_given_up(tmp_path: Path) -> None:
    bomb = tmp_path / "bomb"
    bomb.touch()
    todo = [{**task, "bomb": str(bomb), "once": False} for task in tasks(tmp_path, 1)]
    with pytest.raises(JournalError, match=r"^3 workers died over the task \{"):
        run_tasks(todo, square, None, jobs=2)


def test_who_works_beside_one_that_kills_is_not_blamed(tmp_path: Path) -> None:
    """The innocent are done, their rows kept, and the error says no more than which work it was."""
    bomb = tmp_path / "bomb"
    bomb.touch()
    todo = tasks(tmp_path, 3, seconds=0.5)
    todo[1] |= {"bomb": str(bomb), "once": False, "method": {"name": "ctc"}, "number": 7, "scene": "x" * 9999}
    with pytest.raises(
        JournalError, match=r"^3 workers died over the task \{'method': 'ctc', 'number': 7\}$"
    ):
        run_tasks(todo, square, tmp_path / "journal", jobs=2)
    assert {row["n"] for row in Journal(tmp_path / "journal").rows.values()} >= {0}


def test_where_work_raises_no_worker_stays(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^a work's own$"):
        run_tasks(tasks(tmp_path, 2), fails, None, jobs=2)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "trace").read_text()), 0)


@pytest.mark.parametrize("jobs", [1, 2])
def test_after_a_kill_it_goes_on(tmp_path: Path, jobs: int) -> None:
    """SIGKILL in the middle: rows that were kept are not done again, and no worker stays behind."""
    journal = tmp_path / "journal"
    command = [sys.executable, "-m", "tests.baselines.counting", str(tmp_path), "0.4", str(jobs)]
    process = subprocess.Popen(command, cwd=ROOT, start_new_session=True)
    deadline = time.monotonic() + 60
    while not (journal.exists() and journal.read_bytes().count(b"\n") >= 2):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    kept = {row["n"] for row in Journal(journal).rows.values()}
    before = len(traces(tmp_path))
    assert 2 <= len(kept) < 6
    while members(process.pid):
        assert time.monotonic() < deadline, "workers outlive the run"
        time.sleep(0.05)
    assert run_tasks(tasks(tmp_path, seconds=0.4), square, journal) == WANTED
    assert set(traces(tmp_path)[before:]).isdisjoint(kept)


def members(group: int) -> bool:
    """Whether the process group has any left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
