"""What finite elements felt along a path more than the rod; added to the rod, it says what others will feel.

The difference between the two models changes little from one flap to another that is nearly the same, or
from one path to another nearby; how little is measured (`planners.certify.robust`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.rod.follow import CLEAR, DRAG, NORMAL, STRAIN

Array = NDArray[np.float64]

MOST_FRICTION = 5.0
"""Needed friction beyond which no difference is told."""


def needed_friction(felt: Array) -> Array:
    """(...,) the greater friction that both jaws need, of felt (..., FELT); inf where one pulls."""
    normal, drag = felt[..., NORMAL], felt[..., DRAG]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(normal > 0, drag / normal, np.inf).max(-1)


@dataclass(frozen=True)
class Correction:
    """Of each pose of a path, (t,) each."""

    strain: Array
    """factor"""
    friction: Array
    """what more is needed"""
    clearance: Array
    """m"""

    @classmethod
    def none(cls, poses: int) -> Correction:
        """The rod as it is."""
        return cls(np.ones(poses), np.zeros(poses), np.zeros(poses))


def correction(progress: ArrayLike, felt: Array, history: Mapping[str, Sequence[Any]]) -> Correction | None:
    """What the history of a certificate has more than the rod, pose by pose; None where it has none.

    progress: (t,) in waypoints, of the poses, ascending from 1, the closed jaws, on; felt: (t, FELT) by the
    rod. The greatest strain and friction around each pose count, up to half-way to the next ones. Poses that
    the history does not reach are like the last one that it does.
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
        out = np.maximum(at_ends[:-1], at_ends[1:])
        for i, (low, high) in enumerate(itertools.pairwise(ends)):
            inside = values[(places >= low) & (places <= high)]
            out[i] = max(out[i], inside.max(initial=-np.inf))
        return out

    strain = np.asarray(history["strain"], float)[moved]
    friction = np.minimum(np.asarray(history["friction"], float)[moved].max(-1), MOST_FRICTION)
    clearance = np.interp(progress, at, np.asarray(history["clearance"], float)[moved])
    rod = np.minimum(needed_friction(felt), MOST_FRICTION)
    more = greatest(at, strain) / greatest(progress, felt[:, STRAIN])
    found = Correction(more, greatest(at, friction) - greatest(progress, rod), clearance - felt[:, CLEAR])
    for values in (found.strain, found.friction, found.clearance):
        values[reached:] = values[reached - 1]
    return found if all(np.isfinite(v).all() for v in (more, found.friction, found.clearance)) else None
