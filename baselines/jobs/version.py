"""Which code a result comes from."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import retract_env

PACKAGES = ("retract_env", "planners", "baselines")
NO_RESULTS = (
    "retract_env/drawing/",
    "baselines/pictures/",
    "baselines/play/",
    "baselines/cli/",
    "baselines/benchmark/charts.py",
    "baselines/benchmark/curves.py",
    "baselines/benchmark/ranking.py",
    "baselines/benchmark/report.py",
    "baselines/benchmark/scores.py",
    "baselines/benchmark/references",
    "baselines/learning/trained/",
)
"""What draws, talks and compares: no number that is kept depends on it. A policy has a hash of its own."""
DATA = (".py", ".json")
"""Endings of what numbers depend on: sources, and what was measured once and ships with them."""
LIBRARIES = (
    "casadi", "mkl", "numba", "netgen-mesher", "numpy", "pybullet", "pypardiso", "qdldl", "scipy", "shapely",
)  # fmt: skip
"""Whose numbers results are made of: another version of one may round otherwise, or draw another mesh."""


@cache
def code_version() -> str:
    """The version, and a digest of all that results come from: sources, measured data, and the versions of
    the libraries that compute."""
    digest = hashlib.sha256(digest_of(Path(retract_env.__file__).parents[1]).encode())
    digest.update(" ".join(f"{name} {_installed(name)}" for name in LIBRARIES).encode())
    return f"{retract_env.__version__}+{digest.hexdigest()[:12]}"


def _installed(library: str) -> str:
    """Its version; empty where it is not there."""
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def digest_of(root: Path) -> str:
    """SHA-256, hex, of the names and contents of those files, in packages that lie in the folder `root`."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for source in sorted((root / package).rglob("*")):
            name = source.relative_to(root).as_posix()
            if source.suffix in DATA and not name.startswith(NO_RESULTS):
                digest.update(f"{name}\0".encode())
                digest.update(source.read_bytes())
    return digest.hexdigest()
