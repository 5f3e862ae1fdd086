"""Processes that begin in a block, and libraries that compute, have one thread each."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from retract_env.threads import ONE_THREAD, limit_mkl, limit_torch, single_threaded


def test_processes_of_the_block_compute_on_one_thread_and_later_ones_as_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    code = f"import os; print([os.environ.get(name) for name in {ONE_THREAD!r}])"
    with single_threaded():
        shown = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert shown.strip() == str(["1"] * len(ONE_THREAD))
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "MKL_NUM_THREADS" not in os.environ


def test_mkl_is_sequential_before_it_counts_its_threads() -> None:
    """The layer can be chosen only before anything else is asked of the library."""

    class Library:
        calls: list[tuple[str, int]]

        def __init__(self) -> None:
            self.calls = []

        def __getattr__(self, name: str) -> object:
            return lambda value: self.calls.append((name, value))

    library = Library()
    limit_mkl(library)
    assert library.calls[:2] == [("MKL_Set_Threading_Layer", 1), ("MKL_Set_Num_Threads", 1)]
    assert {name for name, _ in library.calls[2:]} == {"MKL_CBWR_Set"}


def test_torch_has_one_thread() -> None:
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    try:
        limit_torch(torch)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)
