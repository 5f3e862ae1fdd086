"""Equilibrium of a flap for given jaws: Newton's method that factorises as seldom as it can.

Between factorisations the last one is corrected by the steps taken since (L-BFGS, Nocedal and Wright 2006,
algorithm 7.4), so that one factorisation serves several iterations and often several increments.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged, NotPositiveDefinite
from retract_env.fem.linear import Factor, cholesky
from retract_env.fem.model import FlapModel
from retract_env.objectives import WORST_FRACTION

Array = NDArray[np.float64]

STRAIN_TOLERANCE = 1e-5
"""Newton stops once the error's energy is below that of this strain in 1 % of the flap's volume."""
MOST_SHIFTS = 20
"""Tries to make a tangent positive definite, each with ten times the shift of the one before."""
SLOW = 0.7
"""An iteration that leaves more than this part of the residual is followed by a new factorisation."""
MEMORY = 6
"""Latest steps with which L-BFGS corrects an old factorisation."""


Pair = tuple[Array, Array, float]
"""A step, by how much it changed the forces, both over the free unknowns, and one over their product."""


@dataclass(frozen=True, repr=False, eq=False)
class Kept:
    """What a solver goes on with; plain data, which fits any solver of the same model. Not to be changed."""

    made_at: Array
    """(n,) m, displacements at which the factorisation was made"""
    pairs: tuple[Pair, ...]
    """the steps since then that correct it"""


class Equilibrium:
    """Solves for the free unknowns of a model, keeping its factorisation from one call to the next."""

    def __init__(self, model: FlapModel, max_iterations: int = 40):
        self.model = model
        self.max_iterations = max_iterations
        self.factor: Factor = cholesky(model.assembly.indptr, model.assembly.indices)
        self._fresh = False  # made at the displacements where the solution stands now
        self._made_at: Array | None = None  # where the factorisation was made, None without a usable one
        self._owed = False  # it is known where, but it is still to be made again
        self._pairs: list[Pair] = []
        self.counts: Counter[str] = Counter()
        tissue = model.scene.tissue
        half_volume = tissue.length * tissue.height * tissue.depth / 2
        self._tolerance = STRAIN_TOLERANCE**2 * tissue.modulus * WORST_FRACTION * half_volume
        self._diagonal = model.assembly.indptr[:-1]

    def forget(self) -> None:
        """Let the next solution begin with a factorisation of its own: it then depends on nothing that was
        solved before, not even in its last bit."""
        self._made_at, self._pairs = None, []

    @property
    def kept(self) -> Kept | None:
        """All that the next solution depends on besides its first guess; None: on nothing."""
        return None if self._made_at is None else Kept(self._made_at, tuple(self._pairs))

    def remember(self, kept: Kept | None) -> None:
        """Let the next solution be, to the last bit, what it was where `kept` comes from.

        A factorisation cannot be taken along: it is made again in the same place, once it is needed.
        """
        self.forget()
        if kept is not None:
            self._made_at, self._pairs, self._owed = kept.made_at, list(kept.pairs), True

    def factorize(self, u: Array) -> None:
        """Factorise the tangent at u, shifted until it is positive definite (then the step only descends)."""
        self.forget()
        values = self.model.tangent(u)
        shift = 0.0
        for _ in range(MOST_SHIFTS):
            try:
                self.counts["factorisations"] += 1
                self.factor.factorize(values)
                self._made_at, self._owed = u.copy(), False
                self._fresh = True
                return
            except NotPositiveDefinite:
                self.counts["shifts"] += 1
                grown = max(10 * shift, 1e-2 * float(np.abs(values[self._diagonal]).mean()))
                values[self._diagonal] += grown - shift
                shift = grown
        raise Diverged("the tangent is not finite")

    def step(self, u: Array, du_driven: Array) -> Array:
        """First-order change of the free unknowns when the driven ones change by du_driven (n,), from the
        tangent at u."""
        self._ready(u)
        force = self.model.tangent_times(u, du_driven)
        du = du_driven.copy()
        du[self.model.free] = -self.factor.solve(force[self.model.free])
        return du

    def solve(self, u: Array) -> tuple[Array, Array]:
        """Equilibrium near u, whose prescribed unknowns stay as they are.

        Returns u (n,) m and the forces (n,) N that hold the prescribed nodes. Raises Diverged.
        """
        free = self.model.free
        tolerance = self._tolerance
        u = u.copy()
        energy, force = self.model.residual(u)
        if not np.isfinite(energy):
            raise Diverged("the first guess turns elements inside out")
        norm = _norm(force[free])
        self._fresh = False
        self._ready(u)
        for _ in range(self.max_iterations):
            self.counts["iterations"] += 1
            du = -self._descent(force[free])
            slope = _dot(force[free], du)
            length = 1.0
            while True:
                trial = u.copy()
                trial[free] += length * du
                trial_energy, trial_force = self.model.residual(trial)
                trial_norm = _norm(trial_force[free])
                sound = np.isfinite(trial_energy)
                if sound and (trial_norm < 0.9 * norm or trial_energy <= energy + 1e-4 * length * slope):
                    break
                if -slope < 1e-6 * tolerance:  # at the limit of arithmetic
                    return u, force
                if not self._fresh:
                    length = 0.0
                    break
                length *= 0.5
                if length < 1e-6:
                    raise Diverged("the line search found no lower energy")
            if length == 0.0:  # the old factorisation misleads
                self.factorize(u)
                continue
            rate = trial_norm / norm if norm > 0 else 0.0
            self._learn(length * du, trial_force[free] - force[free])
            u, energy, force, norm = trial, trial_energy, trial_force, trial_norm
            # -slope is twice the energy of the step; what is left after it shrinks with the square of the
            # rate
            if length == 1.0 and -slope * rate**2 < tolerance * (1 - min(rate, 0.99)) ** 2:
                return u, force
            if rate > SLOW or length < 1.0:
                self.factorize(u)
            else:
                self._fresh = False
        raise Diverged(f"no equilibrium in {self.max_iterations} iterations")

    def _ready(self, u: Array) -> None:
        """See to it that there is a factorisation: the one that was kept, or else one at u."""
        if self._made_at is None:
            self.factorize(u)
        elif self._owed:
            pairs = self._pairs
            self.factorize(self._made_at)
            self._pairs, self._fresh = pairs, False

    def _descent(self, force: Array) -> Array:
        """The tangent's inverse applied to force: as factorised, corrected by the steps since."""
        q = force.copy()
        weights = []
        for s, y, rho in reversed(self._pairs):
            weight = rho * _dot(s, q)
            weights.append(weight)
            q -= weight * y
        q = self.factor.solve(q)
        for (s, y, rho), weight in zip(self._pairs, reversed(weights), strict=True):
            q += (weight - rho * _dot(y, q)) * s
        return q

    def _learn(self, s: Array, y: Array) -> None:
        curvature = _dot(s, y)
        if curvature > 0:
            self._pairs = [*self._pairs[1 - MEMORY :], (s, y, 1 / curvature)]


def _dot(a: Array, b: Array) -> float:
    # Not BLAS: OpenBLAS starts its threads for vectors as long as these, and they spin on the cores where
    # other candidates run.
    return float(np.einsum("i,i", a, b))


def _norm(a: Array) -> float:
    return math.sqrt(_dot(a, a))
