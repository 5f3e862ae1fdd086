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
