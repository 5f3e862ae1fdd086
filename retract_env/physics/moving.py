"""Finite elements that move: what the quasi-static physics leaves out, vibration and inertia."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.dynamics import Motion, MovingFlap
from retract_env.fem.model import FlapModel
from retract_env.grasp import to_jaws
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics

Array = NDArray[np.float64]

CANTILEVER, CLAMPED = 1.8751040687**2, 4.7300407449**2
"""First roots, squared, of cos x cosh x = -1 and 1: beams that are held at one end, and at both."""
SHORTEST_STEP = 1 / 16
"""Part of a step of time below which it is not cut any further."""


class MovingFem(FemPhysics):
    """A flap between two jaws that hold it by their separation, at rest until `begin` is called."""

    flap: ClassVar[type[FlapModel]] = MovingFlap

    @property
    def period(self) -> float:
        """s, of the slowest vibration, of straight beams without veins: the part that hangs free, held by the
        jaws, or the one between jaws and fixed end. At the end of a retraction a free part takes a fifth
        longer, an inner one that is stretched down to half as long."""
        tissue = self.scene.tissue
        free, inner = max(tissue.length + self.jaw_x, tissue.height), max(-self.jaw_x, tissue.height)
        beam = np.sqrt(tissue.modulus / (12 * tissue.density)) * tissue.height
        return float(2 * np.pi / (beam * min(CANTILEVER / free**2, CLAMPED / inner**2)))

    def begin(self, damping: float) -> None:
        """Let time pass from now on, the tissue being at rest.

        damping: of the slowest vibration, over the critical one; by a drag in proportion to mass and
        velocity, which also slows, by less than a twentieth of the weight, what the jaws carry along at less
        than 50 mm/s.
        """
        assert isinstance(self.model, MovingFlap)
        self._motion, self._step = Motion(self.model, 4 * np.pi * damping / self.period), 0.0

    def advance(self, pose: Array, step: float, progress: float) -> TissueState:
        """Let the jaws go straight to a pose (4,) x, y, theta, separation, in so many s; the state then.

        Raises Diverged where not even steps of `SHORTEST_STEP` of it are solved.
        """
        start, done, part = self._pose, 0.0, 1.0
        while done < 1:
            share = min(part, 1 - done)
            try:
                self._pass(start + (done + share) * (pose - start), share * step)
            except Diverged:
                part /= 2
                if part < SHORTEST_STEP:
                    raise
            else:
                done += share
        self._progress = progress
        return self.state()

    def _pass(self, pose: Array, step: float) -> None:
        if step != self._step:
            self.equilibrium.forget()  # another tangent
            self._step = step
        jaws, guess = to_jaws(pose), self._motion.predict(self._u, step)
        self.model.place_jaws(guess, jaws)
        if not np.isfinite(self.model.residual(guess)[0]):
            guess = self._u.copy()
            self.model.place_jaws(guess, jaws)
        u, force = self.equilibrium.solve(guess)
        self._motion.arrived(u, step)
        self._u, self._force, self._pose = u, force, pose
