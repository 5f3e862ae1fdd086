"""First guess of how a flap follows its jaws: as a beam, whose sections turn and stay plane.

The tangent guesses that nodes move straight: where jaws turn by 6 degrees, it stretches tissue by 0.5 % that
only turns. Turning the sections by finite angles needs no factorisation, and one factorisation then corrects
what is left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.prism import Prism
from retract_env.scene import Scene

Array = NDArray[np.float64]

SECTIONS = 65
"""Sections between the fixed end and the jaws."""
ROUNDS = 6
"""Iterations of Newton's method for bend and stretch, at most; it converges in three or four."""


class BeamGuess:
    """Moves a prism's nodes with jaws that keep their separation. Beyond the jaws the flap is rigid."""

    def __init__(self, prism: Prism, scene: Scene, jaw_x: float):
        tissue, points = scene.tissue, prism.section.points
        self._prism = prism
        # 0 at the fixed end, 1 from the near edge of the patches on
        self._along = np.clip(points[:, 0] / max(jaw_x + scene.jaws.width / 2, -tissue.length), 0, 1)
        near = 1e-9 * tissue.length
        sides = (np.flatnonzero(np.abs(points[:, 1] - y) < near) for y in (0.0, tissue.height))
        self._sides = [side[np.argsort(self._along[side], kind="stable")] for side in sides]
        self._sections = np.linspace(0, 1, SECTIONS)

    def moved(self, u: Array, start: Array, end: Array) -> Array:
        """u (n,) m after the jaws went from one pose to another, (4,) x, y, theta, separation each.

        The axis turns by theta s + b s (1 - s) at the fraction s of its length and stretches evenly by e; b
        and e are such that its end goes with the jaws.
        """
        positions, s = self._level(u, 0), self._sections
        axis = np.zeros((SECTIONS, 2))
        for side in self._sides:
            axis += 0.5 * _interpolated(s, self._along[side], positions[side])
        pieces, middle = np.diff(axis, axis=0), (s[1:] + s[:-1]) / 2
        turn = end[2] - start[2]
        goal = end[:2] + _turned(axis[-1] - start[:2], turn) - axis[0]
        bend = stretch = 0.0
        for _ in range(ROUNDS):
            turned = _turned(pieces, turn * middle + bend * middle * (1 - middle))
            across = np.stack([-turned[:, 1], turned[:, 0]], axis=1) * (middle * (1 - middle))[:, None]
            slopes = np.stack([(1 + stretch) * across.sum(axis=0), turned.sum(axis=0)], axis=1)
            step = np.linalg.lstsq(slopes, goal - (1 + stretch) * turned.sum(axis=0), rcond=None)[0]
            bend, stretch = bend + step[0], stretch + step[1]
        turned = _turned(pieces, turn * middle + bend * middle * (1 - middle))
        new_axis = axis[0] + np.concatenate([np.zeros((1, 2)), (1 + stretch) * np.cumsum(turned, axis=0)])

        angle = turn * self._along + bend * self._along * (1 - self._along)
        before = _interpolated(self._along, s, axis)
        after = _interpolated(self._along, s, new_axis)
        out = u.copy()
        for level in range(self._prism.levels):
            moved = after + _turned(self._level(u, level) - before, angle)
            self._prism.in_plane(out, level)[:] = moved - self._rest
        return out

    @property
    def _rest(self) -> Array:
        return self._prism.section.points

    def _level(self, u: Array, level: int) -> Array:
        return self._rest + self._prism.in_plane(u, level)


def _interpolated(at: Array, known: Array, values: Array) -> Array:
    """Piecewise linear, both columns of values (n, 2)."""
    return np.stack([np.interp(at, known, values[:, k]) for k in range(2)], axis=1)


def _turned(v: Array, angle: Array | float) -> Array:
    """Vectors (..., 2) turned counter-clockwise by angle (...), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * v[..., 0] - sin * v[..., 1], sin * v[..., 0] + cos * v[..., 1]], axis=-1)
