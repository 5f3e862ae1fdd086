"""An old factorisation, turned with the tissue: exact for what turns as a whole."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from baselines.verification.flaps import flap
from retract_env.fem import descent
from retract_env.fem.model import FlapModel
from retract_env.mesh import Resolution, section_mesh

Array = NDArray[np.float64]

MESH = Resolution("test", patch=2, edge=0.2, growth=0.7, bulk=0.9)
GRASP, TURN = -0.014, 0.7


@pytest.fixture(scope="module")
def model() -> FlapModel:
    scene = flap(length=0.025, bed=False, depth=0.012)
    return FlapModel(scene, section_mesh(scene, GRASP, MESH), GRASP)


def bent(model: FlapModel) -> Array:
    """Displacements (n,) m of a shape that is strained, unevenly."""
    u = np.random.default_rng(0).normal(scale=2e-5, size=model.prism.size)
    for level in range(model.prism.levels):
        x, y = model.section.points.T
        model.prism.in_plane(u, level)[:] += np.stack([8 * x * y, 3 * x**2], axis=-1)
    return u


def turned(model: FlapModel, u: Array, angle: float) -> Array:
    """The same shape, turned as a whole."""
    cos, sin = np.cos(angle), np.sin(angle)
    out = u.copy()
    for level in range(model.prism.levels):
        at = model.positions(u, level) @ np.array([[cos, sin], [-sin, cos]])
        model.prism.in_plane(out, level)[:] = at - model.section.points
    return out


def tangent(model: FlapModel, u: Array) -> Array:
    n = len(model.free)
    upper = csr_matrix(
        (model.tangent(u), model.assembly.indices, model.assembly.indptr), shape=(n, n)
    ).toarray()
    return upper + np.triu(upper, 1).T


@pytest.mark.parametrize("angle", [TURN, -2.5, 0.0])
def test_a_shape_that_turns_as_a_whole_turns_everywhere_by_that_angle(model: FlapModel, angle: float) -> None:
    u = bent(model)
    at, cos, sin = model.turned(u, turned(model, u, angle))
    assert np.arctan2(sin, cos) == pytest.approx(np.full(len(at), angle), abs=1e-9)


def test_between_two_shapes_and_back_nothing_has_turned(model: FlapModel) -> None:
    u, v = bent(model), turned(model, 2 * bent(model), TURN)
    _, cos, sin = model.turned(u, v)
    _, cos_back, sin_back = model.turned(v, u)
    assert cos == pytest.approx(cos_back) and sin == pytest.approx(-sin_back)
    assert sin.std() > 1e-3


def test_the_stiffness_turns_with_the_tissue(model: FlapModel) -> None:
    """K(R u) = R K(u) R^T, whatever strain there is."""
    u = bent(model)
    v = turned(model, u, TURN)
    turn = model.turned(u, v)
    step = np.random.default_rng(1).normal(size=len(model.free))
    expected = tangent(model, v) @ step
    found = step.copy()
    descent.turned_back(found, turn)
    found = tangent(model, u) @ found
    descent.turned(found, turn)
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_turning_back_undoes_it_and_keeps_lengths(model: FlapModel) -> None:
    u = bent(model)
    turn = model.turned(u, turned(model, 2 * u, TURN))
    before = np.random.default_rng(2).normal(size=len(model.free))
    q = before.copy()
    descent.turned(q, turn)
    assert np.linalg.norm(q) == pytest.approx(np.linalg.norm(before))
    assert np.abs(q - before).max() > 0.1
    descent.turned_back(q, turn)
    assert q == pytest.approx(before)
