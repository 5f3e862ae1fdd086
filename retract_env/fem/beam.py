"""First guess of how a flap follows its jaws: as a beam, whose sections turn and stay plane.

The tangent guesses that nodes move straight: where jaws turn by 6 degrees, it stretches tissue by 0.5 % that
only turns. Turning the sections by finite angles needs no factorisation, and one factorisation then corrects
what is left.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.fem.kernels import JIT
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
        self._at = [np.ascontiguousarray(self._along[side]) for side in self._sides]
        self._sections = np.linspace(0, 1, SECTIONS)

    def moved(self, u: Array, start: Array, end: Array) -> Array:
        """u (n,) m after the jaws went from one pose to another, (4,) x, y, theta, separation each.

        The axis turns by theta s + b s (1 - s) at the fraction s of its length and stretches evenly by e; b
        and e are such that its end goes with the jaws.
        """
        prism = self._prism
        axis = np.zeros((SECTIONS, 2))
        level = prism.section.points + prism.in_plane(u, 0)
        for side, at in zip(self._sides, self._at, strict=True):
            for k in range(2):
                axis[:, k] += 0.5 * np.interp(self._sections, at, level[side, k])
        out = u.copy()
        _follow(axis, start, end, self._along, prism.section.points, prism.levels, prism.stride, out)
        return out


@njit(**JIT)
def _follow(axis, start, end, along, rest, levels, stride, out):
    """Move the nodes of a beam with this axis (k, 2) m before; `out` (n,) has their displacements."""
    pieces = len(axis) - 1
    turn = end[2] - start[2]
    cos = np.cos(turn)
    sin = np.sin(turn)
    arm_x = axis[pieces, 0] - start[0]
    arm_y = axis[pieces, 1] - start[1]
    goal_x = end[0] + cos * arm_x - sin * arm_y - axis[0, 0]
    goal_y = end[1] + sin * arm_x + cos * arm_y - axis[0, 1]
    bend = 0.0
    stretch = 0.0
    for _ in range(ROUNDS):
        sum_x = sum_y = side_x = side_y = 0.0
        for i in range(pieces):
            dx = axis[i + 1, 0] - axis[i, 0]
            dy = axis[i + 1, 1] - axis[i, 1]
            s = (i + 0.5) / pieces
            angle = turn * s + bend * s * (1.0 - s)
            cos = np.cos(angle)
            sin = np.sin(angle)
            x = cos * dx - sin * dy
            y = sin * dx + cos * dy
            sum_x += x
            sum_y += y
            side_x -= y * s * (1.0 - s)
            side_y += x * s * (1.0 - s)
        long = 1.0 + stretch
        miss_x = goal_x - long * sum_x
        miss_y = goal_y - long * sum_y
        det = long * (side_x * sum_y - side_y * sum_x)
        if det == 0.0:
            break
        bend += (miss_x * sum_y - miss_y * sum_x) / det
        stretch += long * (side_x * miss_y - side_y * miss_x) / det
    after = axis.copy()
    for i in range(pieces):
        dx = axis[i + 1, 0] - axis[i, 0]
        dy = axis[i + 1, 1] - axis[i, 1]
        s = (i + 0.5) / pieces
        angle = turn * s + bend * s * (1.0 - s)
        cos = (1.0 + stretch) * np.cos(angle)
        sin = (1.0 + stretch) * np.sin(angle)
        after[i + 1, 0] = after[i, 0] + cos * dx - sin * dy
        after[i + 1, 1] = after[i, 1] + sin * dx + cos * dy
    for node in range(len(along)):
        at = along[node] * pieces
        i = min(int(at), pieces - 1)
        part = at - i
        s = along[node]
        angle = turn * s + bend * s * (1.0 - s)
        cos = np.cos(angle)
        sin = np.sin(angle)
        from_x = axis[i, 0] + part * (axis[i + 1, 0] - axis[i, 0])
        from_y = axis[i, 1] + part * (axis[i + 1, 1] - axis[i, 1])
        to_x = after[i, 0] + part * (after[i + 1, 0] - after[i, 0])
        to_y = after[i, 1] + part * (after[i + 1, 1] - after[i, 1])
        for level in range(levels):
            k = node * stride + 2 * level
            x = rest[node, 0] + out[k] - from_x
            y = rest[node, 1] + out[k + 1] - from_y
            out[k] = to_x + cos * x - sin * y - rest[node, 0]
            out[k + 1] = to_y + sin * x + cos * y - rest[node, 1]
