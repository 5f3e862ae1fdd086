"""The judge: follows any jaw path through the finite elements and says what became of it. Sec. III-C, IV-A.

A retraction is only as good as its certificate. The certifier knows nothing of who proposed the path. It
follows it in increments, measures the three objectives after each, and stops at success or at the first
broken limit.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from retract_env import __version__
from retract_env.fem.solver import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, SectionMesh, patch_ends
from retract_env.objectives import verdict
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene

REASONS = ("ok", "not_visible", "strain", "slip", "release", "diverged")
SQUEEZE_INCREMENTS = 4
LONGEST_STEP = 2.5e-3
"""m, farthest that a jaw moves in one increment; longer steps between waypoints are divided."""
ON_TIME = 2e-5
"""m, the moment of visibility is met within this clearance."""
MOST_TIMINGS = 12
"""Solutions spent on that moment; tissue that snaps past the line never meets it."""
FARTHEST = 10.0
"""m, from the origin, that a path may lead; jaws as far away as that hold nothing any more."""
FINER = {"coarse": "medium", "medium": "fine", "fine": "finer"}


@dataclass(frozen=True)
class Certificate:
    """What a retraction does to the tissue, by the finite elements. `to_json` gives the stable names."""

    certified: bool
    reason: str
    """one of REASONS: why the motion ended"""
    max_strain: float
    """eps_max, the greatest eps_1% of all increments"""
    strain_limit: float
    required_friction: float
    """the greatest of both jaws and all increments since the jaws closed"""
    friction_limit: float
    clearance: float
    """m, at the end"""
    increments: int
    mesh: dict[str, Any]
    scene_hash: str
    grasp: dict[str, float]
    path: dict[str, Any]
    """kind, and the progress in waypoints at the end"""
    history: dict[str, list[Any]]
    version: str = __version__
    verification: dict[str, Any] | None = None
    """the same on a finer mesh, and the differences; None unless asked for"""
    frames: tuple[TissueState, ...] = field(default=(), repr=False, compare=False)
    section: SectionMesh | None = field(default=None, repr=False, compare=False)

    def to_json(self) -> dict[str, Any]:
        """Plain data; `hash` is the SHA-256 of all the rest in canonical form. No wall-clock is in it."""
        data = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("frames", "section")}
        data = _finite(data)
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return {**data, "hash": hashlib.sha256(text.encode()).hexdigest()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Certificate:
        """The inverse of `to_json`. Raises ValueError where the content does not match its hash."""
        names = {f.name for f in fields(cls)} - {"frames", "section"}
        if not isinstance(data, Mapping) or set(data) != names | {"hash"}:
            raise ValueError("certificate: fields are missing or unknown")
        content = {k: v for k, v in data.items() if k != "hash"}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        if hashlib.sha256(text.encode()).hexdigest() != data["hash"]:
            raise ValueError("certificate: its content does not match its hash")
        numbers = ("required_friction", "history", "verification")
        return cls(**content | {name: _numbers(content[name]) for name in numbers})


def _finite(value: Any) -> Any:
    """JSON has no infinity: a jaw that pulls needs friction "inf"."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return value


