"""Compiled kernels on disk: that none is older than what it was made of, and a word to whoever waits for new
ones."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
import tempfile
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

_PACKAGE = Path(__file__).parent
_told: set[str] = set()


@cache
def forget_old() -> None:
    """Delete the package's kernels where any of its sources has changed since they were compiled.

    numba compares a kernel with the file that it is written in, not with those of the functions that it
    calls: after an update it would go on with what these were before. What is kept is loaded without numba's
    compiler from now on. Where numba may write nowhere, in no folder of the package and none of the user's,
    kernels are kept in a temporary folder, and a warning says so.
    """
    _load_without_compiler()
    sources = sorted(_PACKAGE.rglob("*.py"))
    state = "".join(f"{path} {path.stat().st_mtime_ns} {path.stat().st_size}\n" for path in sources)
    stamp = hashlib.sha256(state.encode()).hexdigest()
    one_of_each = {path.parent: path for path in sources}
    folders = {folder: _kept_in(path) for folder, path in one_of_each.items()}
    if None in folders.values():
        _keep_in_temporary_folder()
        folders = {folder: _kept_in(path) for folder, path in one_of_each.items()}
    kept = folders[_PACKAGE]
    assert kept is not None
    with contextlib.suppress(OSError):
        file = kept / "kernels.stamp"
        if file.exists() and file.read_text("utf-8") == stamp:
            return
        for kernels in folders.values():
            for one in kernels.glob("*.nb[ci]") if kernels else ():
                one.unlink(missing_ok=True)
        file.write_text(stamp, "utf-8")


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


def _kept_in(source: Path) -> Path | None:
    """The folder where numba keeps the kernels of a source, which it can write to; None without one."""
    from numba.core.caching import FunctionCache

    # numba has no public way to ask where: it says so of a function of that source
    code = compile("def kernel(): ...", str(source), "exec").co_consts[0]
    try:
        return Path(FunctionCache(FunctionType(code, {})).cache_path)
    except RuntimeError:
        return None


def _keep_in_temporary_folder() -> None:
    """Have numba, here and in processes that begin here, keep kernels in a folder for temporary files that
    is nobody else's: they are code, and are run."""
    from numba.core import config

    folder = Path(tempfile.gettempdir()) / f"retract_env-{getattr(os, 'getuid', lambda: 0)()}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
    if not _is_ours(folder):
        folder = Path(tempfile.mkdtemp(prefix="retract_env-"))
    os.environ["NUMBA_CACHE_DIR"] = config.CACHE_DIR = str(folder)
    logging.getLogger("retract_env").warning(
        "compiled kernels are kept in %s, as neither %s nor the user's cache can be written to; "
        "NUMBA_CACHE_DIR says where else",
        folder,
        _PACKAGE,
    )


def _is_ours(folder: Path) -> bool:
    """Whether nobody but this user can have put anything there."""
    about = folder.lstat() if folder.exists() else None
    if about is None or not stat.S_ISDIR(about.st_mode):
        return False
    return not hasattr(os, "getuid") or (about.st_uid == os.getuid() and not about.st_mode & 0o077)


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
