"""Results that are kept are those of the code at hand: a change of whatever computes them is noticed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.metadata import version as installed
from pathlib import Path

import pytest

from baselines.jobs import version
from baselines.jobs.version import DATA, NO_RESULTS, PACKAGES, code_version, digest_of

ROOT = Path(__file__).resolve().parents[3]
COMPUTES = (
    "baselines/benchmark/attempts.py",
    "baselines/benchmark/contest.py",
    "baselines/benchmark/methods.py",
    "baselines/benchmark/splits.py",
    "baselines/learning/policies.py",
    "baselines/learning/demos.py",
    "baselines/paper/reproduce.py",
    "planners/certify/scenarios.json",
    "planners/certify/trial.py",
    "retract_env/fem/kernels.py",
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources and data alone, as an installation has them."""
    root = tmp_path_factory.mktemp("installed")
    for package in PACKAGES:
        for source in (f for f in (ROOT / package).rglob("*") if f.suffix in DATA):
            there = root / source.relative_to(ROOT)
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, there)
    return root


def sources(root: Path) -> list[str]:
    return [
        file.relative_to(root).as_posix()
        for package in PACKAGES
        for file in (root / package).rglob("*")
        if file.suffix in DATA
    ]


def changed(root: Path, name: str) -> str:
    """The digest where one file has another line."""
    file = root / name
    before = file.read_bytes()
    file.write_bytes(before + b"\n")
    try:
        return digest_of(root)
    finally:
        file.write_bytes(before)


def test_a_change_of_what_computes_is_another_version(copy: Path) -> None:
    before = digest_of(copy)
    assert set(COMPUTES) <= set(sources(copy))
    for name in (*COMPUTES, *(n for n in sources(copy) if n.startswith("baselines/paper/"))):
        assert changed(copy, name) != before, name
    assert digest_of(copy) == before


def test_a_change_of_what_draws_and_talks_is_none(copy: Path) -> None:
    before = digest_of(copy)
    quiet = [name for name in sources(copy) if name.startswith(NO_RESULTS)]
    folders = {"drawing", "pictures", "play", "cli", "benchmark", "learning"}
    assert {name.split("/")[1] for name in quiet} == folders
    assert all(changed(copy, name) == before for name in quiet)


def test_another_version_of_what_computes_is_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_version()
    monkeypatch.setattr(version, "version", lambda name: "0.1" if name == "numba" else installed(name))
    assert version.code_version.__wrapped__() != before


def test_an_installation_says_the_same_as_the_checkout(copy: Path) -> None:
    """Where the packages lie does not matter, nor what else lies there."""
    (copy / "other").mkdir()
    (copy / "other" / "module.py").write_text("")
    code = "from baselines.jobs import version; print(version.__file__, version.code_version())"
    done = subprocess.run([sys.executable, "-c", code], cwd=copy, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(copy / "baselines" / "jobs" / "version.py"), code_version()]
