"""The one seam to sparse direct solvers: symmetric positive definite systems, factorised many times on one
pattern.

PARDISO of Intel's MKL where it is installed (x86-64), else SciPy's SuperLU. PARDISO is called through
pypardiso's handle of the library, not through its solver class, which would copy and compare the matrix at
every call.
"""

from __future__ import annotations

import ctypes
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix, triu
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


class NotPositiveDefinite(ArithmeticError):
    """The matrix has no Cholesky factorisation."""


class Factor(Protocol):
    def factorize(self, values: Array) -> None:
        """values: (nnz,) of the upper triangle. Raises NotPositiveDefinite."""

    def solve(self, b: Array) -> Array:
        """b: (n,) or (n, k); returns the solution in the same shape."""


def cholesky(indptr: Ints, indices: Ints) -> Factor:
    """A factorisation for the pattern of an upper triangle in CSR form, diagonal included."""
    return Pardiso(indptr, indices) if _pardiso() is not None else SuperLU(indptr, indices)


_library: Any = False  # False: not looked for yet


def _pardiso() -> Any:
    global _library
    if _library is False:
        try:
            from pypardiso import PyPardisoSolver
        except ImportError:
            _library = None
        else:
            _library = PyPardisoSolver().libmkl
            _library.pardiso.argtypes = None
            # One thread a factorisation: the systems are small, and candidates run side by side.
            _library.MKL_Set_Num_Threads(1)
            # Same bits whatever the alignment of arrays.
            _library.MKL_CBWR_Set(_CBWR_AUTO | _CBWR_STRICT) if hasattr(_library, "MKL_CBWR_Set") else None
    return _library


_CBWR_AUTO, _CBWR_STRICT = 2, 0x10000
_SPD = 2
_NOT_POSITIVE = -4


class Pardiso:
    """Supernodal Cholesky of Intel MKL, one handle a pattern."""

    def __init__(self, indptr: Ints, indices: Ints):
        self._lib = _pardiso()
        self._n = len(indptr) - 1
        self._ia = np.ascontiguousarray(indptr, np.int32) + np.int32(1)
        self._ja = np.ascontiguousarray(indices, np.int32) + np.int32(1)
        self._handle = np.zeros(64, np.int64)
        self._iparm = np.zeros(64, np.int32)
        self._iparm[0] = 1  # own settings
        self._iparm[1] = 2  # nested dissection
        self._iparm[7] = 0  # no iterative refinement: Newton corrects
        self._iparm[23] = 1  # two-level factorisation: solves three times faster than the default
        self._analysed = False

    def _call(self, phase: int, values: Array | None, b: Array | None = None, x: Array | None = None) -> int:
        def ref(i: int) -> Any:
            return ctypes.byref(ctypes.c_int32(i))

        def at(a: NDArray[Any] | None) -> ctypes.c_void_p | None:
            return None if a is None else ctypes.c_void_p(a.ctypes.data)

        error = ctypes.c_int32(0)
        columns = 1 if b is None or b.ndim == 1 else b.shape[1]
        self._lib.pardiso(
            at(self._handle), ref(1), ref(1), ref(_SPD), ref(phase), ref(self._n), at(values), at(self._ia),
            at(self._ja), None, ref(columns), at(self._iparm), ref(0), at(b), at(x), ctypes.byref(error),
        )  # fmt: skip
        return error.value

    def factorize(self, values: Array) -> None:
        phase = 22 if self._analysed else 12
        error = self._call(phase, values)
        if error == _NOT_POSITIVE:
            raise NotPositiveDefinite
        if error:
            raise RuntimeError(f"PARDISO stopped with error {error}")
        self._analysed = True
        self._values = values

    def solve(self, b: Array) -> Array:
        b = np.asfortranarray(b, float)
        x = np.empty_like(b)
        error = self._call(33, self._values, b, x)
        if error:
            raise RuntimeError(f"PARDISO stopped with error {error}")
        return x

    def __del__(self) -> None:
        if getattr(self, "_analysed", False):
            self._call(-1, None)


class SuperLU:
    """SciPy's general LU in symmetric mode: slower, but everywhere."""

    def __init__(self, indptr: Ints, indices: Ints):
        n = len(indptr) - 1
        self._upper = csr_matrix((np.ones(len(indices)), indices, indptr), shape=(n, n))

    def factorize(self, values: Array) -> None:
        upper = csr_matrix((values, self._upper.indices, self._upper.indptr), shape=self._upper.shape)
        full = csc_matrix(upper + triu(upper, 1).T)
        self._lu = splu(
            full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        # With pivots kept on the diagonal, U's diagonal has the signs of the inertia.
        if not (self._lu.U.diagonal() > 0).all():
            raise NotPositiveDefinite

    def solve(self, b: Array) -> Array:
        return self._lu.solve(np.ascontiguousarray(b, float))
