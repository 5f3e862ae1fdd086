"""Errors of coarse, medium and fine against converged values: python -m benchmarks.accuracy.

reference.json holds the converged values of each case and how they were made: meshes of SEQUENCE, ever finer at
the ends of the jaw patches, where stress is singular. Down to elements of 1/12 of the patch all values converge, the
normal forces as the first power of that size, so these are extrapolated. Still finer meshes resolve creases that
the surface of a soft solid folds into beside a sharp rigid edge: several equilibria exist, and values jump by
about 1 % from mesh to mesh. The value from 1/12 is therefore quoted, and the finer meshes say how sure it is.

`--converge` makes the reference anew, which takes long.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import progress, table
from planners import paths
from retract_env import __version__
from retract_env.fem.model import FlapModel
from retract_env.fem.solver import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, Resolution
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, load_scene

Array = NDArray[np.float64]

SCENES = Path(__file__).resolve().parents[1] / "configs" / "scenes"
STORED = Path(__file__).with_name("reference.json")
SQUEEZE = 4
"""increments"""
STATIONS = 9
"""increments that the reference keeps, the squeezed flap and the last one among them"""
SEQUENCE = tuple(Resolution(f"1/{n}", patch=12, edge=1 / n, growth=0.25, bulk=0.3) for n in (5, 8, 12, 20, 32, 50))
QUOTED = 2
"""of SEQUENCE; those up to it extrapolate the normal forces"""
TARGETS = {"eps_max %": 2.0, "N %": 5.0, "shape %": 1.0}
"""of fine"""


@dataclass(frozen=True)
class Case:
    scene: str
    kind: str
    x: float
    """m"""
    compression: float
    """m"""
    increments: int = 48

    @property
    def name(self) -> str:
        return f"{self.scene} {self.kind} {1e3 * self.x:g} mm, {1e3 * self.compression:g} mm"

    def load(self) -> tuple[Scene, JawPath]:
        scene, grasp = load_scene(SCENES / f"{self.scene}.yaml"), Grasp(self.x, self.compression)
        if self.kind.startswith("linear"):
            return scene, paths.linear(scene, grasp, math.radians(float(self.kind.removeprefix("linear"))))
        return scene, {"ctc": paths.ctc, "circular": paths.circular}[self.kind](scene, grasp)


CASES = (
    Case("homogeneous", "ctc", -0.025, 0.0011),
    Case("homogeneous_near", "ctc", -0.010, 0.0011),
    Case("homogeneous_near", "circular", -0.020, 0.0011),
    Case("homogeneous", "linear60", -0.030, 0.0011),
    Case("ten_veins", "ctc", -0.03485, 0.000967),
    Case("ten_veins", "circular", -0.0163, 0.0010),
    Case("homogeneous_near", "ctc", -0.045, 0.0004),
)


@dataclass
class Track:
    """What is compared, increment by increment from the first of the squeeze."""

    progress: list[float]
    strain: list[float]
    normal: list[list[float]]
    """N, of each jaw"""
    friction: list[float]
    shape: list[list[float]]
    """m, both corners of the free end, x y x y, and the clearance"""
    unknowns: int = 0
    seconds: float = 0.0

    def at(self, stations: Sequence[float]) -> dict[str, Array]:
        rows = [self.progress.index(p) for p in stations]
        return {k: np.array(v)[rows] for k, v in asdict(self).items() if isinstance(v, list)}


def follow(case: Case, resolution: Resolution, end: float = math.inf) -> Track:
    """Squeeze and move until `end` (progress), the last increment of the case, or the first broken limit.

    Limits end it only where no `end` is given. A mesh on which the motion diverges gives what it reached.
    """
    start = time.perf_counter()
    scene, path = case.load()
    physics = FemPhysics(scene, case.x, resolution)
    length, height = scene.tissue.length, scene.tissue.height
    points = physics.section.points
    corners = [int(np.argmin(np.hypot(*(points - c).T))) for c in ((-length, 0.0), (-length, height))]
    track = Track([], [], [], [], [], len(physics.model.free))
    steps = [*np.arange(1, SQUEEZE + 1) / SQUEEZE, *range(2, case.increments + 2)]
    try:
        physics.reset()
        for at in (float(p) for p in steps if p <= min(end, path.last)):
            state = physics.move_to(path.pose_at(at), at)
            if at == 1:
                physics.turn()
            friction = float(state.required_friction.max())
            broken = state.max_strain > scene.limits.strain or (at >= 1 and friction > scene.limits.friction)
            if math.isinf(end) and broken:
                break
            track.progress.append(at)
            track.strain.append(state.max_strain)
            track.normal.append((-(state.reactions * state.normals).sum(axis=1)).tolist())
            track.friction.append(friction)
            track.shape.append([*state.points[corners].ravel().tolist(), state.clearance])
    except Diverged:
        pass
    track.seconds = time.perf_counter() - start
    return track
