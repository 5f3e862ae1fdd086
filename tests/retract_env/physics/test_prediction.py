"""Linearised statics of a flap of tetrahedra: where it goes as its held nodes move."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.bodies import relax
from baselines.verification.flaps import HEIGHT, LENGTH, flap
from retract_env.physics.bullet.prediction import Prediction
from retract_env.physics.bullet.tetmesh import tet_mesh
from retract_env.physics.measures import TetrahedralFlap

Array = NDArray[np.float64]

X = -0.025


class Held:
    """A coarse flap under its weight, held at x = 0 and under the jaws."""

    def __init__(self, bed: bool):
        scene = flap(bed=bed)
        self.mesh = tet_mesh(scene, X, 0.8, 2, 1)
        self.body = TetrahedralFlap(scene, self.mesh)
        mass = 1000 * LENGTH * HEIGHT * scene.tissue.depth / len(self.mesh.points)
        self.load = np.zeros_like(self.mesh.points)
        self.load[:, 1] = -mass * scene.gravity
        self.predict = Prediction(self.body, self.load, bed)

    def moved(self, points: Array, x: float, y: float, turn: float) -> Array:
        """points (n, 3) with the jaws' nodes moved, m, and turned about the middle of the grasp, rad."""
        out = points.copy()
        nodes = np.concatenate(self.mesh.patches)
        centre = points[nodes, :2].mean(axis=0)
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        out[nodes, :2] = centre + (x, y) + (points[nodes, :2] - centre) @ rotation
        return out

    def at_rest(self, points: Array) -> Array:
        """Equilibrium (n, 3) m with the held nodes where they are, without a bed."""
        u = (points - self.mesh.points).ravel()
        return self.mesh.points + relax(self.body.assembly, u, self.load.ravel())[0].reshape(-1, 3)


@pytest.fixture(scope="module")
def hanging() -> tuple[Held, Array]:
    held = Held(bed=False)
    return held, held.at_rest(held.mesh.points)


def test_in_equilibrium_nothing_moves(hanging: tuple[Held, Array]) -> None:
    held, points = hanging
    assert np.abs(held.predict(points, points) - points).max() < 1e-12


def test_the_error_is_quadratic_in_the_move(hanging: tuple[Held, Array]) -> None:
    held, points = hanging
    errors = []
    for part in (1.0, 0.5, 0.25):
        target = held.moved(points, part * 4e-4, part * 1e-3, -part * 0.05)
        predicted = held.predict(points, target)
        errors.append(np.abs(predicted - held.at_rest(predicted)).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.25)
    # half a stride ends nearer than a tenth of it
    assert errors[0] < 1e-4


def test_held_nodes_go_where_they_are_told(hanging: tuple[Held, Array]) -> None:
    held, points = hanging
    target = held.moved(points, 1e-3, 0.0, 0.05)
    assert np.array_equal(held.predict(points, target)[held.body.held], target[held.body.held])


def test_what_lies_on_the_bed_stays_there_and_the_rest_lifts_off() -> None:
    held = Held(bed=True)
    points = held.mesh.points
    for _ in range(4):
        points = held.predict(points, held.moved(points, 0.0, 1e-3, 0.03))
    lower = points[held.mesh.points[:, 1] == 0]
    assert lower[:, 1].min() > -1e-6
    # lifted at its middle by nearly its height the flap still lies on its free end, and hangs free between
    assert np.abs(lower[lower[:, 0] < -0.95 * LENGTH, 1]).max() < 1e-6
    assert lower[np.abs(lower[:, 0] - X) < 0.2 * LENGTH, 1].min() > 1e-3


def test_a_flap_that_would_buckle_is_predicted_all_the_same(hanging: tuple[Held, Array]) -> None:
    held, points = hanging
    pushed = points
    for _ in range(8):  # towards the fixed end, by a quarter of what lies between
        pushed = held.predict(pushed, held.moved(pushed, 8e-4, 0.0, 0.0))
    energy, _ = held.body.assembly.residual((pushed - held.mesh.points).ravel())
    assert np.isfinite(energy)


def test_where_nothing_is_found_only_the_held_nodes_move(hanging: tuple[Held, Array]) -> None:
    held, points = hanging
    target = held.moved(points, 0.0, 0.0, np.pi)
    assert held.predict(points, target) is target
