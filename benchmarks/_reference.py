"""Cases with converged values: how they are followed, compared, converged and kept in reference.json.

A reference comes from SEQUENCE, meshes ever finer at the ends of the jaw patches, where stress is singular.
Down to elements of 1/12 of the patch all values converge, normal forces as the first power of that size, so
these are extrapolated. Still finer meshes resolve creases, into which the surface of a soft solid folds at a
sharp rigid edge: several equilibria exist, and values jump by about 1 % from mesh to mesh, 4 % where the
tissue is pulled hard. So the value from 1/12 is quoted, and the finer meshes say how sure it is; the last one
is twice as fine everywhere else.
"""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import progress
from planners import paths
from retract_env import __version__
from retract_env.errors import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import Resolution
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, load_scene

Array = NDArray[np.float64]

STORED = Path(__file__).with_name("reference.json")
SQUEEZE = 4
"""increments"""
STATIONS = 9
"""increments that the reference keeps, the squeezed flap and the last one among them"""
SEQUENCE = (
    *(Resolution(f"1/{n}", patch=12, edge=1 / n, growth=0.25, bulk=0.3) for n in (5, 8, 12, 20, 32, 50)),
    Resolution("1/12, half elsewhere", patch=12, edge=1 / 12, growth=0.15, bulk=0.15),
)
QUOTED = 2
"""Index in SEQUENCE of the mesh whose values are quoted; normal forces are extrapolated from those up to
it."""
METRICS = ("eps_max %", "eps %", "squeeze N %", "N %", "shape %", "friction")
"""Errors of: the greatest strain; strain at any station; the jaws' normal force when squeezed; that force at
any station; places of the free end's corners and clearance, over the length; needed friction, as a
difference."""


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

    @property
    def length(self) -> float:
        """m, of the flap"""
        return self.load()[0].tissue.length

    def load(self) -> tuple[Scene, JawPath]:
        scene, grasp = load_scene(self.scene), Grasp(self.x, self.compression)
        if self.kind.startswith("linear"):
            slope = math.radians(float(self.kind.removeprefix("linear")))
            return scene, paths.linear(scene, grasp, slope, self.increments)
        return scene, {"ctc": paths.ctc, "circular": paths.circular}[self.kind](scene, grasp, self.increments)


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
            broken = state.worst_strain > scene.limits.strain or (
                at >= 1 and friction > scene.limits.friction
            )
            if math.isinf(end) and broken:
                break
            track.progress.append(at)
            track.strain.append(state.worst_strain)
            track.normal.append((-(state.reactions * state.normals).sum(axis=1)).tolist())
            track.friction.append(friction)
            track.shape.append([*state.points[corners].ravel().tolist(), state.clearance])
    except Diverged:
        pass
    track.seconds = time.perf_counter() - start
    return track


def errors(track: Track, reference: dict[str, Any], length: float) -> dict[str, float]:
    """Deviations from a reference at the stations that the track reached."""
    kept = [k for k, p in enumerate(reference["progress"]) if p in track.progress]
    ours = track.at([reference["progress"][k] for k in kept])
    true = {k: np.array(v)[kept] for k, v in reference.items() if isinstance(v, list)}
    if track.progress[-1] >= reference["progress"][-1]:
        until = reference["progress"][-1]
        most = max(e for p, e in zip(track.progress, track.strain, strict=True) if p <= until)
        strain = most / reference["max_strain"]
    else:
        strain = ours["strain"].max() / true["strain"].max()
    moved = ours["shape"] - true["shape"]
    far = np.stack([np.hypot(moved[:, 0], moved[:, 1]), np.hypot(moved[:, 2], moved[:, 3]), abs(moved[:, 4])])
    force = abs(ours["normal"] / true["normal"] - 1)
    values = (
        100 * (strain - 1),
        100 * abs(ours["strain"] / true["strain"] - 1).max(),
        100 * force[0].max(),
        100 * force.max(),
        100 * far.max() / length,
        abs(ours["friction"] - true["friction"]).max(),
    )
    return {name: float(value) for name, value in zip(METRICS, values, strict=True)}


def converge(case: Case) -> dict[str, Any]:
    """Reference of one case, and how it was made. Raises Diverged where nothing is reached."""
    scene, _ = case.load()
    tracks: list[Track] = []
    for resolution in SEQUENCE:
        tracks.append(follow(case, resolution))
        t = tracks[-1]
        progress(f"{case.name}: edge {resolution.name}, {t.unknowns} unknowns, {len(t.progress)} increments")
    through = [t.progress for t in tracks[: QUOTED + 1]]
    last = min(p[-1] if p else 0.0 for p in through)
    if last < 1:
        raise Diverged(f"{case.name}: no squeeze within the limits")
    stations = sorted({float(p) for p in np.linspace(1, last, STATIONS).round()})
    quoted = tracks[QUOTED]
    values = quoted.at(stations)
    edges = [r.edge for r in SEQUENCE[: QUOTED + 1]]
    forces = np.array([t.at(stations)["normal"] for t in tracks[: QUOTED + 1]])
    values["normal"] = np.polyfit(edges, forces.reshape(len(edges), -1), 1)[1].reshape(forces.shape[1:])
    reference = {k: v.tolist() for k, v in values.items()}
    reference["max_strain"] = max(e for p, e in zip(quoted.progress, quoted.strain, strict=True) if p <= last)
    meshes = []
    for resolution, t in zip(SEQUENCE, tracks, strict=True):
        row = asdict(resolution) | {"unknowns": t.unknowns, "to_progress": t.progress[-1]}
        meshes.append(row | {k: round(v, 4) for k, v in errors(t, reference, scene.tissue.length).items()})
    spread = {name: max(abs(m[name]) for m in meshes[QUOTED:]) for name in METRICS}
    return {
        "case": asdict(case),
        "scene_hash": scene.hash,
        "reference": reference,
        "spread": spread,
        "meshes": meshes,
    }


def store(references: Sequence[dict[str, Any]]) -> None:
    """Write STORED, innermost lists and objects on one line."""
    rounded = json.loads(json.dumps(references), parse_float=lambda s: float(f"{float(s):.6g}"))
    text = json.dumps({"version": __version__, "quoted": SEQUENCE[QUOTED].name, "cases": rounded}, indent=1)
    text = re.sub(r"\[[^][{}]*\]|\{[^][{}]*\}", lambda m: " ".join(m.group().split()), text)
    STORED.write_text(text + "\n", "utf-8")
