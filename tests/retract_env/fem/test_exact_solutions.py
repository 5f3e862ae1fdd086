"""Homogeneous finite-strain solutions, known exactly, are found to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from baselines.verification.bodies import Body, deformation, prism_body, relax, stress
from baselines.verification.flaps import HEIGHT, flap
from retract_env.fem.elements import lame
from retract_env.mesh import Resolution, section_mesh
from tests.retract_env.boxes import box_grid, hex27, isoparametric, tet10, tetrahedra

Array = NDArray[np.float64]

SIZE = np.array([0.012, HEIGHT, HEIGHT / 2])
MODULUS = 40e3


def hexahedra(poisson: float) -> Body:
    return isoparametric(*box_grid((3, 2, 2), SIZE, warp=0.15), hex27(), MODULUS, poisson)


def tetrahedral(poisson: float) -> Body:
    return isoparametric(*tetrahedra(*box_grid((3, 2, 1), SIZE)), tet10(), MODULUS, poisson)


def half_flap(poisson: float) -> Body:
    scene = flap(length=SIZE[0], poisson=poisson)
    return prism_body(scene, section_mesh(scene, None, Resolution("test", 1, 0.3, 0.6, 0.6)))


BODIES: dict[str, Callable[[float], Body]] = {
    "hex-27": hexahedra,
    "tet-10": tetrahedral,
    "half flap": half_flap,
}


CASES = [(n, nu, 0.0) for n in BODIES for nu in (0.3, 0.49)]
CASES += [("tet-10", 0.3, 1.0), ("half flap", 0.3, 2.0)]


@pytest.fixture(scope="module", params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[Body, float]:
    """A body, of the neo-Hookean law (b = 0) or Fung's, and Poisson's ratio."""
    name, poisson, b = request.param
    return replace(BODIES[name](poisson), b=b), poisson


def resultant(body: Body, force: Array, nodes: NDArray[np.bool_]) -> Array:
    found: Array = body.vectors(force)[nodes].sum(axis=0)
    return found


Case = tuple[Body, float]


def grown(b: float, mu: float, lam: float, *stretches: float) -> float:
    """How many times the neo-Hookean stress Fung's law has at these principal stretches."""
    log_j = float(np.log(np.prod(stretches)))
    return float(np.exp(b * (np.square(stretches).sum() - 3 - 2 * log_j + lam / mu * log_j**2)))


# --- Homogeneous deformations


@pytest.mark.parametrize("stretch", [0.7, 1.5])
def test_uniaxial_stretch(case: Case, stretch: float) -> None:
    """The lateral stretch makes the lateral stress zero; force is stress times area.

    By Fung's law the same lateral stretch, and as many times the stress as its exponential says.
    """
    body, poisson = case
    mu, lam = (float(v) for v in lame(np.array(MODULUS), np.array(poisson)))

    def lateral_stress(t: float) -> float:
        return float(mu * (t * t - 1) + lam * np.log(stretch * t * t))

    t = brentq(lateral_stress, 0.3, 3.0, xtol=1e-15)
    ends = body.face(0, False) | body.face(0, True)
    prescribed = body.held(ends, 0) | body.held(body.face(1, False), 1) | body.held(body.face(2, False), 2)
    target = body.affine(np.diag([stretch, t, t]))
    guess = body.affine(np.diag([stretch, 1.03 * t, 0.97 * t]))
    u, force = relax(body.assembly(~prescribed), np.where(prescribed, target, guess))
    assert np.abs(u - target).max() < 1e-10 * SIZE[0]
    P = mu * stretch + (lam * np.log(stretch * t * t) - mu) / stretch
    P *= grown(body.b, mu, lam, stretch, t, t)
    assert resultant(body, force, body.face(0, True))[0] == pytest.approx(P * SIZE[1] * SIZE[2], rel=1e-9)
    for stretches in body.whole.stretches(u):
        assert np.abs(stretches - np.sort([stretch, t, t])).max() < 1e-7


def test_simple_shear(case: Case) -> None:
    """sigma_xy = mu gamma, sigma_xx = mu gamma^2, no pressure: the volume is kept.

    By Fung's law exp(b gamma^2) times as much.
    """
    body, poisson = case
    mu = MODULUS / (2 * (1 + poisson))
    gamma = 0.6
    mu *= np.exp(body.b * gamma**2)
    F = np.eye(3)
    F[0, 1] = gamma
    sides = [body.face(axis, high) for axis in (0, 1) for high in (False, True)]
    prescribed = body.held(np.any(sides, axis=0), 0, 1, 2) | body.held(body.face(2, False), 2)
    u = body.affine(F)
    u[~prescribed] *= 0.9
    solved, force = relax(body.assembly(~prescribed), u)
    assert np.abs(solved - body.affine(F)).max() < 1e-10 * SIZE[0]
    for block in body.blocks:
        P = stress(deformation(block, solved), MODULUS, poisson, body.b)
        cauchy = P @ F.T  # J = 1
        expected = mu * np.array([[gamma**2, gamma, 0], [gamma, 0, 0], [0, 0, 0]])
        assert np.abs(cauchy - expected).max() < 1e-8 * mu
    # couples of shear stress times area, from the forces that hold the sides
    virial = np.einsum("ni,nj->ij", body.vectors(force), body.at)
    volume = np.prod(SIZE)
    assert virial[0, 1] == pytest.approx(mu * gamma * volume, rel=1e-8)
    assert virial[1, 0] == pytest.approx(mu * gamma * volume, rel=1e-8)
    assert virial[1, 1] == pytest.approx(0, abs=1e-8 * mu * volume)


@pytest.mark.parametrize("stretch", [0.85, 1.2])
def test_homogeneous_pressure(case: Case, stretch: float) -> None:
    """A body swollen alike in all directions pushes on each side with pressure times its area now."""
    body, poisson = case
    mu, lam = (float(v) for v in lame(np.array(MODULUS), np.array(poisson)))
    prescribed = np.zeros(body.size, bool)
    for axis in range(3):
        for high in (False, True):
            prescribed |= body.held(body.face(axis, high), axis)
    target = body.affine(stretch * np.eye(3))
    u = np.zeros(body.size)
    u[prescribed] = target[prescribed]
    u[~prescribed] = 0.9 * target[~prescribed]
    solved, force = relax(body.assembly(~prescribed), u)
    assert np.abs(solved - target).max() < 1e-10 * SIZE[0]
    pressure = (mu * (stretch**2 - 1) + 3 * lam * np.log(stretch)) / stretch**3
    pressure *= grown(body.b, mu, lam, stretch, stretch, stretch)
    for axis in range(3):
        area = stretch**2 * np.prod(np.delete(SIZE, axis))
        on_side = resultant(body, force, body.face(axis, True))[axis]
        assert on_side == pytest.approx(pressure * area, rel=1e-9)
