"""The motion of `benchmarks._rods` by PyElastica (MIT): dynamics, damped to rest."""

from __future__ import annotations

from typing import Any

import elastica
import numpy as np
from numba import njit

from benchmarks._rods import BED, BEND, LENGTH, SHEAR, STRETCH, WEIGHT, Array, Motion, Shapes

STEPS = 10
"""of an advance"""


class Simulator(
    elastica.BaseSystemCollection,  # type: ignore[misc]
    elastica.Constraints,  # type: ignore[misc]
    elastica.Forcing,  # type: ignore[misc]
    elastica.Damping,  # type: ignore[misc]
):
    """Rods side by side in one block."""


class Ends:
    """Where the first and last two nodes of a rod, and its first and last cross-section, are held."""

    nodes: Array
    """(3, 4)"""
    directors: Array
    """(3, 3, 2)"""


class Clamps(elastica.ConstraintBase):  # type: ignore[misc]
    """Holds them there."""

    def __init__(self, *places: Any, ends: Ends, **keywords: Any) -> None:
        super().__init__(*places, **keywords)
        self.ends = ends

    def constrain_values(self, system: Any, time: float) -> None:  # noqa: ARG002, asked for
        system.position_collection[:, :2] = self.ends.nodes[:, :2]
        system.position_collection[:, -2:] = self.ends.nodes[:, 2:]
        system.director_collection[:, :, 0] = self.ends.directors[:, :, 0]
        system.director_collection[:, :, -1] = self.ends.directors[:, :, 1]

    def constrain_rates(self, system: Any, time: float) -> None:  # noqa: ARG002, asked for
        system.velocity_collection[:, :2] = 0
        system.velocity_collection[:, -2:] = 0
        system.omega_collection[:, 0] = 0
        system.omega_collection[:, -1] = 0


@njit(cache=True)
def push(nodes: Array, directors: Array, forces: Array, torques: Array, stiffness: float) -> None:
    """The bed's forces on nodes and torques on the sections beside them, as in `mechanics.contact`."""
    for k in range(2, nodes.shape[1] - 2):
        c = directors[2, 0, k - 1] + directors[2, 0, k]
        s = directors[2, 1, k - 1] + directors[2, 1, k]
        scale = 0.5 / np.sqrt(c * c + s * s)
        deep = scale * c - nodes[1, k]
        if deep > 0:
            forces[1, k] += stiffness * deep
            torques[0, k - 1] += 0.5 * stiffness * deep * scale * s
            torques[0, k] += 0.5 * stiffness * deep * scale * s


class Bed(elastica.NoForces):  # type: ignore[misc]
    """The bed y = 0."""

    def __init__(self, stiffness: float) -> None:
        super().__init__()
        self.stiffness = stiffness

    def apply_forces(self, system: Any, time: float = 0.0) -> None:  # noqa: ARG002
        push(
            system.position_collection,
            system.director_collection,
            system.external_forces,
            system.external_torques,
            self.stiffness,
        )


class PyElastica:
    """Cosserat rods with the flap's stiffness and, as inertia does not matter at rest, unit mass per length.

    cfl: time step, in times in which sound runs along an element; damping: decay rate of all velocities.
    """

    def __init__(self, motion: Motion, cfl: float, damping: float) -> None:
        length, count = LENGTH / motion.elements, motion.elements + 1
        self.step = cfl * length
        self.simulator, self.rods, self.ends = Simulator(), [], []
        for _ in range(motion.flaps):
            rod = elastica.CosseratRod.straight_rod(
                count,
                np.array([-LENGTH - length / 2, 0.5, 0.0]),
                np.array([1.0, 0.0, 0.0]),
                np.array([0.0, 0.0, 1.0]),
                count * length,
                1 / np.sqrt(np.pi),
                1.0,
                youngs_modulus=1.0,
            )
            for k, stiffness in enumerate((SHEAR, SHEAR, STRETCH)):
                rod.shear_matrix[k, k] = stiffness
                rod.bend_matrix[k, k] = BEND
            ends = Ends()
            self.simulator.append(rod)
            self.simulator.constrain(rod).using(
                Clamps, ends=ends, constrained_position_idx=(0, 1, -2, -1), constrained_director_idx=(0, -1)
            )
            self.simulator.add_forcing_to(rod).using(
                elastica.GravityForces, acc_gravity=np.array([0.0, -WEIGHT, 0.0])
            )
            self.simulator.add_forcing_to(rod).using(Bed, stiffness=BED * length)
            self.simulator.dampen(rod).using(
                elastica.AnalyticalLinearDamper, uniform_damping_constant=damping, time_step=self.step
            )
            self.rods.append(rod)
            self.ends.append(ends)
        self.place(Shapes.straight(motion))
        self.simulator.finalize()
        self.stepper = elastica.PositionVerlet()

    def place(self, shapes: Shapes) -> None:
        for rod, ends, nodes, angles in zip(self.rods, self.ends, shapes.nodes, shapes.angles, strict=True):
            s, c = np.sin(angles), np.cos(angles)
            rod.position_collection[:2] = nodes.T
            rod.director_collection[1, 0], rod.director_collection[1, 1] = s, -c
            rod.director_collection[2, 0], rod.director_collection[2, 1] = c, s
            ends.nodes = rod.position_collection[:, [0, 1, -2, -1]]
            ends.directors = rod.director_collection[:, :, [0, -1]]
            rod.velocity_collection[:] = 0
            rod.omega_collection[:] = 0

    def advance(self) -> None:
        now = 0.0
        for _ in range(STEPS):
            now = self.stepper.step(self.simulator, now, self.step)

    def shapes(self) -> Shapes:
        angles = [
            np.arctan2(rod.director_collection[2, 1], rod.director_collection[2, 0]) for rod in self.rods
        ]
        nodes = np.array([rod.position_collection[:2].T for rod in self.rods])
        return Shapes(nodes, np.unwrap(np.array(angles)[:, ::-1])[:, ::-1])
