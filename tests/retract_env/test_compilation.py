"""Kernels on disk are never older than the sources that they were made of, and whoever waits is told so."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import config

from retract_env import compilation

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of one kernel and of what the kernel calls, with the kernel compiled."""
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(config, "CACHE_DIR", "")
    (tmp_path / "inner").mkdir()
    for name in ("kernel.py", "inner/called.py"):
        (tmp_path / name).write_text("one", "utf-8")
    compilation.forget_old.__wrapped__()
    (tmp_path / "__pycache__" / "kernel.f-1.py311.nbi").write_text("compiled", "utf-8")
    return tmp_path


def kernels(package: Path) -> list[Path]:
    return list(package.rglob("*.nbi"))


def test_kernels_stay_as_long_as_nothing_changes(package: Path) -> None:
    compilation.forget_old.__wrapped__()
    assert kernels(package)


@pytest.mark.parametrize("changed", ["kernel.py", "inner/called.py", "inner/new.py"])
def test_a_change_of_any_source_forgets_all(package: Path, changed: str) -> None:
    (package / changed).write_text("another one", "utf-8")
    compilation.forget_old.__wrapped__()
    assert not kernels(package)


def test_a_folder_that_numba_was_given_is_searched_too(
    package: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path_factory.mktemp("kept")
    monkeypatch.setattr(config, "CACHE_DIR", str(elsewhere))  # as numba reads NUMBA_CACHE_DIR when imported
    compilation.forget_old.__wrapped__()
    (stamp,) = elsewhere.rglob("kernels.stamp")
    ours, others = stamp.with_name("kernel.f-1.nbi"), elsewhere / "other" / "kernel.nbi"
    others.parent.mkdir()
    for kept in (ours, others):
        kept.write_text("compiled", "utf-8")
    (package / "kernel.py").write_text("another one", "utf-8")
    compilation.forget_old.__wrapped__()
    assert not ours.exists() and others.exists()


@pytest.fixture
def installed(
    package: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The user's cache of a package in whose folders nobody can write: there a file is in the way."""
    for folder in (package, package / "inner"):
        shutil.rmtree(folder / "__pycache__")
        (folder / "__pycache__").write_text("in the way", "utf-8")
    cache = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    return cache


@pytest.mark.skipif(sys.platform != "linux", reason="the user's cache is named by another variable")
def test_kernels_in_the_users_cache_are_forgotten_too(package: Path, installed: Path) -> None:
    compilation.forget_old.__wrapped__()
    (stamp,) = installed.rglob("kernels.stamp")
    kernel = stamp.with_name("kernel.f-1.nbi")
    kernel.write_text("compiled", "utf-8")
    compilation.forget_old.__wrapped__()
    assert kernel.exists()
    (package / "inner/called.py").write_text("another one", "utf-8")
    compilation.forget_old.__wrapped__()
    assert not kernel.exists()


@pytest.fixture
def nowhere(
    installed: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The folder for temporary files, where nothing else can be written."""
    (installed / "file").write_text("in the way", "utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(installed / "file"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is as before in the end
    temporary = tmp_path_factory.mktemp("temporary")
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    return temporary


@pytest.mark.skipif(sys.platform != "linux", reason="the user's cache is named by another variable")
def test_where_nothing_else_can_be_written_kernels_are_kept_among_temporary_files(
    nowhere: Path, caplog: pytest.LogCaptureFixture
) -> None:
    compilation.forget_old.__wrapped__()
    (folder,) = nowhere.iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    assert list(folder.rglob("kernels.stamp"))
    (record,) = caplog.records
    assert str(folder) in record.message and "NUMBA_CACHE_DIR" in record.message


@pytest.mark.skipif(sys.platform != "linux", reason="the user's cache is named by another variable")
@pytest.mark.parametrize("trap", ["open to others", "a link"])
def test_a_folder_that_others_can_write_to_is_not_used(nowhere: Path, trap: str) -> None:
    """They could put code there, which would be run."""
    theirs = nowhere / f"retract_env-{os.getuid()}"
    if trap == "a link":
        (nowhere / "elsewhere").mkdir()
        theirs.symlink_to(nowhere / "elsewhere")
    else:
        theirs.mkdir()
        theirs.chmod(0o777)
    compilation.forget_old.__wrapped__()
    used = Path(os.environ["NUMBA_CACHE_DIR"])
    assert used != theirs and used.parent == nowhere and used.stat().st_mode & 0o077 == 0
    assert not any(theirs.iterdir())


LOADED = """
import sys
import numpy as np
from retract_env.compilation import is_cached
from retract_env.spring import stiffness
from retract_env.spring.model import SpringModel
from retract_env.scene import load_scene
there = is_cached(stiffness._integrate)
tissue = load_scene("ten_veins").tissue
print(there, "numba.np.arraymath" in sys.modules or not SpringModel(tissue).k_eq(np.array([-0.02])).all())
print("numba.np.arraymath" in sys.modules)
"""


def test_kernels_on_disk_are_loaded_without_the_compiler(tmp_path: Path) -> None:
    """The first process makes the compiler ready, the next one has no use for it."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    said = [
        subprocess.run(
            [sys.executable, "-c", LOADED], env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert said == [["False", "False", "True"], ["True", "False", "False"]]


def test_whoever_waits_is_told_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compilation, "_told", set())
    monkeypatch.setattr(compilation, "is_cached", lambda kernel: kernel.cached)
    fresh, kept = SimpleNamespace(signatures=[], cached=False), SimpleNamespace(signatures=[], cached=True)
    with caplog.at_level(logging.WARNING, "retract_env"):
        compilation.announce(kept, "what is kept", 10)
        assert not caplog.messages
        compilation.announce(fresh, "the rod", 90)
        compilation.announce(fresh, "the rod", 90)
    assert caplog.messages == ["first run: compiling the rod, some 90 s; they are then kept"]
