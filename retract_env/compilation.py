"""Whether compiled kernels are on disk already, and a word to whoever waits where they are not."""

from __future__ import annotations

import logging
from typing import Any

_told: set[str] = set()


def is_cached(kernel: Any) -> bool:
    """Whether numba has a kernel on disk, compiled for this processor from these sources."""
    from numba.core.registry import cpu_target

    # numba has no public way to ask. Its index is empty where it is of other sources or of another numba;
    # an entry's key is a signature, the processor, and hashes of the code.
    here = cpu_target.target_context.codegen().magic_tuple()
    return any(key[1] == here for key in kernel._cache._cache_file._load_index())


def announce(kernel: Any, what: str, seconds: float) -> None:
    """Log a warning, once, that what is about to be used is compiled first; nothing where it is on disk.

    kernel: what takes longest of it; seconds: that it usually takes.
    """
    if what not in _told and not kernel.signatures and not is_cached(kernel):
        logging.getLogger("retract_env").warning(
            "first run: compiling %s, some %.0f s; they are then kept", what, seconds
        )
    _told.add(what)
