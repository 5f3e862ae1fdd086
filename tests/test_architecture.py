"""The rules that keep the three packages apart, checked on the source and on a fresh interpreter."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

import retract_env

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("retract_env", "planners", "baselines")
LONGEST_FILE = 400
"""lines"""


@dataclass(frozen=True)
class Ban:
    """What no module under `importer` may import."""

    importer: str
    modules: tuple[str, ...]


BANS = (
    Ban("retract_env", ("planners", "baselines")),
    Ban("planners", ("retract_env.env", "retract_env.physics.bullet", "gymnasium", "baselines")),
    Ban("retract_env.physics.bullet", ("retract_env.fem",)),
    Ban("retract_env.fem", ("retract_env.physics.bullet",)),
)

# A heavy dependency, and the only modules that may import it.
OWNERS = {
    "casadi": ("planners.elastica",),
    "felupe": (),  # GPL-3: for tests and benchmarks
    "netgen": ("retract_env.mesh",),
    "pybullet": ("retract_env.physics.bullet",),
    "pypardiso": ("retract_env.fem.linear",),
    "qdldl": ("retract_env.fem.linear",),
    "sb3_contrib": ("baselines",),
    "stable_baselines3": ("baselines",),
    "torch": ("baselines",),
}

# Names under which a distribution is imported, where they differ.
DISTRIBUTIONS = {
    "netgen": "netgen-mesher",
    "PIL": "pillow",
    "pydantic_core": "pydantic",
    "pygame": "pygame-ce",
    "yaml": "pyyaml",
}


def sources(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((ROOT / folder).rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source: str, module: str, is_package: bool = False) -> set[str]:
    """Dotted names that a source imports, at whatever depth: `from a import b` counts as a and as a.b."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                parts = parts[: len(parts) - node.level + is_package]
                base = ".".join([*parts, *([base] if base else [])])
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in (
            "import_module",
            "__import__",
        ):
            found.update(
                a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)
            )
    return found


def within(name: str, *parents: str) -> bool:
    return any(name == parent or name.startswith(f"{parent}.") for parent in parents)


def faults(source: str, module: str, is_package: bool = False) -> list[str]:
    """The rules that the imports of one module break."""
    found = []
    for name in sorted(imports(source, module, is_package)):
        for ban in BANS:
            if within(module, ban.importer) and within(name, *ban.modules):
                found.append(f"{module} imports {name}")
        for dependency, owners in OWNERS.items():
            if within(name, dependency) and not within(module, *owners):
                found.append(
                    f"{module} imports {name}, which belongs to {' or '.join(owners) or 'no package'}"
                )
    return found


@pytest.mark.parametrize("path", list(sources(*PACKAGES)), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_keep_the_packages_apart(path: Path) -> None:
    assert faults(path.read_text("utf-8"), module_name(path), path.name == "__init__.py") == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("retract_env.scene", "import planners"),
        ("retract_env.scene", "def f():\n    from baselines import cli"),
        ("planners.spring", "from retract_env import env"),
        ("planners.spring", "from retract_env.physics import bullet as b"),
        ("planners.spring", "import gymnasium.spaces"),
        ("planners.certify", "if True:\n    import baselines.files"),
        ("retract_env.physics.bullet", "from retract_env.fem import kernels"),
        ("retract_env.physics.bullet", "from ..fem.kernels import tangent"),
        ("retract_env.fem.model", "from ..physics import bullet"),
        ("retract_env.env", "import pybullet as p"),
        ("planners.spring", "from torch import nn"),
        ("planners.paths", "import casadi"),
        ("retract_env.fem.prism", "from netgen.geom2d import SplineGeometry"),
        ("baselines.cli", "import felupe"),
        ("planners.paths", "import importlib\nimportlib.import_module('torch')"),
    ],
)
def test_a_forbidden_import_is_found(module: str, source: str) -> None:
    assert len(faults(source, module)) >= 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("baselines.cli", "import planners, retract_env.env\nfrom stable_baselines3 import PPO"),
        ("planners.certify", "from retract_env.physics.fem import FemPhysics"),
        ("planners.certify", "import retract_env.environment"),
        ("retract_env.physics.bullet", "import pybullet\nfrom .base import TissueState"),
        ("retract_env.mesh", "from netgen.meshing import Mesh"),
    ],
)
def test_an_allowed_import_passes(module: str, source: str) -> None:
    assert faults(source, module) == []


