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
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from baselines.jobs.apart import end_with_parent
from retract_env.config import brief
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
Rows = Generator[tuple[str, Row], None, None]
"""Each with its key."""

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
        """Reads what is there but a last line that was cut off. Raises JournalError, OSError."""
        self.path = path
        self.rows: dict[str, Row] = {}
        self._cut: int | None = None
        """bytes of whole lines, where one follows that is not; it goes as a row is added: who only reads may
        read beside one that writes"""
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
            self._cut = len(whole)

    def add(self, key: str, row: Row) -> None:
        """Keep a row; it is on the disk when this returns."""
        self.rows[key] = row
        if self.path is not None:
            if self._cut is not None:
                os.truncate(self.path, self._cut)
                self._cut = None
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
    with closing(runner(missing, work, jobs)) as rows:  # else workers outlive a full disk
        for key, row in rows:
            kept.add(key, row)
            on_row(row)
    return [kept.rows[key_of(task)] for task in tasks]


def _here(tasks: Mapping[str, WorkItem], work: Work, _: int) -> Rows:
    for key, task in tasks.items():
        yield key, work(task)


def _in_processes(tasks: Mapping[str, WorkItem], work: Work, jobs: int) -> Rows:
    """Fresh processes; when one dies, all are replaced. What was under way is then done again, one at a time,
    as any of it may have been what killed."""
    waiting, deaths = dict(tasks), Counter[str]()
    suspects: list[str] = []
    while waiting:
        keys, count = (suspects, 1) if suspects else (list(waiting), min(jobs, len(waiting)))
        with single_threaded(), _pool(count) as pool:
            lost = yield from _until_one_dies(pool, count, keys, waiting, work)
        if len(lost) == 1:
            deaths.update(lost)
            if deaths[lost[0]] >= TRIES:
                raise JournalError(f"{TRIES} workers died over the task {_named(waiting[lost[0]])}")
        suspects = [key for key in suspects if key in waiting and key not in lost] + lost


def _until_one_dies(
    pool: ProcessPoolExecutor, count: int, keys: Sequence[str], waiting: dict[str, WorkItem], work: Work
) -> Generator[tuple[str, Row], None, list[str]]:
    """Rows of these tasks, `count` at a time; what is done is taken out of those that wait. Returns what was
    under way when a worker died, nothing where none did. Raises what `work` raises."""
    queue = iter(keys)
    running: dict[Future[Row], str] = {}
    lost: list[str] = []
    while True:
        try:
            while not lost and len(running) < count and (key := next(queue, None)) is not None:
                running[pool.submit(work, waiting[key])] = key
        except BrokenProcessPool:
            queue = iter(())
        if not running:
            return lost
        done = wait(running, return_when=FIRST_COMPLETED).done
        for future in sorted(done, key=lambda one: one.exception() is not None):  # rows first
            key = running.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):
                lost.append(key)
            else:
                row = future.result()
                del waiting[key]
                yield key, row


def _named(task: WorkItem) -> str:
    """A task as an error names it: which method on which scene, where it says so."""
    method = task.get("method")
    named = {name: task[name] for name in ("split", "number", "seed") if name in task}
    return brief(named | {"method": method["name"]} if isinstance(method, Mapping) else dict(task))


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Workers that end with the block, however it ends: where it fails, what they do is lost."""
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=spawn, initializer=end_with_parent)
    try:
        yield pool
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _on_ray(tasks: Mapping[str, WorkItem], work: Work, _: int) -> Rows:
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
