"""The one seam to sparse direct solvers: symmetric positive definite systems, factorised many times on one
pattern.

PARDISO of Intel's MKL where it is installed (x86-64), else QDLDL. PARDISO is called in the library itself,
not through pypardiso's solver class, which would copy and compare the matrix at every call.

A method that corrects its steps by itself, as Newton's does, may ask for a rough factorisation: of systems
that are not large it is made in single precision, in half the time, and gives steps that are right to five
digits.
"""

from __future__ import annotations

import ctypes
import math
import os
import threading
import weakref
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import NotPositiveDefinite
from retract_env.threads import limit_mkl

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


class Factor(Protocol):
    """A sparse Cholesky factorisation, made anew for other values."""

    def factorize(self, values: Array) -> None:
        """values: (nnz,) of the upper triangle. Raises NotPositiveDefinite."""

    def solve(self, b: Array) -> Array:
        """b: (n,) or (n, k); returns the solution in the same shape."""


def cholesky(indptr: Ints, indices: Ints, rough: bool = False) -> Factor:
    """A factorisation for the pattern of an upper triangle in CSR form, diagonal included.

    rough: five digits of a solution are enough.
    """
    if MKL.library() is None:
        return Qdldl(indptr, indices)
    return Pardiso(indptr, indices, rough)


class Mkl:
    """Intel's MKL in this process: looked for, loaded and set up once, by the first thread that asks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: tuple[Any] | None = None

    def library(self) -> Any | None:
        """The handle of ctypes, None where MKL is not installed."""
        with self._lock:
            if self._found is None:
                library = _load_mkl()
                if library is not None:
                    library.pardiso.argtypes = None
                    limit_mkl(library)
                self._found = (library,)
            return self._found[0]


MKL = Mkl()
"""The process's own."""


def _load_mkl() -> Any | None:
    """From where the distribution `mkl` says that it put the library.

    Where it does not say, or the user has named a place in PYPARDISO_MKL_RT, pypardiso finds it, by walking
    through all folders of the environment if it must, which takes seconds.
    """
    if "PYPARDISO_MKL_RT" not in os.environ:
        for path in _installed_mkl():
            with suppress(OSError):
                return ctypes.CDLL(str(path))
    try:
        from pypardiso import PyPardisoSolver

        return PyPardisoSolver().libmkl
    except ImportError:  # also what it raises where it finds no MKL
        return None


def _installed_mkl() -> list[Path]:
    """Files of the distribution `mkl` that are its one library to link with."""
    try:
        files = distribution("mkl").files or []
    except PackageNotFoundError:
        return []
    paths = [Path(str(file.locate())).resolve() for file in files if "mkl_rt" in file.name]
    return [path for path in paths if path.is_file() and path.suffix != ".lib"]


_SPD = 2
_NOT_POSITIVE = -4
_ANALYSE, _FACTORISE, _SOLVE, _RELEASE = 12, 22, 33, -1
"""phases; the first factorises too"""
LARGE = 12_000
"""Unknowns of a large system. Nested dissection is then the better order: on an AMD EPYC, in single
precision, a flap of 6,200 is factorised in 3.8 ms in the order of least degree and in 4.7 by dissection, one
of 22,000 in 93 and 60. And condition numbers come near to what single precision can hold; in smaller flaps of
random scenes 103 tangents out of 320 were found indefinite, and all were so in double precision too."""


HUGE = 1e30
"""Values beyond are told in larger units where single precision, which ends at 3e38, computes with them."""


