"""Threads that end together: when one breaks off, so do the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Stopped(Exception):
    """Another thread broke off, so this one ends too."""


class Stop:
    """Called at every increment of whatever goes on beside other work; raises Stopped once that broke off."""

    def __init__(self) -> None:
        self.now = False

    def __call__(self) -> None:
        if self.now:
            raise Stopped


def side_by_side(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int, stop: Stop
) -> list[Result]:
    """work of every item, `workers` at a time, each in a thread; results in the order of the items.

    Where one raises, or an interrupt reaches the thread that waits, all others end at their next call of
    `stop`; then that first exception is raised.
    """
    futures: list[Future[Result]] = []
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            futures = [pool.submit(work, item) for item in items]
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            failed = [f for f in futures if f in done and f.exception() is not None]
            # who stopped because of another's exception has nothing to say
            for future in sorted(failed, key=lambda f: isinstance(f.exception(), Stopped)):
                future.result()
        except BaseException:
            stop.now = True
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [future.result() for future in futures]
