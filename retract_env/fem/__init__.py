"""The finite-element core: finite strain, nearly incompressible, quasi-static."""

from __future__ import annotations

from pathlib import Path


def kernels_are_cached() -> bool:
    """Whether numba finds the kernels compiled on disk; where not, the first use compiles them, which takes
    some ten seconds."""
    from retract_env.fem import kernels

    return any(Path(kernels.tangent.stats.cache_path).glob("kernels.tangent-*.nbi"))
