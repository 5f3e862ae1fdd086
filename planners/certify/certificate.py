"""What the judge says of a retraction, as a file that can be checked."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from retract_env import __version__
from retract_env.mesh import SectionMesh
from retract_env.physics.base import TissueState

REASONS = ("ok", "not_visible", "strain", "slip", "release", "contact", "torn", "diverged")
FAILURES = tuple(reason for reason in REASONS if reason != "ok")
"""Those of retractions that are not certified."""
ADDED = ("peaks", "clearance_limit")
"""Fields that certificates have had since version 0.2; older ones are read as they are."""
LATER = ("margins", "robust", "moving")
"""Fields that certificates have had since somewhat later, each where it says something."""
MESH_ERRORS = {
    "fine": {"strain": 0.016, "friction": 0.029, "normal_force": 0.034},
    "coarse": {"strain": 0.051, "friction": 0.16, "normal_force": 0.29},
}
"""How far a mesh was off at most: of eps_1% and of the normal force, parts of them; of the needed friction.

`fine` off the limits of ever finer meshes, in seven of eight retractions (docs/results/verification.md; in
the eighth, which drags the flap under its jaws, by .062 and .049), and in force off converged values
(benchmarks.accuracy); `coarse` off `fine`, on 19 of 20 random flaps (benchmarks.coarse)."""
PATCH_SLIP = 0.03
"""Part by which more friction is needed where tissue may creep under the jaws node by node, than what the
forces on whole jaws tell."""


@dataclass(frozen=True)
class Certificate:
    """What a retraction does to the tissue, by the finite elements. `to_json` gives the stable names."""

    certified: bool
    reason: str
    """one of REASONS: why the motion ended"""
    max_strain: float
    """eps_max, the greatest eps_1% along the path, to the tolerance that `peaks` states"""
    strain_limit: float
    required_friction: float
    """the greatest of both jaws since they closed, likewise"""
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
    peaks: dict[str, Any] | None = None
    """where the greatest strain and friction are: progress in waypoints, place at rest, m, jaw; and the
    tolerances to which they are known between increments. None in certificates before version 0.2"""
    clearance_limit: float = 0.0
    """m"""
    margins: dict[str, Any] | None = None
    """what the judge itself may be off by: `mesh` (MESH_ERRORS; None where nothing was compared),
    `peaks` between increments, `patch_slip`. The verdict does not include them"""
    robust: dict[str, Any] | None = None
    """what is said of flaps that are not quite as the scene says (`planners.certify.robust`); None unless
    asked for"""
    moving: dict[str, Any] | None = None
    """what the same motion of the jaws comes to at a speed (`planners.certify.moving`); None unless asked
    for"""
    frames: tuple[TissueState, ...] = field(default=(), repr=False, compare=False)
    section: SectionMesh | None = field(default=None, repr=False, compare=False)

    def to_json(self) -> dict[str, Any]:
        """Plain data; `hash` is the SHA-256 of all the rest in canonical form. No wall-clock is in it."""
        data = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("frames", "section")}
        if self.peaks is None:
            data = {name: value for name, value in data.items() if name not in ADDED}
        data = {name: value for name, value in data.items() if name not in LATER or value is not None}
        data = _finite(data)
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return {**data, "hash": hashlib.sha256(text.encode()).hexdigest()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Certificate:
        """The inverse of `to_json`. Raises ValueError where the content does not match its hash."""
        names = {f.name for f in fields(cls)} - {"frames", "section"}
        if not isinstance(data, Mapping):
            raise ValueError("certificate: allowed is an object")
        whole = names | {"hash"}
        least = whole - set(LATER)
        kept = set(data) - set(LATER)
        if kept not in (least, least - set(ADDED)) or not set(data) <= whole:
            missing, unknown = sorted(least - set(data)), sorted(set(map(str, data)) - whole)
            said = [
                f"{word} {', '.join(found)}"
                for word, found in (("missing", missing), ("unknown", unknown))
                if found
            ]
            raise ValueError(f"certificate: {'; '.join(said)}")
        content = {k: v for k, v in data.items() if k != "hash"}
        try:
            text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        except ValueError:
            raise ValueError("certificate: allowed finite numbers") from None
        if hashlib.sha256(text.encode()).hexdigest() != data["hash"]:
            raise ValueError("certificate: its content does not match its hash")
        numbers = ("required_friction", "history", "verification", "robust", "moving")
        return cls(**content | {name: _numbers(content[name]) for name in numbers if name in content})


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
