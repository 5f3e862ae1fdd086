"""The finite-element core: finite strain, nearly incompressible, quasi-static."""

from __future__ import annotations

import sys
from pathlib import Path


def kernels_are_cached() -> bool:
    """Whether numba finds the kernels compiled on disk, by this Python and from these sources.

    Where not, the first use compiles them, which takes some 20 s.
    """
    from retract_env.fem import kernels

    newest = Path(kernels.__file__).stat().st_mtime
    python = f"py{sys.version_info[0]}{sys.version_info[1]}"
    found = Path(kernels.tangent.stats.cache_path).glob(f"kernels.tangent-*.{python}*.nbi")
    return any(index.stat().st_mtime >= newest for index in found)
