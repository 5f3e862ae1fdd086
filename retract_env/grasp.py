"""What a gripper does: where it grasps, and the path its two jaws follow.

A jaw position is written in one of two ways, both with any leading shape:
jaws (..., 4) = x1, y1, x2, y2, the lower jaw (1) and the upper jaw (2), m;
pose (..., 4) = x, y, theta, separation: midpoint, m; angle of the axis from lower to upper jaw, measured
from +y, counter-clockwise, rad; distance between the jaws, m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def to_pose(jaws: ArrayLike) -> Array:
    """Pose of jaws (..., 4); theta in (-pi, pi], 0 where the jaws coincide."""
    x1, y1, x2, y2 = np.moveaxis(np.asarray(jaws, dtype=np.float64), -1, 0)
    # 0 - dx is never -0, so a jaw axis straight down is +pi, not -pi
    theta = np.arctan2(0.0 - (x2 - x1), y2 - y1)
    return np.stack([(x1 + x2) / 2, (y1 + y2) / 2, theta, np.hypot(x2 - x1, y2 - y1)], axis=-1)


def to_jaws(pose: ArrayLike) -> Array:
    """Jaws of pose (..., 4); the inverse of `to_pose` for positive separation, theta modulo 2 pi."""
    x, y, theta, separation = np.moveaxis(np.asarray(pose, dtype=np.float64), -1, 0)
    dx, dy = -np.sin(theta) * separation / 2, np.cos(theta) * separation / 2
    return np.stack([x - dx, y - dy, x + dx, y + dy], axis=-1)


@dataclass(frozen=True)
class Grasp:
    """Where the jaws grasp the flap, and how firmly: by how much they close, or by the force with which they
    press from then on, whatever distance that takes. Sec. IV-B, IV-C; the force is not in the paper.

    Raises ValueError where a value cannot belong to any flap; `check_inside` compares with a given one.
    """

    x: float
    """m, along the flap at rest; negative, the fixed end is at 0."""
    compression: float = math.nan
    """m, delta: by how much the jaws close, both together; nan where they close by force."""
    score: float = field(default=math.nan, compare=False)
    """J/m^2, stability U_n; nan when it does not come from the spring model."""
    force: float | None = None
    """N, with which the jaws press: the mean of both jaws' normal reactions, which differ by what they lift.
    None where they close by a compression."""

    def __post_init__(self) -> None:
        for name, unit in (("x", "m"), ("compression", "m"), ("score", "J/m^2"), ("force", "N")):
            value = getattr(self, name)
            if value is None and name in ("compression", "force"):
                continue
            try:
                if isinstance(value, str):
                    raise TypeError
                # a NumPy scalar would not go into JSON
                object.__setattr__(self, name, float(value))
            except (TypeError, ValueError, OverflowError):
                raise ValueError(f"grasp.{name} = {value!r}, allowed a number, {unit}") from None
        if not (math.isfinite(self.x) and self.x < 0):
            raise ValueError(f"grasp.x = {self.x:g} m, allowed below 0 m")
        closes = self.compression is not None and not math.isnan(self.compression)
        if self.force is not None:
            if closes:
                raise ValueError(
                    f"grasp.force = {self.force:g} N and grasp.compression = {self.compression:g} m, "
                    "allowed one of them"
                )
            if not (math.isfinite(self.force) and self.force > 0):
                raise ValueError(f"grasp.force = {self.force:g} N, allowed above 0 N")
            # always the same object, or grips by the same force would not be equal
            object.__setattr__(self, "compression", math.nan)
        elif not closes:
            raise ValueError("grasp.compression = nan m, allowed above 0 m, or else grasp.force, above 0 N")
        elif not (math.isfinite(self.compression) and self.compression > 0):
            raise ValueError(f"grasp.compression = {self.compression:g} m, allowed above 0 m")

    @property
    def firmness(self) -> dict[str, float]:
        """What goes into files beside x: {"compression": m} or {"force": N}."""
        return {"compression": self.compression} if self.force is None else {"force": self.force}

    def check_inside(self, length: float, height: float) -> None:
        """Raise ValueError unless the grasp is on a flap of this length and height, m, the jaws apart."""
        # a grasp computed as -length may miss it by a rounding error
        if not -length * (1 + 1e-12) <= self.x < 0:
            raise ValueError(f"grasp.x = {self.x:g} m, allowed [{-length:g}, 0) m")
        if self.force is None and not 0 < self.compression < height:
            raise ValueError(f"grasp.compression = {self.compression:g} m, allowed (0, {height:g}) m")

    def __reduce__(self) -> tuple[type[Grasp], tuple[float, float, float, float | None]]:
        # through the constructor: a copied nan equals no other
        return Grasp, (self.x, self.compression, self.score, self.force)


@dataclass(frozen=True, eq=False)
class JawPath:
    """Waypoints of the two jaws: row 0 at rest separation, row 1 squeezed, then the motion.

    Between waypoints the pose is interpolated linearly, so that the jaws turn rather than close. Jaws that
    hold by force follow midpoints and angles alone; separations are then what one expects.
    Progress along the path counts waypoints: 0 at rest, 1 squeezed, `last` at the end.
    Raises ValueError, one line, for a wrong shape, a value that is not finite, or jaws that meet.
    """

    waypoints: Array
    """(n, 4) m, x1, y1, x2, y2, n >= 2; read-only."""
    kind: str
    """Who proposed the motion: "ctc", "circular", ..."""

    def __post_init__(self) -> None:
        kind: Any = self.kind  # from a file it may be anything
        if not (isinstance(kind, str) and kind.strip()):
            raise ValueError(f"path.kind = {self.kind!r}, allowed a name")
        waypoints = _rows(self.waypoints, "path.waypoints")
        with np.errstate(over="ignore", invalid="ignore"):
            separation = np.hypot(waypoints[:, 2] - waypoints[:, 0], waypoints[:, 3] - waypoints[:, 1])
        _check_separation(separation)
        waypoints.setflags(write=False)
        object.__setattr__(self, "waypoints", waypoints)

    @classmethod
    def from_poses(cls, poses: ArrayLike, kind: str) -> JawPath:
        """Path through poses (n, 4); a turn of more than pi between two rows comes back as the shorter one.

        Raises ValueError as the constructor does.
        """
        rows = _rows(poses, "path.poses")
        # before the conversion: a negative separation would only swap the jaws
        _check_separation(rows[:, 3])
        return cls(to_jaws(rows), kind)

    @cached_property
    def poses(self) -> Array:
        """(n, 4) x, y, theta, separation; theta starts in (-pi, pi] and has no jumps. Read-only."""
        poses = to_pose(self.waypoints)
        poses[:, 2] = np.unwrap(poses[:, 2])
        poses.setflags(write=False)
        return poses

    @property
    def last(self) -> int:
        """Progress at the end: the number of waypoints less one."""
        return len(self.waypoints) - 1

    def pose_at(self, progress: ArrayLike) -> Array:
        """Poses (..., 4) at progress (...,), exact at the waypoints. Raises ValueError outside [0, last]."""
        at = np.asarray(progress, dtype=np.float64)
        outside = ~((at >= 0) & (at <= self.last))
        if outside.any():
            raise ValueError(f"progress = {at[outside].flat[0]:g} waypoints, allowed [0, {self.last}]")
        rows = np.arange(len(self.waypoints))
        return np.stack([np.interp(at, rows, column) for column in self.poses.T], axis=-1)

    def jaws_at(self, progress: ArrayLike) -> Array:
        """Jaws (..., 4) m at progress (...,), as `pose_at`."""
        return to_jaws(self.pose_at(progress))

    def to_json(self) -> dict[str, Any]:
        """Plain data, {"kind": str, "waypoints": rows of 4 numbers}; every float comes back the same."""
        return {"kind": self.kind, "waypoints": self.waypoints.tolist()}

    @classmethod
    def from_json(cls, data: object) -> JawPath:
        """The inverse of `to_json`. Raises ValueError, one line, for anything else."""
        if not isinstance(data, Mapping) or set(data) != {"kind", "waypoints"}:
            found = ", ".join(sorted(map(str, data))) if isinstance(data, Mapping) else type(data).__name__
            raise ValueError(f"path = {found or 'nothing'}, allowed kind and waypoints")
        return cls(data["waypoints"], data["kind"])

    def __len__(self) -> int:
        return len(self.waypoints)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, JawPath):
            return NotImplemented
        return self.kind == other.kind and np.array_equal(self.waypoints, other.waypoints)

    def __hash__(self) -> int:
        # + 0.0: -0 and 0 are equal and must hash alike
        return hash((self.kind, (self.waypoints + 0.0).tobytes()))

    def __reduce__(self) -> tuple[type[JawPath], tuple[Array, str]]:
        # through the constructor: a plain copy of the array would be writable
        return JawPath, (self.waypoints, self.kind)


def _rows(values: ArrayLike, name: str) -> Array:
    """Fresh (n >= 2, 4) array of finite floats, or ValueError naming the first culprit."""
    try:
        rows = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} = not numbers in equal rows, allowed (n >= 2, 4)") from None
    if rows.ndim != 2 or rows.shape[0] < 2 or rows.shape[1] != 4:
        raise ValueError(f"{name} has shape {rows.shape}, allowed (n >= 2, 4)")
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise ValueError(f"{name}[{row}, {column}] = {rows[row, column]:g}, allowed finite numbers")
    return rows


def _check_separation(separation: Array) -> None:
    """Raise ValueError for the first row whose jaws meet."""
    wrong = ~((separation > 0) & np.isfinite(separation))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ValueError(f"path.separation[{row}] = {separation[row]:g} m, allowed above 0 m")
