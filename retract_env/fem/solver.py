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
from retract_env.fem import descent
from retract_env.fem.linear import Factor, cholesky
from retract_env.fem.model import FlapModel
from retract_env.objectives import WORST_FRACTION

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STRAIN_TOLERANCE = 1e-5
"""Newton stops once the error's energy is below that of this strain in 1 % of the flap's volume."""
MOST_SHIFTS = 20
"""Tries to make a tangent positive definite, each with ten times the shift of the one before."""
SLOW = 0.85
"""An iteration that leaves more than this part of the residual is followed by a new factorisation, which
takes as long as five. Certificates at fine need 10 % less work than with 0.7, and 20 % less than with 0.5."""
MEMORY = 6
"""Latest steps with which L-BFGS corrects an old factorisation."""


@dataclass(frozen=True, repr=False, eq=False)
class Kept:
    """What a solver goes on with; plain data, which fits any solver of the same model. Not to be changed."""

    made_at: Array
    """(n,) m, displacements at which the factorisation was made"""
    held: Bools | None
    """(b,) which of the bed's unknowns counted as pressed into it besides those that were"""
    steps: Array
    """(k, f) m, over the free unknowns, made since then: they correct it"""
    changes: Array
    """(k, f) N, by which the forces changed with each"""
    curvature: Array
    """(k,) J, the product of both"""


class Equilibrium:
    """Solves for the free unknowns of a model, keeping its factorisation from one call to the next."""

    def __init__(self, model: FlapModel, max_iterations: int = 40):
        self.model = model
        self.max_iterations = max_iterations
        self.factor: Factor = cholesky(model.assembly.indptr, model.assembly.indices, rough=True)
        self._fresh = False  # made at the displacements where the solution stands now
        self._made_at: Array | None = None  # where the factorisation was made, None without a usable one
        self._held: Bools | None = None  # of the bed's unknowns, when it was made
        self._owed = False  # it is known where, but it is still to be made again
        f = len(model.free)
        # steps, changes of force, and their products, of which the first `_count` are in use
        self._pairs = np.empty((MEMORY, f)), np.empty((MEMORY, f)), np.empty(MEMORY)
        self._count = 0
        self._weights, self._q = np.empty(MEMORY), np.empty(f)
        self.counts: Counter[str] = Counter()
        tissue = model.scene.tissue
        half_volume = tissue.length * tissue.height * tissue.depth / 2
        self._tolerance = STRAIN_TOLERANCE**2 * tissue.modulus * WORST_FRACTION * half_volume
        self._diagonal = model.assembly.indptr[:-1]

    def forget(self) -> None:
        """Let the next solution begin with a factorisation of its own: it then depends on nothing that was
        solved before, not even in its last bit."""
        self._made_at, self._count = None, 0

    @property
    def kept(self) -> Kept | None:
        """All that the next solution depends on besides its first guess; None: on nothing."""
        if self._made_at is None:
            return None
        steps, changes, curvature = (a[: self._count].copy() for a in self._pairs)
        return Kept(self._made_at, self._held, steps, changes, curvature)

    def remember(self, kept: Kept | None) -> None:
        """Let the next solution be, to the last bit, what it was where `kept` comes from.

        A factorisation cannot be taken along: it is made again in the same place, once it is needed.
        """
        self.forget()
        if kept is not None:
            self._made_at, self._held, self._owed = kept.made_at, kept.held, True
            self._count = len(kept.curvature)
            for mine, theirs in zip(self._pairs, (kept.steps, kept.changes, kept.curvature), strict=True):
                mine[: self._count] = theirs

    def factorize(self, u: Array, held: Bools | None = None) -> None:
        """Factorise the tangent at u, shifted until it is positive definite (then the step only descends).

        held: which of the bed's unknowns count as pressed into it, see FlapModel.tangent.
        """
        self.forget()
        values = self.model.tangent(u, held)
        shift = 0.0
        for _ in range(MOST_SHIFTS):
            try:
                self.counts["factorisations"] += 1
                self.factor.factorize(values)
                self._made_at, self._held, self._owed = u.copy(), held, False
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

    def solve(self, u: Array, before: Array | None = None) -> tuple[Array, Array]:
        """Equilibrium near u, whose prescribed unknowns stay as they are.

        before: (n,) m, an equilibrium from where u was guessed: what lay on the bed then is first thought to
        stay there.
        Returns u (n,) m and the forces (n,) N that hold the prescribed nodes. Raises Diverged.
        """
        free, tolerance = self.model.free, self._tolerance
        u = u.copy()
        energy, force = self.model.residual(u)
        if not np.isfinite(energy):
            raise Diverged("the first guess turns elements inside out")
        norm = descent.norm(force, free)
        if before is not None and (held := self.model.on_bed(before) > self.model.on_bed(u)).any():
            u, energy, force = self._laid_down(u, energy, force, held)
            norm = descent.norm(force, free)
        self._fresh = False
        self._ready(u)
        for _ in range(self.max_iterations):
            self.counts["iterations"] += 1
            step, slope = self._descent(force)
            length = 1.0
            while True:
                trial = descent.moved(u, free, step, length)
                trial_energy, trial_force = self.model.residual(trial)
                trial_norm = descent.norm(trial_force, free)
                sound = math.isfinite(trial_energy)
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
            self._count = descent.learn(step, length, force, trial_force, free, *self._pairs, self._count)
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

    def _laid_down(self, u: Array, energy: float, force: Array, held: Bools) -> tuple[Array, float, Array]:
        """One step with the bed holding what a guess has lifted from it, where that lowers the energy.

        A flap off its bed hangs on nothing but the jaws, and Newton's step from there overshoots a
        hundredfold.
        Returns u, its energy and its forces.
        """
        self.factorize(u, held)
        pulled = self.model.pulled(u, force, held)
        step, slope = self._descent(pulled)
        trial = descent.moved(u, self.model.free, step, 1.0)
        trial_energy, trial_force = self.model.residual(trial)
        # twice what the step is expected to gain: it may turn tissue so far that it is stretched first
        sound = trial_energy <= energy - slope
        return (trial, trial_energy, trial_force) if sound else (u, energy, force)

    def _ready(self, u: Array) -> None:
        """See to it that there is a factorisation: the one that was kept, or else one at u."""
        if self._made_at is None:
            self.factorize(u)
        elif self._owed:
            count = self._count
            self.factorize(self._made_at, self._held)
            self._count, self._fresh = count, False

    def _descent(self, force: Array) -> tuple[Array, float]:
        """The step (f,) m from the tangent's inverse applied to force, as factorised, corrected by the steps
        since; and the force's power on it, J."""
        free, pairs, count = self.model.free, self._pairs, self._count
        descent.before_solving(force, free, *pairs, count, self._weights, self._q)
        step = self.factor.solve(self._q)
        return step, descent.after_solving(step, force, free, *pairs, count, self._weights)
