"""The finite-element core: finite strain, nearly incompressible, quasi-static."""

from __future__ import annotations

from typing import Any


def kernels_are_cached(physics: str = "fem") -> bool:
    """Whether numba has on disk, compiled for this processor from these sources, what a physics needs of the
    kernels; where not, the first use compiles them, which takes some ten seconds.

    physics: any but "fem" needs the residual alone, which measures its states.
    """
    from retract_env.fem import kernels

    return is_cached(kernels.tangent if physics == "fem" else kernels.residual)


def is_cached(kernel: Any) -> bool:
    """Whether numba has a kernel on disk, compiled for this processor from these sources."""
    from numba.core.registry import cpu_target

    # numba has no public way to ask. Its index is empty where it is of other sources or of another numba;
    # an entry's key is a signature, the processor, and hashes of the code.
    here = cpu_target.target_context.codegen().magic_tuple()
    return any(key[1] == here for key in kernel._cache._cache_file._load_index())
