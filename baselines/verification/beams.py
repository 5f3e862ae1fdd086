"""Beams whose answer is known, in the units of `chains`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from baselines.verification.chains import LENGTH, PLAIN

Array = NDArray[np.float64]

D = PLAIN[2]


def elastica(alpha: float) -> tuple[float, float, float]:
    """Load, and the reach of the tip from the clamp along and across, of an end load that turns it by alpha.

    The cantilever is of length LENGTH, bends by D and neither stretches nor shears; alpha in 0..pi/2.
    """
    k2 = (1 + np.sin(alpha)) / 2
    start = np.arcsin(np.sqrt(1 / (2 * k2)))
    root = (ellipk(k2) - ellipkinc(start, k2)) / LENGTH  # of load / D
    along = np.sqrt(2 * np.sin(alpha)) / root
    return D * root**2, along, LENGTH - 2 * (ellipe(k2) - ellipeinc(start, k2)) / root


def heavy_elastica(weight: float) -> Array:
    """How the tip moves, and its angle, under weight alone; the boundary problem by shooting."""

    def hang(tip: float) -> Array:
        def along(s: float, u: Array) -> list[float]:
            return [u[1], -weight * s * np.cos(u[0]) / D, np.cos(u[0]), np.sin(u[0])]

        return solve_ivp(along, (0, LENGTH), [tip, 0, 0, 0], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]

    tip = float(brentq(lambda t: hang(t)[0], 0, np.pi / 2, xtol=1e-13, rtol=1e-13))
    _, _, x, y = hang(tip)
    return np.array([LENGTH - x, -y, tip])


def polygon(elements: int, turn: float, chord: float) -> Array:
    """(elements + 1, 3) nodes up to the clamp: equal chords, of elements that all turn equally."""
    theta = -turn * np.linspace(1, 0, elements + 1)
    middle = (theta[1:] + theta[:-1]) / 2
    back = np.cumsum(chord * np.stack([np.cos(middle), np.sin(middle)], axis=1)[::-1], axis=0)[::-1]
    ends = np.concatenate([[0, 0.5] - back, [[0, 0.5]]])
    return np.column_stack([ends, theta])
