"""The finite-element core: finite strain, nearly incompressible, quasi-static."""

from __future__ import annotations

from retract_env.compilation import forget_old, is_cached

forget_old()


def kernels_are_cached(physics: str = "fem") -> bool:
    """Whether numba has on disk, compiled for this processor from these sources, what a physics needs of the
    kernels; where not, the first use compiles them, which takes some ten seconds.

    physics: any but "fem" needs the residual alone, which measures its states.
    """
    from retract_env.fem import kernels

    return is_cached(kernels.tangent if physics == "fem" else kernels.residual)
