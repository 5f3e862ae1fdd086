"""The rules that keep the three packages apart, checked on the source and on a fresh interpreter."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping
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


# The rooms of each package from the ground up: a module imports from its own room and from those below it.
FLOORS = {
    "retract_env": (
        "errors", "threads", "compilation", "config", "objectives", "grasp", "scene", "mesh", "spring", "fem",
        "rod", "scenarios",
        "physics", "task", "given", "rollout", "drawing", "env", "vector",
    ),
    "planners": (
        "side_by_side", "linear", "correction", "whatif", "certify", "paths", "base", "effort", "foresight",
        "runner", "proposals", "leads", "search", "deform_closure", "light_grip", "eased", "swift",
        "elastica", "fem_gradient",
    ),
    "baselines": ("jobs", "pictures", "learning", "benchmark", "verification", "paper", "play", "cli"),
}  # fmt: skip
ORDER = tuple(FLOORS)
"""A package imports from itself and from those before it."""


@dataclass(frozen=True)
class Ban:
    """What no module under `importer` may import, be it through other modules."""

    importer: str
    modules: tuple[str, ...]
    but_through: tuple[str, ...] = ()
    """modules whose own imports do not count"""


BANS = (
    Ban("planners", ("retract_env.env", "retract_env.physics.bullet")),
    # `import retract_env` registers an environment for every physics
    Ban("planners", ("gymnasium",), but_through=("retract_env",)),
    Ban("retract_env.physics.bullet", ("retract_env.fem",), but_through=("retract_env.physics.measures",)),
    Ban("retract_env.fem", ("retract_env.physics", "retract_env.rod"), but_through=("retract_env",)),
    Ban("retract_env.rod", ("retract_env.physics", "retract_env.fem"), but_through=("retract_env",)),
)

# A heavy dependency, and the only modules that may import it.
OWNERS = {
    "casadi": ("planners.elastica.program",),
    "felupe": (),  # GPL-3: for tests and benchmarks
    "netgen": ("retract_env.mesh",),
    "pybullet": ("retract_env.physics.bullet.flap",),
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


def imports(source: str, module: str, is_package: bool = False, runtime: bool = False) -> set[str]:
    """Dotted names that a source imports, at whatever depth: `from a import b` counts as a and as a.b.

    runtime: without what is imported for annotations alone.
    """
    tree = ast.parse(source)
    skipped: set[ast.AST] = set()
    if runtime:
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                skipped.update(inner for statement in node.body for inner in ast.walk(statement))
    found: set[str] = set()
    for node in ast.walk(tree):
        if node in skipped:
            continue
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


def arrows(sources: Mapping[str, str], packages: Collection[str]) -> dict[str, set[str]]:
    """What each module imports when it runs: modules of ours, and other packages by their first name.

    A module runs the `__init__` of the packages that it lies in and of those that it imports from.
    """
    graph: dict[str, set[str]] = {}
    for module, source in sources.items():
        found = set()
        for name in imports(source, module, module in packages, runtime=True):
            parts = name.split(".")
            if parts[0] not in PACKAGES:
                found.add(parts[0])
                continue
            found |= {".".join(parts[:k]) for k in range(1, len(parts) + 1)} & sources.keys()
        graph[module] = found - {module}
    return graph


def reached(graph: Mapping[str, set[str]], start: str, but_through: Collection[str] = ()) -> dict[str, str]:
    """All that a module imports, itself or through others, each with the module that it is imported by."""
    seen: dict[str, str] = {}
    waiting = [start]
    while waiting:
        module = waiting.pop()
        if module in but_through and module != start:
            continue
        for name in sorted(graph.get(module, ())):
            if name not in seen:
                seen[name] = module
                waiting.append(name)
    return seen


def floor_of(module: str) -> tuple[int, int] | None:
    """How high a module stands: its package, its room. None for a package's own `__init__`."""
    package, *rooms = module.split(".")
    return (ORDER.index(package), FLOORS[package].index(rooms[0])) if rooms else None


def faults(sources: Mapping[str, str], packages: Collection[str] = ()) -> list[str]:
    """The rules that imports break."""
    found = []
    graph = arrows(sources, packages)
    for module, names in graph.items():
        here = floor_of(module)
        for name in sorted(names & sources.keys()):
            there = floor_of(name)
            above = there is not None and here is not None and there > here
            if above or ORDER.index(name.split(".")[0]) > ORDER.index(module.split(".")[0]):
                found.append(f"{module} imports {name}, which stands above it")
        for ban in BANS:
            if within(module, ban.importer):
                for name, by in reached(graph, module, ban.but_through).items():
                    if within(name, *ban.modules) and by not in ban.but_through:
                        found.append(f"{module} imports {name}, through {by}")
    for module, source in sources.items():
        for name in sorted(imports(source, module, module in packages)):
            for dependency, owners in OWNERS.items():
                if within(name, dependency) and not within(module, *owners):
                    found.append(
                        f"{module} imports {name}, which belongs to {' or '.join(owners) or 'nobody'}"
                    )
    return found + circles(graph)


