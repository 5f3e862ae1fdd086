"""Experiments, of which studies consist: plain data in, plain data out, the same on any machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from baselines.jobs.journal import Row
from baselines.jobs.version import code_version
from planners.certify import Trial
from planners.paths import PATHS
from retract_env.errors import ConfigError
from retract_env.grasp import Grasp
from retract_env.scene import Scene


@dataclass(frozen=True)
class Experiment:
    """One piece of a study's work. Its result depends on function, arguments, resolution and code alone.

    Raises ValueError for a function that another process could not find.
    """

    function: Callable[..., Row]
    """of a module; called with `resolution` and the arguments, all by name"""
    arguments: Mapping[str, Any]
    """plain data"""
    label: Mapping[str, Any] = field(default_factory=dict)
    """what the study calls it; joins the row"""

    def __post_init__(self) -> None:
        name = getattr(self.function, "__qualname__", repr(self.function))
        if not name.isidentifier():
            raise ValueError(f"experiment.function = {name}, allowed functions at the top of a module")

    def work(self, resolution: str) -> dict[str, Any]:
        """All that the result depends on, as plain data for `evaluate`."""
        return {
            "function": f"{self.function.__module__}:{self.function.__qualname__}",
            "arguments": dict(self.arguments),
            "resolution": resolution,
            "code": code_version(),
        }


def evaluate(work: Mapping[str, Any]) -> Row:
    """Do the work of an experiment. JSON has no infinities: friction without bound is "inf".

    Raises ConfigError where the work is for other code, as on a cluster that was not updated.
    """
    if work["code"] != code_version():
        raise ConfigError(f"a worker runs retract {code_version()}, the work is for {work['code']}")
    module, _, name = work["function"].partition(":")
    row: Row = getattr(import_module(module), name)(resolution=work["resolution"], **work["arguments"])
    return {name: str(v) if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}


def retraction(scene: Mapping[str, Any], x: float, compression: float, path: str, label: Row) -> Experiment:
    """Certify a grasp, m, with a path in PATHS."""
    arguments = {"scene": scene, "x": x, "compression": compression, "path": path}
    return Experiment(certified, arguments, label)


def certified(resolution: str, scene: Any, x: float, compression: float, path: str) -> Row:
    """What becomes of a grasp, m, with a path in PATHS."""
    return tried(Trial, Scene.from_data(scene), Grasp(x, compression), path, resolution)


def tried(kind: type[Trial], scene: Scene, grasp: Grasp, path: str, resolution: str) -> Row:
    """The row of a trial that has gone to its end."""
    trial = kind(scene, grasp, PATHS[path](scene, grasp), resolution)
    trial.squeeze()
    trial.move()
    return {
        "compression": trial.grasp.compression,
        "reason": trial.reason,
        "max_strain": trial.max_strain,
        "required_friction": trial.required_friction,
        "clearance": trial.clearance,
    }
