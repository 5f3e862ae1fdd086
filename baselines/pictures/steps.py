"""Which steps of a retraction moving pictures show: evenly along the path, the squeeze drawn out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MOST_FRAMES = 60
SQUEEZE_STEPS = 4.0
"""Steps of the path that the squeeze takes: from rest to closed jaws."""


def drawn_out(progress: ArrayLike) -> Array:
    """(n,) how far along the path steps are at progress (n,) waypoints, the squeeze as long as SQUEEZE_STEPS
    of them."""
    at = np.asarray(progress, float)
    return np.where(at <= 1, SQUEEZE_STEPS * at, SQUEEZE_STEPS - 1 + at)


def shown_frames(steps: Array) -> list[int]:
    """Indices of the frames that are shown, evenly along the path, at most MOST_FRAMES.

    steps: (n,) along the path, as `drawn_out`. The first and the last are among them; where the certifier
    looked between its increments the motion does not slow down.
    """
    if len(steps) == 1:
        return [0]
    usual = float(np.median(np.diff(steps)))
    count = min(len(steps), MOST_FRAMES, math.ceil((steps[-1] - steps[0]) / usual - 1e-9) + 1)
    even = np.linspace(steps[0], steps[-1], count)
    return sorted({int(np.abs(steps - step).argmin()) for step in even})
