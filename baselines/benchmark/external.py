"""Methods from elsewhere: a function `module:name` that is called with a scene.

It returns what it would do, (Grasp, JawPath) or a Plan; or, where it is to act step by step, something to
call with an observation, which answers with an action. Nothing of it is run in this process: where it lies
is found out from files, and `called` runs in a process of its own.
"""

from __future__ import annotations

import hashlib
import json
import symtable
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

import numpy as np

from baselines.benchmark.splits import BenchmarkError
from planners.base import Plan
from retract_env.config import brief
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

ALLOWED = "(Grasp, JawPath), a Plan, or a function from an observation to an action"
MOST_WAYPOINTS = 2000
"""Of a path that is judged; ours have some fifty."""


class Nonsense(ValueError):
    """What a method returned cannot be judged; the message is one line."""


def found_at(named: str, first: Path | None = None) -> tuple[Path, str]:
    """The folder that the module or package of "module:name" lies in, and a hash of its sources.

    first: folder that is looked in before those of installed packages; the one at hand if not given.
    Of a package every file counts, weights too, but what Python compiled; of a module by itself its file.
    Raises BenchmarkError.
    """
    top = _top_of(named, first)
    digest = hashlib.sha256()
    for source in _sources(top):
        digest.update(f"{source.relative_to(top.parent).as_posix()}\0".encode())
        digest.update(source.read_bytes())
    return top.parent, digest.hexdigest()[:16]


def check_importable(named: str, first: Path) -> None:
    """Raise BenchmarkError where another module of that name was imported here before, which Python would
    take in its place."""
    top, name = _top_of(named, first), named.partition(":")[0].partition(".")[0]
    spec = getattr(sys.modules.get(name), "__spec__", None)
    if spec is not None and _top(spec) != top:
        raise BenchmarkError(
            f"method = {named!r}: this program has another module {name!r}, {spec.origin}; rename {top}"
        )


def _top_of(named: str, first: Path | None) -> Path:
    """The folder of the package of "module:name", or the file of the module. Raises BenchmarkError."""
    module, _, name = named.partition(":")
    parts = module.split(".")
    if not all(part.isidentifier() for part in [*parts, name]):
        raise BenchmarkError(f"method = {named!r}, allowed the name of a method, or module:function")
    spec = PathFinder.find_spec(parts[0], [str(first or Path.cwd()), *sys.path])
    if spec is None:
        raise BenchmarkError(
            f"method = {named!r}: no module {parts[0]!r}, allowed one of this folder, or an installed one"
        )
    file = _file_of(spec, parts[1:])
    if file is None:
        raise BenchmarkError(f"method = {named!r}: there is no module {module!r}")
    if file.suffix == ".py" and not _binds(file, name):
        raise BenchmarkError(f"method = {named!r}: {file} has no {name!r}")
    return _top(spec)


def _top(spec: ModuleSpec) -> Path:
    """The folder of a package, or the file of a module."""
    if spec.submodule_search_locations is not None:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return Path(str(spec.origin)).resolve()


def _file_of(spec: ModuleSpec, inner: list[str]) -> Path | None:
    """The file of a module within a package, or of the module itself; None where there is none."""
    top = _top(spec)
    if spec.submodule_search_locations is None:
        return top if not inner else None
    folder = top.joinpath(*inner)
    candidates = [folder / "__init__.py"]
    if inner:
        candidates += [folder.with_suffix(".py"), *folder.parent.glob(f"{inner[-1]}.*.so")]
    return next((file for file in candidates if file.is_file()), None)


def _sources(top: Path) -> Iterator[Path]:
    if top.is_file():
        yield top
        return
    for file in sorted(top.rglob("*")):
        inner = file.relative_to(top).parts
        hidden = any(part.startswith(".") or part == "__pycache__" for part in inner)
        if file.is_file() and not hidden and file.suffix != ".pyc":
            yield file


def _binds(file: Path, name: str) -> bool:
    """Whether a source defines or imports a name. One that cannot be read is let be, to fail when run."""
    try:
        text = file.read_text("utf-8")
        table = symtable.symtable(text, str(file), "exec")
    except (SyntaxError, ValueError):
        return True
    if "import *" in text or "__getattr__" in table.get_identifiers():
        return True
    if name not in table.get_identifiers():
        return False
    symbol = table.lookup(name)
    return symbol.is_assigned() or symbol.is_imported()


# --- In a process of its own


def called(named: str, folder: str, scene: Scene) -> Any:
    """What the method says of a scene. Raises whatever it raises."""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    module, _, name = named.partition(":")
    return getattr(import_module(module), name)(scene)


def understood(found: Any) -> tuple[Grasp, JawPath] | Callable[[Any], Any]:
    """A grasp and a path that a method returned, or what acts for it. Raises Nonsense."""
    if isinstance(found, Plan):
        found = found.grasp, found.path
    pair = isinstance(found, tuple | list) and len(found) == 2
    if pair and isinstance(found[0], Grasp) and isinstance(found[1], JawPath):
        if len(found[1]) > MOST_WAYPOINTS:
            raise Nonsense(f"a path of {len(found[1])} waypoints, allowed at most {MOST_WAYPOINTS}")
        return found[0], found[1]
    if callable(found) and not isinstance(found, type):
        acts: Callable[[Any], Any] = found
        return acts
    what = f"({', '.join(type(part).__name__ for part in found)})" if pair else brief(found)
    raise Nonsense(f"{what}, allowed {ALLOWED}")


def settings_of(policy: Any) -> dict[str, Any]:
    """What a policy's attribute `env` says, {"kwargs": {...}}, of the environment that it is for; nothing
    where it has none. Raises Nonsense."""
    env = getattr(policy, "env", None)
    if env is None:
        return {}
    kwargs = env.get("kwargs", {}) if isinstance(env, Mapping) else None
    try:
        plain = json.loads(json.dumps(kwargs, allow_nan=False))
    except (TypeError, ValueError, RecursionError):
        plain = None
    if not isinstance(plain, dict):
        raise Nonsense(f'its attribute env = {brief(env)}, allowed {{"kwargs": {{...}}}}, plain data')
    return plain


def checked(action: Any) -> Any:
    """An action (3,) as the environment takes it. Raises Nonsense."""
    try:
        numbers = np.asarray(action, np.float32)
    except (TypeError, ValueError):
        raise Nonsense(f"action = {brief(action)}, allowed 3 numbers") from None
    if numbers.shape != (3,):
        raise Nonsense(f"action has shape {numbers.shape}, allowed (3,)")
    if not np.isfinite(numbers).all():
        raise Nonsense(f"action = {numbers.tolist()}, allowed finite numbers")
    return numbers