def _numbers(value: Any) -> Any:
    """The inverse of `_finite`, for values that hold no names of that sort."""
    if value in ("inf", "-inf", "nan"):
        return float(value)
    if isinstance(value, dict):
        return {k: _numbers(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_numbers(v) for v in value]
    return value


class Trial:
    """One retraction under way: squeeze it, then move it. From any thread, one call at a time."""

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str = "fine"):
        """Raises ValueError: grasp off the flap, path that does not begin there, or unknown resolution."""
        if resolution not in RESOLUTIONS:
            raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(RESOLUTIONS)}")
        grasp.check_inside(scene.tissue.length, scene.tissue.height)
        patch_ends(scene, grasp.x)
        # Squeezed in place too: the closing jaws are not judged, so no motion may hide there.
        height, half = scene.tissue.height, grasp.compression / 2
        for row, gap, state in ((0, 0.0, "at rest"), (1, half, "squeezed")):
            start = np.array([grasp.x, gap, grasp.x, height - gap])
            if not np.allclose(path.waypoints[row], start, rtol=0, atol=1e-6 * scene.tissue.length):
                found = path.waypoints[row].tolist()
                raise ValueError(
                    f"path.waypoints[{row}] = {found} m, allowed the grasp {state} {start.tolist()} m"
                )
        far = float(np.abs(path.waypoints).max())
        if far > FARTHEST:
            raise ValueError(f"path.waypoints reach {far:g} m from the fixed end, allowed {FARTHEST:g} m")
        self.scene, self.grasp, self.path, self.resolution = scene, grasp, path, resolution
        self.frames: list[TissueState] = []
        self.reason: str | None = None
        self.max_strain = 0.0
        self.required_friction = 0.0
        self.physics: FemPhysics | None = None
        self.optimising = 0.0
        """s spent on the path before the squeeze, with whose seconds they are counted"""

    @property
    def ended(self) -> bool:
        return self.reason is not None

    @property
    def clearance(self) -> float:
        return self.frames[-1].clearance if self.frames else math.nan

    def squeeze(self) -> None:
        """Mesh the flap, let it rest on its bed and close the jaws; starts anew when called again.

        The strain of the squeeze bounds that of the whole retraction from below. Raises MeshError.
        """
        self.physics = FemPhysics(self.scene, self.grasp.x, self.resolution)
        if self.optimising:
            self.physics.seconds["optimisation"] += self.optimising
            self.optimising = 0.0
        self.frames = [self.physics.state()]
        self.reason, self.max_strain, self.required_friction = None, 0.0, 0.0
        try:
            self.frames = [self.physics.reset()]
        except Diverged:
            self.reason = "diverged"
        for part in np.linspace(0, 1, SQUEEZE_INCREMENTS + 1)[1:]:
            if not self.ended:
                self._advance(float(part))
        self.physics.turn()

    def move(
        self, bound: Callable[[], float] = lambda: math.inf, on_increment: Callable[[], None] = lambda: None
    ) -> None:
        """Follow the path to success, a broken limit, or its end.

        bound: asked after each increment; a strain above it ends the trial with the reason "pruned".
        """
        assert self.physics is not None, "squeeze first"
        for target in self._increments():
            if self.ended:
                return
            if self.max_strain > bound():
                self.reason = "pruned"
                return
            before = self.frames[-1]
            self._advance(target)
            if self.reason != "diverged" and self.clearance >= 0:
                self._time_visibility(before)
                self.reason = self.reason or "ok"
            on_increment()
        self.reason = self.reason or "not_visible"

    def _increments(self) -> Iterator[float]:
        """Progress at each increment of the motion: every waypoint, long steps divided."""
        jaws = self.path.waypoints
        for k in range(2, len(jaws)):
            step = np.abs(jaws[k] - jaws[k - 1]).reshape(2, 2)
            pieces = max(1, math.ceil(float(np.hypot(*step.T).max()) / LONGEST_STEP))
            for i in range(pieces):
                yield k - 1 + (i + 1) / pieces

    def _advance(self, progress: float) -> None:
        assert self.physics is not None
        try:
            state = self.physics.move_to(self.path.pose_at(progress), progress)
        except Diverged:
            self.reason = "diverged"
            return
        self._judge(state)

    def _judge(self, state: TissueState) -> None:
        limits = self.scene.limits
        self.frames.append(state)
        self.max_strain = max(self.max_strain, state.max_strain)
        friction = 0.0
        if state.progress >= 1:  # security is asked of closed jaws
            friction = float(state.required_friction.max())
            self.required_friction = max(self.required_friction, friction)
        found = verdict(state.max_strain, friction, state.clearance, limits.strain, limits.friction)
        if found != "ok":  # success is for `move` to say, once it is on time
            self.reason = found

    def _time_visibility(self, hidden: TissueState) -> None:
        """Shorten the last increment until the tissue has just cleared the line (regula falsi, Illinois).

        The trial ends on the first state seen to clear it, unless a limit breaks before.
        """
        seen = self.frames[-1]
        # distances to the middle of what is on time; an end that stays is halved, lest it stay for good
        low, high = hidden.clearance - ON_TIME / 2, seen.clearance - ON_TIME / 2
        moved = ""
        for _ in range(MOST_TIMINGS):
            if seen.clearance <= ON_TIME:
                return
            self._take_back()
            part = min(0.95, max(0.05, low / (low - high)))
            self._advance(hidden.progress + (seen.progress - hidden.progress) * part)
            if self.reason == "diverged":  # what was reached counts
                self.reason = None
                self._judge(seen)
                return
            state = self.frames[-1]
            if state.clearance >= 0:
                seen, high = state, state.clearance - ON_TIME / 2
                low = low / 2 if moved == "seen" else low
                moved = "seen"
            elif self.ended:
                return
            else:
                hidden, low = state, state.clearance - ON_TIME / 2
                high = high / 2 if moved == "hidden" else high
                moved = "hidden"
                self._judge(seen)

    def _take_back(self) -> None:
        """Forget the last state and its verdict."""
        self.frames.pop()
        self.reason = None
        self.max_strain = max(f.max_strain for f in self.frames)
        self.required_friction = max(
            (float(f.required_friction.max()) for f in self.frames if f.progress >= 1), default=0.0
        )

    def certificate(self) -> Certificate:
        """The verdict, once the trial has ended."""
        assert self.physics is not None and self.reason in REASONS
        limits, frames = self.scene.limits, self.frames
        history = {
            "progress": [f.progress for f in frames],
            "strain": [f.max_strain for f in frames],
            "worst_at": [f.worst_at.tolist() for f in frames],
            "friction": [f.required_friction.tolist() if f.progress >= 1 else [0.0, 0.0] for f in frames],
            "reactions": [f.reactions.tolist() for f in frames],
            "clearance": [f.clearance for f in frames],
            "jaws": [f.jaws.tolist() for f in frames],
        }
        prism = self.physics.model.prism
        return Certificate(
            certified=self.reason == "ok",
            reason=self.reason,
            max_strain=self.max_strain,
            strain_limit=limits.strain,
            required_friction=self.required_friction,
            friction_limit=limits.friction,
            clearance=self.clearance,
            increments=len(frames) - 1,
            mesh={
                "nodes": len(prism.section.points) * prism.levels,
                "elements": sum(b.count for b in prism.blocks),
                "resolution": self.resolution,
            },
            scene_hash=self.scene.hash,
            grasp={"x": self.grasp.x, "compression": self.grasp.compression},
            path={"kind": self.path.kind, "end": frames[-1].progress},
            history=history,
            frames=tuple(frames),
            section=self.physics.section,
        )


