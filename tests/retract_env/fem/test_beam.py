"""The beam's first guess: what holds for any motion of the jaws, and that it is worth having."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.fem.beam import BeamGuess
from retract_env.grasp import to_jaws
from retract_env.mesh import Resolution
from retract_env.physics.fem import FemPhysics
from tests.planners.retractions import a_grasp, a_scene, veined

Array = NDArray[np.float64]

MESH = Resolution("test", patch=2, edge=0.2, growth=0.7, bulk=0.9)
MOTIONS = [(2e-3, 1e-3, -0.1), (-1e-3, 2e-3, 0.1), (0.0, 4e-3, -0.4), (0.0, 0.0, 0.2), (3e-3, 0.0, 0.0)]
"""m, m, rad"""
every_motion = pytest.mark.parametrize("motion", MOTIONS)


class Held:
    """A flap in the closed jaws, and the guess for it."""

    def __init__(self) -> None:
        scene, grasp = veined(), a_grasp(-0.03)
        self.physics = FemPhysics(scene, grasp.x, MESH)
        self.physics.reset()
        height = scene.tissue.height
        self.pose = np.array([grasp.x, height / 2, 0.0, height - grasp.compression])
        self.physics.move_to(self.pose)
        self.model = self.physics.model
        self.guess = BeamGuess(self.model.prism, scene, grasp.x)
        self.u = self.physics._u
        self.rest = self.model.section.points

    def moved(self, motion: tuple[float, float, float]) -> tuple[Array, Array]:
        """The pose after the motion, and the guess for it."""
        pose = self.pose + np.array([*motion, 0.0])
        return pose, self.guess.moved(self.u, self.pose, pose)


@pytest.fixture(scope="module")
def held() -> Held:
    return Held()


def test_jaws_that_stay_leave_everything_in_place(held: Held) -> None:
    _, u = held.moved((0.0, 0.0, 0.0))
    assert u == pytest.approx(held.u, abs=1e-15)


@every_motion
def test_the_fixed_end_stays_and_the_patches_go_with_the_jaws(
    held: Held, motion: tuple[float, float, float]
) -> None:
    pose, u = held.moved(motion)
    expected = held.u.copy()
    held.model.place_jaws(expected, to_jaws(pose))
    for where in (held.model.driven, held.model.fixed):
        assert u[where] == pytest.approx(expected[where], abs=1e-9)


@every_motion
def test_beyond_the_jaws_the_flap_is_rigid(held: Held, motion: tuple[float, float, float]) -> None:
    _, u = held.moved(motion)
    for level in range(held.model.prism.levels):
        free = held.rest[:, 0] < -0.031
        before, after = held.model.positions(held.u, level)[free], held.model.positions(u, level)[free]
        for k in (0, len(before) // 2):
            distance = np.hypot(*(before - before[k]).T)
            assert np.hypot(*(after - after[k]).T) == pytest.approx(distance, abs=1e-12)


def test_a_flap_that_turns_as_a_whole_is_not_strained() -> None:
    """Jaws that turn about the fixed end: the guess bends there and is rigid elsewhere to second order."""
    physics = FemPhysics(a_scene(bed=False, gravity=0.0), -0.03, MESH)
    guess = BeamGuess(physics.model.prism, physics.scene, -0.03)
    pose = np.array([-0.03, 0.0022, 0.0, 0.0044])
    energies = []
    for turn in (-0.02, -0.04):
        arc = np.array(
            [-0.03 * math.sin(turn) / turn, 0.0022 + 0.03 * (math.cos(turn) - 1) / turn, turn, 0.0044]
        )
        u = guess.moved(np.zeros(physics.model.prism.size), pose, arc)
        energies.append(physics.model.residual(u)[0])
        bend = 0.5 * 40e3 * 0.0044 * 0.0044**3 / 12 / 2 * turn**2 / 0.03  # half the depth
        # plane sections that keep their width are stiffer than a beam: (1 - nu) / (1 + nu) / (1 - 2 nu)
        assert bend < energies[-1] < bend * 0.55 / 1.45 / 0.1 * 1.1
    assert energies[1] == pytest.approx(4 * energies[0], rel=0.01)


@pytest.mark.parametrize("motion", MOTIONS[:3])
def test_its_energy_is_far_below_that_of_moving_the_patches_alone(
    held: Held, motion: tuple[float, float, float]
) -> None:
    pose, u = held.moved(motion)
    alone = held.u.copy()
    held.model.place_jaws(alone, to_jaws(pose))
    rest = held.model.residual(held.u)[0]
    straight = held.model.residual(alone)[0]
    assert held.model.residual(u)[0] - rest < 0.1 * (straight - rest)
