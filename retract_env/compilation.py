"""Compiled kernels on disk: that none is older than what it was made of, and a word to whoever waits for new
ones."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
from functools import cache
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).parent
_told: set[str] = set()


@cache
def forget_old() -> None:
    """Delete the package's kernels where any of its sources has changed since they were compiled.

    numba compares a kernel with the file that it is written in, not with those of the functions that it
    calls: after an update it would go on with what these were before. Where nothing can be written, nothing
    is kept. What is kept is loaded without numba's compiler from now on.
    """
    _load_without_compiler()
    sources = sorted(_PACKAGE.rglob("*.py"))
    state = "".join(f"{path} {path.stat().st_mtime_ns} {path.stat().st_size}\n" for path in sources)
    stamp = hashlib.sha256(state.encode()).hexdigest()
    folders = {folder: _kept_in(folder) for folder in {path.parent for path in sources}}
    kept = folders[_PACKAGE] / "kernels.stamp"
    with contextlib.suppress(OSError):
        if kept.exists() and kept.read_text("utf-8") == stamp:
            return
        for folder in folders.values():
            for one in folder.glob("*.nb[ci]"):
                one.unlink(missing_ok=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(stamp, "utf-8")


@cache
def _load_without_compiler() -> None:
    """Have numba take this package's kernels from disk before it has made its compiler ready.

    It does that first even if nothing is to be compiled, half a second in which it imports all that it can
    compile, SciPy's linear algebra too. Machine code needs none of it but the runtime that it allocates
    arrays with. A kernel that is not on disk finds the compiler made ready as ever, by `compile_extra`.
    """
    from numba.core.caching import FunctionCache
    from numba.core.runtime import rtsys

    usual = FunctionCache.load_overload

    def load_overload(self: Any, sig: Any, target_context: Any) -> Any:
        if self._py_func.__module__.partition(".")[0] != __name__.partition(".")[0]:
            return usual(self, sig, target_context)
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    if hasattr(FunctionCache, "_load_overload"):  # a later numba may have another way
        FunctionCache.load_overload = load_overload


def _kept_in(folder: Path) -> Path:
    """Where numba keeps the kernels of the sources in a folder."""
    if elsewhere := os.environ.get("NUMBA_CACHE_DIR"):
        from numba.core.caching import _CacheLocator

        found: Path = Path(elsewhere) / _CacheLocator.get_suitable_cache_subpath(str(folder / "source.py"))
        return found
    return folder / "__pycache__"


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
