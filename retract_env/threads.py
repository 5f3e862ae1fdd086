"""On how many threads libraries compute: MKL, torch, and what worker processes load, all set here.

Retractions and episodes run side by side, a core each, so that every one of them computes on one thread.
Libraries are handed in by whoever owns the import of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that libraries read when they are loaded."""

_MKL_SEQUENTIAL = 1
_MKL_CBWR_AUTO, _MKL_CBWR_STRICT = 2, 0x10000


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def single_threaded() -> Iterator[None]:
    """Processes that begin in this block compute on one thread each."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def limit_mkl(library: Any) -> None:
    """Set up Intel's MKL, a handle of ctypes, before anything is computed with it.

    One thread a factorisation, as the systems are small. Without the sequential layer OpenMP's threads spin
    and slow everything down many times over. Results have the same bits wherever arrays lie in memory.
    """
    library.MKL_Set_Threading_Layer(_MKL_SEQUENTIAL)
    library.MKL_Set_Num_Threads(1)
    library.MKL_CBWR_Set(_MKL_CBWR_AUTO | _MKL_CBWR_STRICT)


def limit_torch(torch: Any) -> None:
    """Networks of a few thousand weights gain nothing from more threads, which other environments need."""
    torch.set_num_threads(1)
