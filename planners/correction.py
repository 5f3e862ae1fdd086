"""What finite elements felt along a path more than the rod; added to the rod, it says what others will feel.

The difference between the two models changes little from one flap to another that is nearly the same, or
from one path to another nearby; how little is measured (`planners.certify.robust`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.rod.follow import CLEAR, DRAG, NORMAL, STRAIN
from retract_env.scene import Scene

Array = NDArray[np.float64]

MOST_FRICTION = 5.0
"""Needed friction beyond which no difference is told."""


@dataclass(frozen=True)
class Correction:
    """Of each of t poses of a path."""

    strain: Array
    """(t,) factor"""
    normal: Array
    """(t, 2) factor of what both jaws press with"""
    drag: Array
    """(t, 2) E h d, what they drag more along the flap"""
    friction: Array
    """(t,) how much more is needed between the poses than at them"""
    clearance: Array
    """m, (t,)"""

    @classmethod
    def none(cls, poses: int) -> Correction:
        """The rod as it is."""
        alike = np.zeros((poses, 2))
        return cls(np.ones(poses), alike + 1, alike, np.zeros(poses), np.zeros(poses))

    def padded(self, more: int) -> Correction:
        """As many more poses like the last one."""
        return Correction(
            *(np.concatenate([v, np.repeat(v[-1:], more, axis=0)]) for v in self.__dict__.values())
        )

    def apply(self, felt: Array) -> Array:
        """What finite elements are expected to feel, (..., t, FELT), where the rod feels `felt`; without what
        is between poses."""
        out = felt.copy()
        out[..., STRAIN] *= self.strain
        out[..., CLEAR] += self.clearance
        out[..., NORMAL] *= self.normal
        out[..., DRAG] += self.drag
        return out

    def needed_friction(self, felt: Array) -> Array:
        """(..., t) the greater friction that both jaws need, of what `apply` gives; inf where one pulls."""
        return needed_friction(felt) + self.friction


def needed_friction(felt: Array) -> Array:
    """(...,) the greater one of both jaws, of what a rod felt, (..., FELT); inf where one pulls."""
    normal, drag = felt[..., NORMAL], np.abs(felt[..., DRAG])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(normal > 0, drag / normal, np.inf).max(-1))


def correction(
    scene: Scene, progress: ArrayLike, felt: Array, history: Mapping[str, Sequence[Any]]
) -> Correction | None:
    """What the history of a certificate has more than the rod, pose by pose; None where it has none.

    progress: (t,) in waypoints, of the poses, ascending from 1, the closed jaws, on; felt: (t, FELT) by the
    rod. Of strain and friction the greatest around each pose counts, up to half-way to the next ones. Poses
    that the history does not reach are like the last one that it does.
    """
    progress = np.asarray(progress, float)
    at = np.asarray(history["progress"], float)
    moved = at >= progress[0] - 1e-9
    reached = int((progress <= at[-1] + 1e-9).sum())
    if moved.sum() < 2 or reached < 2:
        return None
    at = at[moved]
    middle = (progress[1:] + progress[:-1]) / 2
    ends = np.minimum(np.concatenate([progress[:1], middle, progress[-1:]]), at[-1])

    def greatest(places: Array, values: Array) -> Array:
        """(t,) around each pose, of values known at places."""
        at_ends = np.interp(ends, places, values)
        out: Array = np.maximum(at_ends[:-1], at_ends[1:])
        for i, (low, high) in enumerate(pairwise(ends)):
            inside = values[(places >= low) & (places <= high)]
            out[i] = max(out[i], inside.max(initial=-np.inf))
        return out

    def there(values: Array) -> Array:
        """(t, ...) at the poses, of values (n, ...) of the history's frames."""
        flat = values.reshape(len(values), -1)
        return np.stack([np.interp(progress, at, v) for v in flat.T], axis=-1).reshape(-1, *values.shape[1:])

    def of(name: str) -> Array:
        found: Array = np.asarray(history[name], float)[moved]
        return found

    unit = scene.tissue.modulus * scene.tissue.height * scene.tissue.depth
    jaws, reactions = of("jaws"), of("reactions") / unit
    axis = (jaws[:, 2:] - jaws[:, :2]) / np.hypot(*(jaws[:, 2:] - jaws[:, :2]).T)[:, None]
    along = np.stack([axis[:, 1], -axis[:, 0]], axis=-1)
    # the tissue is pressed down onto the lower jaw, and drags both back
    normal = np.einsum("nji,ni->nj", reactions, axis) * [-1.0, 1.0]
    drag = -np.einsum("nji,ni->nj", reactions, along)
    found = Correction(
        there(of("strain")) / felt[:, STRAIN],
        there(normal) / felt[:, NORMAL],
        there(drag) - felt[:, DRAG],
        np.zeros(len(progress)),
        there(of("clearance")) - felt[:, CLEAR],
    )
    for values in found.__dict__.values():
        values[reached:] = values[reached - 1]
    told = found.apply(felt)
    more = greatest(at, of("strain")) / greatest(progress, told[:, STRAIN])
    needed = np.minimum(found.needed_friction(told), MOST_FRICTION)
    fine = greatest(at, np.minimum(of("friction").max(-1), MOST_FRICTION))
    between = np.maximum(fine - greatest(progress, needed), 0.0)
    more[reached:], between[reached:] = 1.0, 0.0
    found = replace(found, strain=found.strain * np.maximum(more, 1.0), friction=between)
    sound = all(np.isfinite(v).all() for v in found.__dict__.values()) and (found.normal > 0).all()
    return found if sound else None