def certify(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    resolution: str = "fine",
    verify: bool = False,
    on_increment: Callable[[], None] = lambda: None,
) -> Certificate:
    """Simulate one retraction and judge it.

    resolution: a name in RESOLUTIONS; verify: repeat it on a finer mesh and report the differences.
    Raises ValueError for a grasp off the flap, a path that does not begin there, or an unknown resolution,
    and its kind MeshError where the flap with jaws there cannot be meshed.
    """
    trial = Trial(scene, grasp, path, resolution)
    if verify and resolution not in FINER:
        raise ValueError(
            f"resolution = {resolution!r} has no finer one to verify with, allowed {', '.join(FINER)}"
        )
    trial.squeeze()
    trial.move(on_increment=on_increment)
    certificate = trial.certificate()
    return verified(certificate, scene, grasp, path) if verify else certificate


def verified(certificate: Certificate, scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    """The certificate with the differences to the same retraction on the next finer mesh."""
    finer = certify(scene, grasp, path, FINER[certificate.mesh["resolution"]])
    differences = {
        "resolution": finer.mesh["resolution"],
        "nodes": finer.mesh["nodes"],
        "reason": finer.reason,
        "max_strain": finer.max_strain,
        "max_strain_difference": _ratio(certificate.max_strain, finer.max_strain) - 1,
        "required_friction": finer.required_friction,
        "required_friction_difference": certificate.required_friction - finer.required_friction,
        "end_difference": certificate.path["end"] - finer.path["end"],
    }
    content = {f.name: getattr(certificate, f.name) for f in fields(certificate)}
    return Certificate(**content | {"verification": differences})


def _ratio(a: float, b: float) -> float:
    return a / b if b else math.nan  # a finer flap that found no rest has no strain
