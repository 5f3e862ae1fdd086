"""Work in threads that end together."""

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
    `stop`; then that exception is raised, of several that of the first item.
    """
    futures: list[Future[Result]] = []
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            futures = [pool.submit(work, item) for item in items]
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            if any(future.exception() is not None for future in done):
                # who stopped because of another's exception may end before it, and has nothing to say
                stop.now = True
                wait([future for future in futures if not future.cancel()])
                failed = [e for f in futures if not f.cancelled() and (e := f.exception()) is not None]
                raise min(failed, key=lambda error: isinstance(error, Stopped))
        except BaseException:
            stop.now = True
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [future.result() for future in futures]
