"""Rows of the study `robustness` without the console: python -m baselines.paper.robustness_rows --help.

For a machine that has no more than what planners and finite elements need. Work begins in the order of the
study, each row joins the journal as it is done, and what is under way when time is up is lost. The journal is
that of `retract reproduce robustness` into the same folder, which goes on from there with the same code.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from baselines.benchmark.methods import NEEDS
from baselines.jobs.journal import Journal, Row, key_of
from baselines.jobs.version import code_version
from baselines.paper.experiments import Experiment, evaluate
from baselines.paper.studies.robustness import (
    DRAWS,
    FLAP_DRAWS,
    FLAPS,
    STANDARD,
    STUDY,
    robustness_experiments,
)
from baselines.paper.study import write
from retract_env.mesh import RESOLUTIONS
from retract_env.threads import cores, single_threaded


def _on_one_core(free: Any) -> None:
    """Have a worker use one core of its own, and the others not."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {free.get()})


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def timed(work: Mapping[str, Any]) -> tuple[Row, float]:
    """A row, and the seconds that it took."""
    start = time.monotonic()
    return evaluate(work), time.monotonic() - start


def side_by_side(
    works: Sequence[Mapping[str, Any]], workers: int, seconds: float
) -> Iterator[tuple[int, Row, float]]:
    """Number, row and seconds of each, as they are done, until time is up; the processes then end."""
    end = time.monotonic() + seconds
    spawn = multiprocessing.get_context("spawn")
    free = spawn.Queue()
    mine = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(cores())
    for k in range(workers):
        free.put(mine[k % len(mine)])
    with single_threaded():
        pool = ProcessPoolExecutor(workers, mp_context=spawn, initializer=_on_one_core, initargs=(free,))
        waiting = iter(enumerate(works))
        running: dict[Future[tuple[Row, float]], int] = {}
        processes: list[Any] = []
        try:
            while True:
                while len(running) < workers and (item := next(waiting, None)) is not None:
                    running[pool.submit(timed, item[1])] = item[0]
                processes = list((pool._processes or {}).values())
                left = end - time.monotonic()
                if not running or left <= 0:
                    return
                for future in wait(running, left, FIRST_COMPLETED).done:
                    yield running.pop(future), *future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.kill()


def chosen(every: Sequence[Experiment], options: argparse.Namespace) -> list[Experiment]:
    """The study's experiments that were asked for, and for which all is installed."""
    missing = {method for method, module in NEEDS.items() if find_spec(module) is None}
    return [
        one
        for one in every
        if one.label["method"] not in missing
        and (not options.methods or one.label["method"] in options.methods)
        and (not options.scenes or one.label["scene"] in options.scenes)
    ]


def written(every: Sequence[Experiment], options: argparse.Namespace, journal: Path) -> list[Path]:
    """Table, picture and page of the rows that are known."""
    known = Journal(journal).rows
    keys = [key_of(one.work(options.resolution)) for one in every]
    rows = [{**one.label, **known[key]} for one, key in zip(every, keys, strict=True) if key in known]
    return write(STUDY, rows, options.out, options.resolution, len(every)) if rows else []


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what is missing of the study's rows, for so long."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="where .robustness.jsonl lies")
    parser.add_argument("--workers", type=int, default=cores(), help="processes, a core each")
    parser.add_argument("--seconds", type=float, default=1e9, help="of wall-clock, at most")
    parser.add_argument(
        "--resolution", choices=list(RESOLUTIONS), default="fine", help="that plans are certified at"
    )
    parser.add_argument("--draws", type=int, default=DRAWS, help="for each plan, on standard scenes")
    parser.add_argument("--flap-draws", type=int, default=FLAP_DRAWS, help="likewise, on test flaps")
    parser.add_argument("--scenes", nargs="*", help='homogeneous, ..., "test 0", ...; default: all')
    parser.add_argument("--methods", nargs="*", help="default: all")
    parser.add_argument("--report", action="store_true", help="write the page of what is known as well")
    options = parser.parse_args(arguments)
    for name, least in (("workers", 1), ("seconds", 0), ("draws", 1), ("flap_draws", 1)):
        if not (value := getattr(options, name)) >= least:  # nan too
            parser.error(f"--{name.replace('_', '-')} {value:g}, allowed from {least} on")
    options.seconds = min(options.seconds, threading.TIMEOUT_MAX)
    every = robustness_experiments(STANDARD, FLAPS, options.draws, options.flap_draws)
    for option, label in (("methods", "method"), ("scenes", "scene")):
        known = list(dict.fromkeys(str(one.label[label]) for one in every))
        if unknown := [name for name in getattr(options, option) or () if name not in known]:
            parser.error(f"--{option} {', '.join(map(repr, unknown))}, allowed {', '.join(known)}")
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f".{STUDY.name}.jsonl"
    journal = Journal(path)
    experiments = chosen(every, options)
    works = [one.work(options.resolution) for one in experiments]
    left = [k for k, work in enumerate(works) if key_of(work) not in journal.rows]
    _say(f"retract {code_version()}: {len(left)} of {len(works)} rows to do")
    count = min(options.workers, len(left))
    try:
        found = side_by_side([works[k] for k in left], count, options.seconds) if left else iter(())
        for done, (number, row, seconds) in enumerate(found, 1):
            one, work = experiments[left[number]], works[left[number]]
            journal.add(key_of(work), row)
            told = ", ".join(f"{name} {row[name]}" for name in ("reason", "max_strain", "by_rod", "survived"))
            label = " ".join(str(value) for value in one.label.values())
            _say(f"{done} of {len(left)}: {label}: {told}, {seconds:.0f} s")
    except BrokenProcessPool:
        _say("a worker died; what was under way is done when called again")
    if options.report:
        _say("written: " + ", ".join(str(p) for p in written(every, options, path)))


if __name__ == "__main__":
    main()