class Pardiso:
    """Supernodal Cholesky of Intel MKL, one handle a pattern."""

    def __init__(self, indptr: Ints, indices: Ints, rough: bool = False):
        large = len(indptr) > LARGE
        self._kind: type[np.floating[Any]] = np.float32 if rough and not large else np.float64
        ia = np.ascontiguousarray(indptr, np.int32) + np.int32(1)
        ja = np.ascontiguousarray(indices, np.int32) + np.int32(1)
        iparm = np.zeros(64, np.int32)
        iparm[0] = 1  # own settings
        iparm[7] = 0  # no iterative refinement: Newton corrects
        iparm[27] = self._kind is np.float32
        if large:
            iparm[1] = 2  # nested dissection
            iparm[23] = 1  # two-level factorisation: solves three times faster than the default
        self._call = _Call(ia, ja, iparm)
        self._analysed, self._unit = False, 1.0

    def factorize(self, values: Array) -> None:
        self._unit = self._fitting(values)
        values = np.ascontiguousarray(values if self._unit == 1 else values / self._unit, self._kind)
        error = self._call(_FACTORISE if self._analysed else _ANALYSE, values)
        if error not in (0, _NOT_POSITIVE):
            raise RuntimeError(f"PARDISO stopped with error {error}")
        if not self._analysed:
            self._analysed = True
            # not at exit: the library may be gone by then, and the memory goes anyway
            weakref.finalize(self, self._call, _RELEASE).atexit = False
        if error:
            raise NotPositiveDefinite
        self._values = values

    def solve(self, b: Array) -> Array:
        unit = self._fitting(b)
        b = np.asfortranarray(b if unit == 1 else b / unit, self._kind)
        x = np.empty_like(b)
        error = self._call(_SOLVE, self._values, b, x)
        if error:
            raise RuntimeError(f"PARDISO stopped with error {error}")
        found = x.astype(float, copy=False)
        return found if unit == self._unit else found * (unit / self._unit)

    def _fitting(self, values: Array) -> float:
        """The unit in which values fit into the numbers that are computed with; a power of two, 1 as a rule.
        Elements that are crushed to nothing are stiffer than single precision can say."""
        greatest = 0.0 if self._kind is np.float64 else float(np.abs(values).max(initial=0.0))
        if greatest < HUGE or not math.isfinite(greatest):
            return 1.0
        return math.ldexp(1.0, math.frexp(greatest)[1] - 1)


class _Call:
    """PARDISO's one entry point for one pattern; its arguments are made once, as that takes as long as the
    solution of a small system."""

    def __init__(self, ia: Ints, ja: Ints, iparm: Ints):
        def number(i: int) -> Any:
            return ctypes.byref(ctypes.c_int32(i))

        self._arrays = np.zeros(64, np.int64), ia, ja, iparm
        handle, *pattern, settings = (ctypes.c_void_p(a.ctypes.data) for a in self._arrays)
        self._error = ctypes.c_int32(0)
        self._pardiso: Any = getattr(MKL.library(), "pardiso")  # noqa: B009
        self._first = handle, number(1), number(1), number(_SPD)
        self._phases = {p: number(p) for p in (_ANALYSE, _FACTORISE, _SOLVE, _RELEASE)}
        self._size = number(len(ia) - 1)
        self._pattern = pattern
        self._settings, self._quiet, self._one = settings, number(0), number(1)

    def __call__(
        self,
        phase: int,
        values: NDArray[Any] | None = None,
        b: NDArray[Any] | None = None,
        x: NDArray[Any] | None = None,
    ) -> int:
        """Returns PARDISO's error."""
        columns = self._one if b is None or b.ndim == 1 else ctypes.byref(ctypes.c_int32(b.shape[1]))
        self._pardiso(
            *self._first, self._phases[phase], self._size, _address(values), *self._pattern,
            None, columns, self._settings, self._quiet, _address(b), _address(x), ctypes.byref(self._error),
        )  # fmt: skip
        return self._error.value


def _address(a: NDArray[Any] | None) -> ctypes.c_void_p | None:
    return None if a is None else ctypes.c_void_p(a.ctypes.data)


class Qdldl:
    """Simplicial L D L^T of the QDLDL library: about three times slower, but with wheels everywhere."""

    def __init__(self, indptr: Ints, indices: Ints):
        from scipy.sparse import csr_matrix  # the other solver does without

        n = len(indptr) - 1
        self._upper = csr_matrix((np.arange(len(indices)), indices, indptr), shape=(n, n)).tocsc()
        self._order = self._upper.data
        self._solver: Any = None

    def factorize(self, values: Array) -> None:
        import qdldl
        from scipy.sparse import csc_matrix

        upper = csc_matrix(
            (values[self._order], self._upper.indices, self._upper.indptr), shape=self._upper.shape
        )
        try:
            if self._solver is None:
                self._solver = qdldl.Solver(upper, upper=True)
            else:
                self._solver.update(upper, upper=True)
        except RuntimeError as error:  # a zero pivot
            self._solver = None
            raise NotPositiveDefinite from error
        if not (self._solver.factors()[1] > 0).all():
            raise NotPositiveDefinite

    def solve(self, b: Array) -> Array:
        columns = np.asarray(b, float).reshape(len(b), -1)
        x = np.stack([self._solver.solve(np.ascontiguousarray(c)) for c in columns.T], axis=1)
        return x.reshape(np.shape(b))
