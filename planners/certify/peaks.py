"""Where between its increments a retraction may have been strained, or needed friction, more than at them.

A jaw's friction can rise and fall within a fifth of an increment, as when the flap leaves its bed. Between
two increments a quantity is at most the greater end value and what its concavity adds: a parabola of second
derivative -c rises c w^2 / 8 above the chord of an interval w wide, a kink in the middle, whose slope
changes by c w, twice as much, and one that hides in the interval beside it is seen with half of its size.
So `SAFETY` times the parabola's rise bounds what may hide; where that would exceed what is known by more than
a tolerance, the interval is halved and looked at again with what was found there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAFETY = 4.0
"""Rise of a kink in the middle of an interval, half of whose change of slope is seen, over a parabola's."""
NARROWEST = 1 / 64
"""Width in waypoints of an interval that is not halved any more; what jumps there is known on both sides."""
PEELED = 0.25
"""Part of the flap's length that leaves or meets the bed within an increment that is always looked into."""


def bounds(at: Array, values: Array) -> Array:
    """What a quantity may reach between places where it is known, (n - 1,).

    at: (n,) ascending; values: (n,), finite.
    """
    width = np.diff(at)
    slope = np.diff(values) / width
    concave = np.zeros(len(at))
    if len(at) > 2:
        concave[1:-1] = np.maximum(0.0, (slope[:-1] - slope[1:]) / ((width[:-1] + width[1:]) / 2))
    rise = SAFETY / 8 * np.maximum(concave[:-1], concave[1:]) * width**2
    return np.maximum(values[:-1], values[1:]) + rise


def doubtful(at: Array, values: Array, most: float) -> int | None:
    """The interval in which a quantity may exceed `most` by most; None where it cannot.

    at, values: as for `bounds`.
    """
    if len(at) < 2:
        return None
    excess = np.where(np.diff(at) > NARROWEST, bounds(at, values) - most, -np.inf)
    worst = int(excess.argmax())
    return worst if excess[worst] > 0 else None
