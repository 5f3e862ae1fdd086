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

CANTILEVER = 1.8751040687**2
"""First root of cos x cosh x = -1, squared."""
SHORTEST_STEP = 1 / 16
"""Part of a step of time below which it is not cut any further."""


class MovingFem(FemPhysics):
    """A flap between two jaws that hold it by their separation, at rest until `begin` is called."""

    flap: ClassVar[type[FlapModel]] = MovingFlap

    def begin(self, damping: float) -> None:
        """Let time pass from now on, the tissue being at rest.

        damping: of the free part's first vibration, as a beam that the jaws hold, over the critical one.
        """
        assert isinstance(self.model, MovingFlap)
        tissue = self.scene.tissue
        free = max(tissue.length + self.jaw_x, tissue.height)
        slowest = CANTILEVER * np.sqrt(tissue.modulus / (12 * tissue.density)) * tissue.height / free**2
        self._motion, self._step = Motion(self.model, 2 * damping * slowest), 0.0

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
        jaws, guess = to_jaws(pose), self._motion.carry_on(self._u, step)
        self.model.place_jaws(guess, jaws)
        if not np.isfinite(self.model.residual(guess)[0]):
            guess = self._u.copy()
            self.model.place_jaws(guess, jaws)
        u, force = self.equilibrium.solve(guess)
        self._motion.arrived(u, step)
        self._u, self._force, self._pose = u, force, pose
