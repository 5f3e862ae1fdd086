"""Many independent tasks on several workers, their results kept in a journal as they come.

A task is plain JSON data; its key is the hash of that, but for its `place`. The journal is one line of JSON a
task. Whoever runs the same tasks again does only what the journal lacks, so that a run that was killed loses
what was under way and nothing else. Results come back in the order of the tasks, whatever the number of
workers.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from baselines.jobs.apart import end_with_parent
from retract_env.errors import ConfigError
from retract_env.threads import single_threaded

WorkItem = Mapping[str, Any]
"""One piece of work: all that its result depends on, as plain JSON data."""
PLACE = "place"
"""What else a task may say: where on this machine the files lie whose contents it names. No result depends on
that, so that whoever moves them goes on with the same rows."""
Row = dict[str, Any]
Work = Callable[[WorkItem], Row]
OnRow = Callable[[Row], None]

TRIES = 3
"""Workers that may die over one task before it is given up."""


class JournalError(ConfigError):
    """A journal that cannot be gone on with, or a task that kills its workers; the message is one line."""


def key_of(task: WorkItem) -> str:
    """SHA-256, hex, of a task without its place."""
    said = {name: value for name, value in task.items() if name != PLACE}
    return hashlib.sha256(json.dumps(said, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


class Journal:
    """Rows by key in a file that only grows; None keeps them in memory alone."""

    def __init__(self, path: Path | None):
        """Reads what is there; a last line that was cut off is dropped. Raises JournalError, OSError."""
        self.path = path
        self.rows: dict[str, Row] = {}
        if path is None or not path.exists():
            return
        text = path.read_bytes()
        whole = text[: text.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                entry = json.loads(line)
                self.rows[entry["key"]] = entry["row"]
            except (ValueError, TypeError, KeyError, RecursionError):
                raise JournalError(f"{path}, line {number}: not a line of a journal") from None
        if len(whole) < len(text):
            os.truncate(path, len(whole))

    def add(self, key: str, row: Row) -> None:
        """Keep a row; it is on the disk when this returns."""
        self.rows[key] = row
        if self.path is not None:
            with self.path.open("ab") as file:
                file.write(json.dumps({"key": key, "row": row}, allow_nan=False).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())


def run_tasks(
    tasks: Sequence[WorkItem],
    work: Work,
    journal: Path | None,
    jobs: int = 1,
    cluster: bool = False,
    on_row: OnRow = lambda _: None,
) -> list[Row]:
    """Rows of all tasks, in their order.

    work: a function of a module, deterministic, from a task to plain data. jobs: processes; 1 works in this
    one. cluster: on Ray's workers instead. on_row is called with each new row, in the order of completion.
    Raises JournalError, OSError, and whatever `work` raises.
    """
    kept = Journal(journal)
    missing = {key: task for task in tasks if (key := key_of(task)) not in kept.rows}
    runner = _on_ray if cluster else _in_processes if jobs > 1 else _here
    for key, row in runner(missing, work, jobs):
        kept.add(key, row)
        on_row(row)
    return [kept.rows[key_of(task)] for task in tasks]


def _here(tasks: Mapping[str, WorkItem], work: Work, _: int) -> Iterator[tuple[str, Row]]:
    for key, task in tasks.items():
        yield key, work(task)


def _in_processes(tasks: Mapping[str, WorkItem], work: Work, jobs: int) -> Iterator[tuple[str, Row]]:
    """Fresh processes; when one dies, all are replaced and what was under way is done again."""
    waiting, tries = dict(tasks), dict.fromkeys(tasks, 0)
    while waiting:
        with single_threaded(), _pool(min(jobs, len(waiting))) as pool:
            queue = iter(list(waiting.items()))
            running: dict[Future[Row], str] = {}
            try:
                while True:
                    while len(running) < jobs and (item := next(queue, None)) is not None:
                        running[pool.submit(work, item[1])] = item[0]
                    if not running:
                        break
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        row = future.result()
                        key = running.pop(future)
                        del waiting[key]
                        yield key, row
            except BrokenProcessPool:
                for key in running.values():
                    tries[key] += 1
                    if tries[key] >= TRIES:
                        raise JournalError(f"{TRIES} workers died over the task {tasks[key]}") from None


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Workers that end with the block, however it ends."""
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=spawn, initializer=end_with_parent)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _on_ray(tasks: Mapping[str, WorkItem], work: Work, _: int) -> Iterator[tuple[str, Row]]:
    try:
        import ray
    except ImportError:
        raise JournalError("--cluster needs Ray: pip install 'retract[cluster]'") from None
    if not ray.is_initialized():
        ray.init(configure_logging=False, log_to_driver=False)
    remote = ray.remote(max_retries=TRIES)(work)
    running = {remote.remote(task): key for key, task in tasks.items()}
    while running:
        done, _waiting = ray.wait(list(running))
        for reference in done:
            yield running.pop(reference), ray.get(reference)
