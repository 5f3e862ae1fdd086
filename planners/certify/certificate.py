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

REASONS = ("ok", "not_visible", "strain", "slip", "release", "diverged")


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