def circles(graph: Mapping[str, set[str]]) -> list[str]:
    """Modules that import each other, be it through others. A package may import its own modules."""
    without = {m: {n for n in names if not within(m, n)} for m, names in graph.items()}
    found = []
    for module, names in without.items():
        if module in reached(without, module):
            through = sorted(n for n in names if module in reached(without, n))
            found.append(f"{module} imports itself, through {' and '.join(through)}")
    return found


@pytest.fixture(scope="module")
def tree() -> tuple[dict[str, str], set[str]]:
    paths = list(sources(*PACKAGES))
    packages = {module_name(path) for path in paths if path.name == "__init__.py"}
    return {module_name(path): path.read_text("utf-8") for path in paths}, packages


def test_imports_go_down_and_never_round(tree: tuple[dict[str, str], set[str]]) -> None:
    assert faults(*tree) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_every_room_has_a_floor(package: str) -> None:
    rooms = {path.stem for path in (ROOT / package).iterdir() if path.suffix == ".py"}
    rooms |= {path.parent.name for path in (ROOT / package).glob("*/__init__.py")}
    assert rooms - {"__init__", "trained"} == set(FLOORS[package])


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("retract_env.scene.parts", "import planners"),
        ("retract_env.scene.parts", "def f():\n    from baselines import cli"),
        ("retract_env.scene.parts", "from retract_env.physics import fem"),
        ("planners.paths", "from retract_env import env"),
        ("planners.paths", "from retract_env.physics.bullet import flap as b"),
        ("planners.paths", "import gymnasium.spaces"),
        ("planners.paths", "import planners.search"),
        ("planners.certify.trial", "if True:\n    import baselines.jobs.files"),
        ("retract_env.physics.bullet.flap", "from retract_env.fem import kernels"),
        ("retract_env.physics.bullet.flap", "from ...fem.kernels import tangent"),
        ("retract_env.fem.model", "from ..physics import bullet"),
        ("retract_env.env", "import pybullet as p"),
        ("planners.paths", "from torch import nn"),
        ("planners.paths", "import casadi"),
        ("retract_env.fem.prism", "from netgen.geom2d import SplineGeometry"),
        ("baselines.cli.app", "import felupe"),
        ("planners.paths", "import importlib\nimportlib.import_module('torch')"),
    ],
)
def test_a_forbidden_import_is_found(tree: tuple[dict[str, str], set[str]], module: str, source: str) -> None:
    modules, packages = tree
    assert module in modules
    assert any(
        fault.startswith(f"{module} imports") for fault in faults({**modules, module: source}, packages)
    )


def test_a_forbidden_import_is_found_through_another_module() -> None:
    sources = {
        "retract_env.physics.base": "",
        "retract_env.physics.measures": "import retract_env.physics.base",
        "retract_env.fem.model": "from retract_env import physics_free",
        "retract_env.physics.bullet.flap": "import retract_env.physics.measures",
    }
    assert faults(sources) == []
    indirect = {
        **sources,
        "planners.paths": "import planners.base",
        "planners.base": "import gymnasium.spaces",
    }
    assert [f for f in faults(indirect) if f.startswith("planners.paths imports gymnasium")]


def test_a_circle_is_found() -> None:
    ring = {"planners.a": "import planners.b", "planners.b": "def f():\n    import planners.a"}
    assert len(circles(arrows(ring, ()))) == 2
    assert (
        circles(
            arrows(
                {"planners.a": "if TYPE_CHECKING:\n    import planners.b", "planners.b": "import planners.a"},
                (),
            )
        )
        == []
    )


def test_relative_imports_in_a_package_are_resolved_from_the_package() -> None:
    assert imports("from .env import Env", "retract_env", is_package=True) == {
        "retract_env.env",
        "retract_env.env.Env",
    }
    assert imports("from . import fem", "retract_env.grasp") == {"retract_env", "retract_env.fem"}


HEAVY = ("numba", "matplotlib", "pybullet", "torch", "casadi", "netgen", "pypardiso", "stable_baselines3")


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "statement", ["import retract_env", "import baselines.cli.app; baselines.cli.app.main(['--version'])"]
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
    assert set(project["tool"]["setuptools"]["packages"]) - {"retract_env.configs"} == on_disk
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
