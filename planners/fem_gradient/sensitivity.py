"""How strain, jaw forces and clearance of a flap change with the jaws' pose: the implicit function theorem.

A flap in equilibrium depends on nothing but the pose of its jaws. Where the jaws move by dp, the nodes that
they hold move by du_d = P dp, and all others so that equilibrium stays: K_ff du_f = -K_fd du_d, with K the
tangent at the equilibrium. The pose has four components, so four right-hand sides on one factorisation give
every derivative there is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.solver import Equilibrium
from retract_env.grasp import to_jaws
from retract_env.physics.fem import FemPhysics

Array = NDArray[np.float64]

TURN = 1e-5
"""How far the jaws are turned, rad, and moved, over the height, to see how the nodes that they hold move. The
error of these central differences is 1e-11 of the result."""
NUDGE = 1e-6
"""The farthest that nodes are moved, over the height, to see how strain changes. Strain is a smooth function
of the displacements, except where they change which 1 % of the volume is strained most."""
REFINED = 2
"""Solutions with a factorisation, each of what the ones before have left."""
SMALLEST_PART = 1 / 16
"""Part of a step of the jaws below which it is not cut any further."""


@dataclass(frozen=True)
class Response:
    """A flap in equilibrium with its jaws, and its derivatives by the pose x, y, theta, separation."""

    pose: Array
    """(4,)"""
    u: Array
    """(n,) m"""
    slope: Array
    """(n, 4), of u"""
    strains: Array
    """(m,) where strain is measured, in the volumes that `Sensitivity.volumes` lists"""
    strains_slope: Array
    """(m, 4)"""
    forces: Array
    """(2, 2) N, the tissue on the lower and the upper jaw: along the patch, and pressing on it"""
    forces_slope: Array
    """(2, 2, 4)"""
    clearances: Array
    """(k,) m, signed distance of every node to the line of sight"""
    clearances_slope: Array
    """(k, 4)"""


@dataclass(frozen=True)
class LinearStrain:
    """How points of one pose are strained, to first order in some q unknowns."""

    strain: Array
    """(p,) in any unit"""
    slope: Array
    """(p, q)"""
    volume: Array
    """(p,) over the volume that eps_1% counts"""

    def worst(self, step: Array) -> tuple[float, float, Array]:
        """eps_1% after a step (q,) of the unknowns, and the weighted mean that it is there: its constant and
        its slope (q,). Elsewhere this mean is at most eps_1%, the greatest of all such means."""
        strain = self.strain + self.slope @ step
        order = np.argsort(strain)[::-1]
        volume = self.volume[order]
        share = np.empty(len(order))
        share[order] = np.clip(1 - np.cumsum(volume) + volume, 0.0, volume)
        return float(share @ strain), float(share @ self.strain), share @ self.slope


class Sensitivity:
    """Equilibria of one flap, with derivatives, near equilibria that are known."""

    def __init__(self, physics: FemPhysics):
        """physics: whose model and mesh are used; its own state is left alone."""
        self.scene, self.model = physics.scene, physics.model
        self._equilibrium = Equilibrium(self.model)
        blocks = self.model.assembly.blocks
        self.volumes = np.concatenate([b.measured.ravel() for b in blocks])
        """(m,) m^3, of half the depth"""

    @property
    def iterations(self) -> int:
        """Newton iterations so far."""
        return self._equilibrium.counts["iterations"]

    def at(self, pose: Array, near: Response) -> Response:
        """The response at a pose (4,), from one nearby. Raises Diverged."""
        done, part = 0.0, 1.0
        start, step = near.pose, pose - near.pose
        while done < 1:
            share = min(done + part, 1.0)
            goal = start + share * step
            guess = near.u + near.slope @ (goal - near.pose)
            try:
                near, done = self.settled(goal, guess), share
            except Diverged:
                part /= 2
                if part < SMALLEST_PART:
                    raise
        return near

    def settled(self, pose: Array, u: Array) -> Response:
        """The response at a pose (4,), from displacements (n,) m near equilibrium. Raises Diverged."""
        model, equilibrium = self.model, self._equilibrium
        u = u.copy()
        model.place_jaws(u, to_jaws(pose))
        equilibrium.forget()
        u, force = equilibrium.solve(u)
        shifts = equilibrium.counts["shifts"]
        equilibrium.factorize(u)
        if equilibrium.counts["shifts"] > shifts:
            raise Diverged("the equilibrium is not stable")
        # with the tangent at hand, one more step takes the error far below the solver's tolerance, another
        # one below what the factorisation leaves, which is of single precision
        for _ in range(REFINED):
            u[model.free] -= equilibrium.factor.solve(force[model.free])
            force = model.residual(u)[1]
        slope = self._driven_slope(pose)
        for _ in range(REFINED):
            pulled = np.stack([model.tangent_times(u, column) for column in slope.T], axis=1)
            slope[model.free] -= equilibrium.factor.solve(pulled[model.free])
        forces, forces_slope = self._forces(pose[2], force, u, slope)
        return Response(
            pose,
            u,
            slope,
            self._strains(u),
            self._strains_slope(u, slope),
            forces,
            forces_slope,
            *self._clearances(u, slope),
        )

    def _driven_slope(self, pose: Array) -> Array:
        """(n, 4): how the nodes between the jaws move with the pose; 0 for all others."""
        steps = TURN * np.array([*[self.scene.tissue.height] * 2, 1.0, self.scene.tissue.height])
        slope = np.zeros((self.model.prism.size, 4))
        for k, h in enumerate(steps):
            for sign in (1, -1):
                moved = np.zeros(len(slope))
                self.model.place_jaws(moved, to_jaws(pose + sign * h * np.eye(4)[k]))
                slope[:, k] += sign * moved / (2 * h)
        return slope

    def _forces(self, theta: float, force: Array, u: Array, slope: Array) -> tuple[Array, Array]:
        """Forces (2, 2) N along the patches and pressing on them, and their derivatives (2, 2, 4)."""
        axis, along = np.array([-np.sin(theta), np.cos(theta)]), np.array([np.cos(theta), np.sin(theta)])
        # from each jaw into the tissue points `axis` at the lower and -`axis` at the upper one
        frames = np.array([[along, -axis], [along, axis]])
        turned = np.array([[axis, along], [axis, -along]])
        reactions = self.model.reactions(force)
        changes = [self.model.reactions(self.model.tangent_times(u, column)) for column in slope.T]
        out = np.einsum("jfi,ji->jf", frames, reactions)
        out_slope = np.einsum("jfi,pji->jfp", frames, np.array(changes))
        out_slope[:, :, 2] += np.einsum("jfi,ji->jf", turned, reactions)
        return out, out_slope

    def _strains(self, u: Array) -> Array:
        return np.concatenate([s.ravel() for s in self.model.assembly.strains(u)])

    def _strains_slope(self, u: Array, slope: Array) -> Array:
        """(m, 4), by central differences along the columns of slope (n, 4)."""
        out = np.empty((len(self.volumes), 4))
        for k, column in enumerate(slope.T):
            h = NUDGE * self.scene.tissue.height / float(np.abs(column).max())
            out[:, k] = (self._strains(u + h * column) - self._strains(u - h * column)) / (2 * h)
        return out

    def _clearances(self, u: Array, slope: Array) -> tuple[Array, Array]:
        """(k,) m and (k, 4): how far the nodes are above the line, as `objectives.clearance` has it."""
        line, model = self.scene.line_of_sight, self.model
        target = np.array(line.target)
        along = (np.array(line.camera) - target) / np.hypot(*(np.array(line.camera) - target))
        across = np.array([along[1], -along[0]])
        levels = range(model.prism.levels)
        away = np.concatenate([model.positions(u, k) for k in levels]) - target
        moved = [
            np.concatenate([model.positions(column, k) - model.section.points for k in levels])
            for column in slope.T
        ]
        return away @ across, np.stack([m @ across for m in moved], axis=1)
