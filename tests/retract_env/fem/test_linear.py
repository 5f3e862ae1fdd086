"""MKL is found without a search, set up once, and done without where it is not installed."""

from __future__ import annotations

import ctypes
import glob
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from retract_env.errors import NotPositiveDefinite
from retract_env.fem import linear
from retract_env.fem.linear import Mkl, Qdldl, cholesky


def test_mkl_is_found_where_its_distribution_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search goes through every folder of the environment, for seconds."""
    pytest.importorskip("pypardiso")

    def search(*_: object, **__: object) -> None:
        raise AssertionError("searched the environment")

    monkeypatch.delenv("PYPARDISO_MKL_RT", raising=False)
    monkeypatch.setattr(glob, "glob", search)
    library = Mkl().library()
    assert library is not None
    assert library.pardiso


def test_the_users_own_mkl_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pypardiso")
    opened = []
    real = ctypes.CDLL

    def note(name: Any, *args: Any, **options: Any) -> Any:
        opened.append(str(name))
        return real(name, *args, **options)

    path = linear._installed_mkl()[0]
    monkeypatch.setenv("PYPARDISO_MKL_RT", f"{path.parent}/./{path.name}")
    monkeypatch.setattr(ctypes, "CDLL", note)
    assert Mkl().library() is not None
    assert opened == [f"{path.parent}/./{path.name}"]


def test_threads_that_ask_together_get_one_library_set_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    class Library:
        pardiso = type("Entry", (), {"argtypes": ()})()

    set_up: list[Any] = []
    together = threading.Barrier(8)

    def load() -> Library:
        time.sleep(0.05)
        return Library()

    def ask() -> Any:
        together.wait()
        return mkl.library()

    monkeypatch.setattr(linear, "_load_mkl", load)
    monkeypatch.setattr(linear, "limit_mkl", set_up.append)
    mkl = Mkl()
    with ThreadPoolExecutor(8) as pool:
        answers = [future.result() for future in [pool.submit(ask) for _ in range(8)]]
    assert {id(answer) for answer in answers} == {id(set_up[0])}
    assert len(set_up) == 1


def test_without_mkl_it_is_qdldl(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("qdldl")
    indptr, indices = np.array([0, 1], np.int32), np.array([0], np.int32)
    monkeypatch.setattr(linear, "_load_mkl", lambda: None)
    monkeypatch.setattr(linear, "MKL", Mkl())
    assert isinstance(cholesky(indptr, indices), Qdldl)


def test_a_rough_factorisation_is_right_to_five_digits() -> None:
    rng = np.random.default_rng(0)
    half = np.triu(rng.normal(size=(30, 30)))
    full = half + half.T + 60 * np.eye(30)  # diagonally dominant
    upper = csr_matrix(np.triu(full))
    factor = cholesky(upper.indptr, upper.indices, rough=True)
    b = rng.normal(size=30)
    for scale in (1.0, 2.0):  # the second time on the same pattern
        factor.factorize(scale * upper.data)
        assert factor.solve(b) == pytest.approx(np.linalg.solve(scale * full, b), rel=1e-5, abs=1e-7)
    with pytest.raises(NotPositiveDefinite):
        factor.factorize(-upper.data)


def test_a_first_matrix_that_is_indefinite_costs_nothing_but_time() -> None:
    rng = np.random.default_rng(1)
    full = np.triu(rng.normal(size=(30, 30)))
    upper = csr_matrix(np.triu(full + full.T + 60 * np.eye(30)))
    late, fresh = (cholesky(upper.indptr, upper.indices) for _ in range(2))
    for _ in range(2):
        with pytest.raises(NotPositiveDefinite):
            late.factorize(-upper.data)
    b = rng.normal(size=30)
    for factor in (late, fresh):
        factor.factorize(upper.data)
    assert np.array_equal(late.solve(b), fresh.solve(b))


@pytest.mark.parametrize("scale", [1e-20, 1e36, 1e306])
@pytest.mark.parametrize("load", [1.0, 1e39, 1e150])
def test_values_that_single_precision_does_not_know_are_solved_as_well(scale: float, load: float) -> None:
    """Elements that are crushed to nothing come to such tangents and forces."""
    n, rng = 30, np.random.default_rng(1)
    dense = rng.uniform(-1, 1, (n, n))
    matrix = dense @ dense.T + n * np.eye(n)
    upper = csr_matrix(np.triu(matrix))
    factor = cholesky(upper.indptr, upper.indices, rough=True)
    factor.factorize(scale * upper.data)
    b = rng.uniform(-1, 1, n)
    assert factor.solve(load * b) * (scale / load) == pytest.approx(np.linalg.solve(matrix, b), rel=1e-4)
