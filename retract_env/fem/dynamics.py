"""The flap with inertia: Newmark's method, each step of which is an equilibrium of one more potential.

With accelerations a' = (u' - u*) / (beta dt^2), where u* = u + dt v + (1/2 - beta) dt^2 a, and velocities
v' = v + dt (1 - gamma) a + dt gamma a', the next displacements u' make

    Pi(u') + M a' + alpha M v' = 0,  or  Pi(u') + (u' - s) . K (u' - s) / 2  stationary

for a diagonal K and a place s that are known before, so that Newton's method finds them as it does an
equilibrium (Newmark 1959; Kane, Marsden, Ortiz and West 2000). Masses are lumped, drag is proportional to
them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.model import FlapModel

Array = NDArray[np.float64]

GAMMA = 0.6
"""Above 1/2, so that vibrations which no step resolves die away: one of n steps a period is damped by
pi (GAMMA - 1/2) / n of the critical damping."""
BETA = (GAMMA + 0.5) ** 2 / 4


class MovingFlap(FlapModel):
    """A flap on which inertia acts from the first `carry_on`."""

    spring: Array | None = None
    """(n,) N/m, K; None where inertia does not count"""
    place: Array
    """(n,) m, s"""

    @property
    def mass(self) -> Array:
        """(n,) kg, of each unknown that is free, over half the depth; 0 of others."""
        prism = self.prism
        out = np.zeros(prism.size)
        share = self.scene.tissue.density * prism.depth_weight[:, None] * prism.area
        nodes, every = np.arange(len(self.section.points)), np.arange(prism.levels)
        out[prism.x(nodes, every)] = out[prism.y(nodes, every)] = share.ravel()
        out[prism.w(nodes, every[1:])] = share[1:].ravel()
        out[self.fixed] = out[self.driven] = 0.0
        return out

    def carry_on(self, spring: Array, place: Array) -> None:
        """Let springs (n,) N/m pull towards a place (n,) m."""
        self.spring, self.place = spring, place

    def residual(self, u: Array) -> tuple[float, Array]:
        energy, force = super().residual(u)
        if self.spring is not None:
            pull = self.spring * (u - self.place)
            energy += float(pull @ (u - self.place)) / 2
            force += pull
        return energy, force

    def tangent(self, u: Array, held: NDArray[np.bool_] | None = None) -> Array:
        values = super().tangent(u, held)
        if self.spring is not None:
            values[self.assembly.indptr[:-1]] += self.spring[self.free]
        return values

    def tangent_times(self, u: Array, v: Array) -> Array:
        out = super().tangent_times(u, v)
        return out if self.spring is None else out + self.spring * v


class Motion:
    """Velocity and acceleration of a flap, (n,) m/s and m/s^2, step after step."""

    def __init__(self, model: MovingFlap, drag: float = 0.0):
        """drag: 1/s, alpha, of the mass."""
        self.model, self.drag = model, drag
        self.velocity, self.acceleration = np.zeros((2, model.prism.size))
        self._mass = model.mass

    def predict(self, u: Array, step: float) -> Array:
        """Prepare the model for a step of so many s from u (n,) m; returns where it leads to without any
        change of acceleration."""
        inert, dragged = BETA * step**2, 1 + self.drag * GAMMA * step
        self._ahead = u + step * (self.velocity + (0.5 - BETA) * step * self.acceleration)
        slowed = self.drag * inert / dragged * (self.velocity + (1 - GAMMA) * step * self.acceleration)
        self.model.carry_on(self._mass * (dragged / inert), self._ahead - slowed)
        return u + step * (self.velocity + step / 2 * self.acceleration)

    def arrived(self, u: Array, step: float) -> None:
        """That step has led to u (n,) m."""
        acceleration = (u - self._ahead) / (BETA * step**2)
        self.velocity = self.velocity + step * ((1 - GAMMA) * self.acceleration + GAMMA * acceleration)
        self.acceleration = acceleration
