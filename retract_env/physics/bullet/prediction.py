"""Where the flap goes as the jaws move: linearised statics, from which a dynamic physics begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import NotPositiveDefinite
from retract_env.physics.measures import TetrahedralFlap

Array = NDArray[np.float64]

NEAR = 2e-5
"""m, nodes lower than this are first taken to lie on the bed."""
TRIES = 6
"""Rounds, at most, in search of the nodes that lie on the bed."""
STIFF = 100.0
"""Stiffness of the bed under a node, over the median stiffness of an unknown."""
LEAST_SHIFT, MOST_SHIFT = 1e-3, 10.0
"""First and last stiffness, over the same median, that is added to the diagonal of a tangent which is not
positive definite; each is ten times the one before."""


class Prediction:
    """Solves for the moves of the free nodes, with the tangent where they are."""

    def __init__(self, flap: TetrahedralFlap, load: Array, bed: bool):
        """load: (n, 3) N, on the nodes; bed: whether the flap cannot go below y = 0."""
        self._flap, self._load, self._bed = flap, load.ravel(), bed
        assembly = flap.assembly
        self._factor = flap.factor()
        number = np.full(assembly.size, -1)
        number[assembly.free] = np.arange(len(assembly.free))
        lowest = (flap.mesh.points[:, 1] == 0) & ~flap.held
        self._low = np.flatnonzero(lowest)
        self._falls = number[3 * self._low + 1]
        self._diagonal = assembly.indptr[:-1]

    def __call__(self, points: Array, held: Array) -> Array:
        """Nodes (n, 3) m once the held ones have moved.

        points: (n, 3) m, where they are; held: (n, 3) m, where the held ones go, the others as they are.
        Where no such state is found, only the held ones have moved.
        """
        assembly, rest = self._flap.assembly, self._flap.mesh.points
        u, moves = (points - rest).ravel(), (held - points).ravel()
        _, force = assembly.residual(u)
        pull = -(force - self._load + assembly.tangent_times(u, moves))[assembly.free]
        found = self._solve(assembly.tangent(u), pull, points[self._low, 1])
        if found is None:
            return held
        moves[assembly.free] += found
        predicted = points + moves.reshape(-1, 3)
        if self._bed:
            predicted[:, 1] = np.maximum(predicted[:, 1], np.minimum(points[:, 1], 0.0))
        energy, _ = assembly.residual((predicted - rest).ravel())
        return predicted if np.isfinite(energy) else held

    def _solve(self, tangent: Array, pull: Array, heights: Array) -> Array | None:
        """Moves (free,) m under forces `pull`, N, such that nodes at `heights`, m, stay above the bed."""
        usual = float(np.median(tangent[self._diagonal]))
        lies = heights < NEAR if self._bed else np.zeros(len(heights), bool)
        shift, moves = 0.0, None
        for _ in range(TRIES):
            values, right = tangent.copy(), pull.copy()
            values[self._diagonal] += shift * usual
            values[self._diagonal[self._falls[lies]]] += STIFF * usual
            right[self._falls[lies]] -= STIFF * usual * heights[lies]
            try:
                self._factor.factorize(values)
            except NotPositiveDefinite:
                shift = 10 * shift or LEAST_SHIFT
                if shift > MOST_SHIFT:
                    return None
                continue
            moves = self._factor.solve(right)
            sinks = heights + moves[self._falls] < 0
            if not self._bed or np.array_equal(sinks, lies):
                return moves
            lies = sinks
        return moves
