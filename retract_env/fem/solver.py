"""Equilibrium of a flap for given jaws: Newton's method that factorises as seldom as it can.

Between factorisations the last one is corrected by the steps taken since (L-BFGS, Nocedal and Wright 2006,
algorithm 7.4). And it is turned with the tissue: what turns as a whole, u to R u, keeps its stiffness in a
frame that turns with it, K(R u) = R K(u) R^T, and a flap that is lifted does little but turn, each part of it
by its own angle. So one factorisation serves several iterations and often several increments.
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
Ints = NDArray[np.int32]

STRAIN_TOLERANCE = 1e-5
"""Newton stops once the error's energy is below that of this strain in 1 % of the flap's volume."""
MOST_SHIFTS = 20
"""Tries to make a tangent positive definite, each with ten times the shift of the one before."""
FIRST_SHIFT = 1e-2
"""Over the mean of the diagonal."""
MOST_ITERATIONS = 40
"""For one equilibrium; most take less than 10. Better a smaller step than more of them, which may lead to an
equilibrium far away."""
SLOW = 0.85
"""An iteration that leaves more than this part of the residual is followed by a new factorisation, which
takes as long as five. Certificates at fine need 10 % less work than with 0.7, and 20 % less than with 0.5."""
SLOW_OFF_BED, OFF_BED = 0.2, 0.02
"""The same once more than that part of the bed's unknowns has come to lie on it, or left it, since the
factorisation: steps corrected by others learn of them one by one. Counted in iterations, steps of the
environment need 5 % less work for it, certificates at fine 2 %; from a part of 0.07 on nothing is gained."""
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
    """(k, f) m, over the free unknowns, made since then, in the frames of then: they correct it"""
    changes: Array
    """(k, f) N, by which the forces changed with each"""
    curvature: Array
    """(k,) J, the product of both"""


def factorize_shifted(
    factor: Factor, values: Array, diagonal: Ints, first: float, counts: Counter[str]
) -> None:
    """Factorise a tangent's values, shifted until they are positive definite.

    diagonal: where the diagonal stands in them; first: the first shift, over its mean size; counts: of
    factorisations and shifts. Raises Diverged.
    """
    shift = 0.0
    for _ in range(MOST_SHIFTS):
        try:
            counts["factorisations"] += 1
            factor.factorize(values)
            return
        except NotPositiveDefinite:
            counts["shifts"] += 1
            grown = max(10 * shift, first * float(np.abs(values[diagonal]).mean()))
            values[diagonal] += grown - shift
            shift = grown
    raise Diverged("the tangent is not finite")


class Equilibrium:
    """Solves for the free unknowns of a model, keeping its factorisation from one call to the next."""

    def __init__(self, model: FlapModel, max_iterations: int = MOST_ITERATIONS):
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
        nowhere = np.zeros(model.assembly.size)
        self._straight = self._turn = model.turned(nowhere, nowhere)  # since the factorisation was made
        self._weights, self._q = np.empty(MEMORY), np.empty(f)
        self.counts: Counter[str] = Counter()
        self.last_work = math.inf
        """`work` after which no solution is sought any further"""
        tissue = model.scene.tissue
        half_volume = tissue.length * tissue.height * tissue.depth / 2
        self._tolerance = STRAIN_TOLERANCE**2 * tissue.modulus * WORST_FRACTION * half_volume
        self._diagonal = model.assembly.indptr[:-1]

    @property
    def work(self) -> int:
        """Iterations so far, and factorisations that some of them needed besides the one."""
        return self.counts["iterations"] + self.counts["shifts"]

    def forget(self) -> None:
        """Let the next solution begin with a factorisation of its own: it then depends on nothing that was
        solved before, not even in its last bit."""
        self._made_at, self._count = None, 0

    def forget_steps(self) -> None:
        """Keep the factorisation alone, which steps since then no longer correct."""
        self._count = 0

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
        factorize_shifted(self.factor, values, self._diagonal, FIRST_SHIFT, self.counts)
        self._made_at, self._held, self._owed = u.copy(), held, False
        self._fresh = True
        self._turn = self._straight

    def step(self, u: Array, du_driven: Array) -> Array:
        """First-order change of the free unknowns when the driven ones change by du_driven (n,), from the
        tangent at u."""
        self._ready(u)
        force = self.model.tangent_times(u, du_driven)
        du = du_driven.copy()
        pulled = force[self.model.free]
        descent.turned_back(pulled, self._turn)
        change = self.factor.solve(pulled)
        descent.turned(change, self._turn)
        du[self.model.free] = -change
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
            u, energy, force = self._laid_down(u, energy, force, held, before)
            norm = descent.norm(force, free)
        self._ready(u)
        for _ in range(self.max_iterations):
            if self.work > self.last_work:
                raise Diverged("no equilibrium in the iterations that a move may take")
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
            kept = self._turn, *self._pairs, self._count
            self._count = descent.learn(step, length, force, trial_force, free, *kept)
            u, energy, force, norm = trial, trial_energy, trial_force, trial_norm
            # -slope is twice the energy of the step; what is left after it shrinks with the square of the
            # rate
            if length == 1.0 and -slope * rate**2 < tolerance * (1 - min(rate, 0.99)) ** 2:
                return u, force
            if rate > SLOW or length < 1.0 or (rate > SLOW_OFF_BED and self._off_its_bed(u)):
                self.factorize(u)
            else:
                self._fresh = False
        raise Diverged(f"no equilibrium in {self.max_iterations} iterations")

    def _laid_down(
        self, u: Array, energy: float, force: Array, held: Bools, before: Array
    ) -> tuple[Array, float, Array]:
        """One step with the bed holding what a guess has lifted from it, where that lowers the energy.

        A flap off its bed hangs on nothing but the jaws, and Newton's step from there overshoots a
        hundredfold.
        Returns u, its energy and its forces.
        """
        if self._made_at is None:
            self.factorize(u, held)
        else:
            self._ready(before)  # what lies on the bed stands as before, however the guess turned it
        pulled = self.model.pulled(u, force, held)
        step, slope = self._descent(pulled)
        trial = descent.moved(u, self.model.free, step, 1.0)
        trial_energy, trial_force = self.model.residual(trial)
        # twice what the step is expected to gain: it may turn tissue so far that it is stretched first
        sound = trial_energy <= energy - slope
        return (trial, trial_energy, trial_force) if sound else (u, energy, force)

    def _off_its_bed(self, u: Array) -> bool:
        """Whether much of the flap lies on the bed at u that did not at the factorisation, or the reverse."""
        assert self._made_at is not None
        down = self.model.on_bed(self._made_at)
        if self._held is not None:
            down |= self._held
        return int(np.count_nonzero(down != self.model.on_bed(u))) > OFF_BED * len(down)

    def _ready(self, u: Array) -> None:
        """See to it that there is a factorisation: the one that was kept, turned to u, or else one at u."""
        if self._made_at is None:
            self.factorize(u)
            return
        if self._owed:
            count = self._count
            self.factorize(self._made_at, self._held)
            self._count = count
        self._fresh = False
        self._turn = self.model.turned(self._made_at, u)

    def _descent(self, force: Array) -> tuple[Array, float]:
        """The step (f,) m from the tangent's inverse applied to force, as factorised, corrected by the steps
        since; and the force's power on it, J."""
        free, kept = self.model.free, (self._turn, *self._pairs, self._count, self._weights)
        descent.before_solving(force, free, *kept, self._q)
        step = self.factor.solve(self._q)
        return step, descent.after_solving(step, force, free, *kept)