def test_relative_imports_in_a_package_are_resolved_from_the_package() -> None:
    assert imports("from .env import Env", "retract_env", is_package=True) == {
        "retract_env.env",
        "retract_env.env.Env",
    }
    assert imports("from . import fem", "retract_env.mesh") == {"retract_env", "retract_env.fem"}


HEAVY = ("numba", "matplotlib", "pybullet", "torch", "casadi", "netgen", "pypardiso", "stable_baselines3")


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "statement", ["import retract_env", "import baselines.cli; baselines.cli.main(['--version'])"]
)
def test_what_starts_often_imports_nothing_heavy(statement: str) -> None:
    loaded = run_python(f"import sys; {statement}; print(sorted(set({HEAVY!r}) & set(sys.modules)))")
    assert loaded.splitlines()[-1] == "[]"


def test_retract_env_imports_where_optional_packages_are_missing() -> None:
    missing = "for name in ('pybullet', 'torch', 'casadi'): sys.modules[name] = None"
    assert run_python(f"import sys\n{missing}\nimport retract_env, planners\nprint(retract_env.__version__)")


@pytest.mark.parametrize(
    "path", list(sources(*PACKAGES, "tests", "benchmarks")), ids=lambda path: str(path.relative_to(ROOT))
)
def test_files_are_short_and_named_after_a_concept(path: Path) -> None:
    lines = path.read_text("utf-8").count("\n")
    assert lines <= LONGEST_FILE
    assert not set(re.split(r"[_.]", path.name)) & {
        "util",
        "utils",
        "helper",
        "helpers",
        "misc",
        "common",
        "manager",
    }


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def test_the_packages_listed_are_those_on_disk(project: dict[str, Any]) -> None:
    on_disk = {module_name(path) for path in sources(*PACKAGES) if path.name == "__init__.py"}
    assert set(project["tool"]["setuptools"]["packages"]) == on_disk
    with_sources = {module_name(path.parent / "__init__.py") for path in sources(*PACKAGES)}
    assert with_sources == on_disk, "a folder of sources without __init__.py is left out of an installation"


def declared(requirements: list[str]) -> set[str]:
    names = (re.match(r"[A-Za-z0-9._-]+", requirement) for requirement in requirements)
    return {re.sub(r"[._-]+", "-", name.group()).lower() for name in names if name}


def imported_distributions(paths: Iterator[Path]) -> set[str]:
    own = {*PACKAGES, "__future__", *sys.stdlib_module_names}
    names = {
        name.split(".")[0]
        for path in paths
        for name in imports(path.read_text("utf-8"), module_name(path), path.name == "__init__.py")
    }
    return {DISTRIBUTIONS.get(name, name.replace("_", "-")).lower() for name in names - own}


def test_everything_imported_is_declared(project: dict[str, Any]) -> None:
    extras = project["project"]["optional-dependencies"]
    default = declared(project["project"]["dependencies"])
    ours = default.union(*(declared(extras[name]) for name in extras if name != "dev"))
    assert imported_distributions(sources(*PACKAGES)) - ours == set()


def test_every_default_dependency_is_pinned_for_ci(project: dict[str, Any]) -> None:
    pinned = declared((ROOT / "constraints.txt").read_text("utf-8").splitlines())
    wanted = project["project"]["dependencies"] + project["project"]["optional-dependencies"]["dev"]
    assert declared(wanted) - pinned == set()


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == retract_env.__version__
    assert citation["references"][0]["doi"] == "10.1109/IROS.2009.5354075"
