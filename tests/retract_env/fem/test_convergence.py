"""Errors shrink at the rates of theory: a manufactured finite-strain solution, cantilevers that droop."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from retract_env.fem.elements import (
    TRIANGLE_RULES,
    ElementBlock,
    lame,
    quadratic_depth,
    symmetric_depth,
    triangle6,
)
from retract_env.fem.model import FlapModel
from retract_env.mesh import Resolution, SectionMesh, section_mesh
from retract_env.scene import Scene
from tests.retract_env.bodies import HEIGHT, LENGTH, deformation, flap, prism_body, relax, settled
from tests.retract_env.sections import grid_section, split

Array = NDArray[np.float64]

MODULUS = 40e3

# --- A manufactured solution

K = np.pi / HEIGHT


def manufactured(X: Array) -> Array:
    """Displacement (n, 3) m of x = X + f(Y), y = a(Y) + g(Z), z = Z: shear and volume vary."""
    _, Y, Z = X.T
    f = 0.15 * HEIGHT * np.sin(K * Y)
    a = 0.08 * HEIGHT * np.cos(K * Y)
    g = 0.05 * HEIGHT * np.cos(K * Z)
    return np.stack([f, a + g, np.zeros(len(X))], axis=1)


def manufactured_gradient(X: Array) -> Array:
    """Its deformation gradient (..., 3, 3)."""
    Y, Z = X[..., 1], X[..., 2]
    F = np.zeros((*X.shape, 3)) + np.eye(3)
    F[..., 0, 1] = 0.15 * HEIGHT * K * np.cos(K * Y)
    F[..., 1, 1] += -0.08 * HEIGHT * K * np.sin(K * Y)
    F[..., 1, 2] = -0.05 * HEIGHT * K * np.sin(K * Z)
    return F


def manufactured_force(poisson: float) -> Callable[[Array], Array]:
    """Body force -Div P (n, 3) N/m^3.

    Piola's identity Div(J F^-T) = 0 gives Div P = mu Lap x + (lambda + mu - lambda ln J) F^-T grad ln J.
    """
    mu, lam = lame(np.array(MODULUS), np.array(poisson))

    def force(X: Array) -> Array:
        F = manufactured_gradient(X)
        Y, Z = X[:, 1], X[:, 2]
        laplacian = np.zeros_like(X)
        laplacian[:, 0] = -0.15 * HEIGHT * K**2 * np.sin(K * Y)
        bend = -0.08 * HEIGHT * K**2 * np.cos(K * Y)
        laplacian[:, 1] = bend - 0.05 * HEIGHT * K**2 * np.cos(K * Z)
        J = F[:, 1, 1]
        slope = np.zeros_like(X)
        slope[:, 1] = bend / J
        pushed = np.einsum("nji,nj->ni", np.linalg.inv(F), slope)
        return -(mu * laplacian + (lam + mu - lam * np.log(J))[:, None] * pushed)

    return force


def tables(section: SectionMesh, breaks: Array) -> list[tuple[Array, Array, Array]]:
    """Each layer at the points of the finer rule: shape functions (q, na), (q, nz), places (m, q, 3) m."""
    at, _ = TRIANGLE_RULES[6]
    value, _, _ = triangle6(at, section.corners)
    xy = np.einsum("pc,mci->mpi", at, section.corners)
    out = []
    for low, high in pairwise(breaks):
        even, _, odd, _, _ = symmetric_depth(high) if low == 0 else quadratic_depth(high - low)
        z = odd @ np.linspace(low, high, 3)[-odd.shape[1] :]
        place = np.empty((*xy.shape[:2], len(z), 3))
        place[..., :2], place[..., 2] = xy[:, :, None], z
        shapes = [np.einsum("pt,rl->prlt", value, d).reshape(len(at) * len(z), -1) for d in (even, odd)]
        out.append((*shapes, place.reshape(len(xy), -1, 3)))
    return out


def rows(block: ElementBlock) -> NDArray[np.int32]:
    """Unknowns (m, 2 na + nz) of each element."""
    return np.moveaxis(block.dofs, -1, 1).reshape(-1, block.dofs.shape[1])[: block.count]


def errors(section: SectionMesh, layers: int, poisson: float) -> tuple[float, float]:
    """Relative L2 errors of displacement and its gradient, solving for the manufactured solution."""
    scene = flap(length=HEIGHT, depth=2 * HEIGHT, poisson=poisson)
    # loads and errors are integrated with a rule that is not the elements' own
    body, fine = (prism_body(scene, section, points, per_height=2 * layers) for points in (3, 6))
    shapes = tables(section, np.linspace(0, HEIGHT, layers + 1))
    force, load = manufactured_force(poisson), np.zeros(body.size)
    for block, (xy, z, place) in zip(fine.blocks, shapes, strict=True):
        density = force(place.reshape(-1, 3)).reshape(place.shape) * block.by_element(block.weight)[..., None]
        parts = [density[..., 0] @ xy, density[..., 1] @ xy, density[..., 2] @ z]
        np.add.at(load, rows(block), np.concatenate(parts, axis=1))
    low, high = body.at.min(axis=0), body.at.max(axis=0)
    inside = (body.at < high - 1e-9) & (body.at > np.array([low[0], low[1], -1]) + 1e-9)
    free = body.unknowns(np.tile(inside.all(axis=1, keepdims=True), 3).astype(float)) > 0
    u, _ = relax(body.assembly(free), body.unknowns(manufactured(body.at)), load)
    sums = np.zeros((2, 2))
    for block, (xy, z, place) in zip(fine.blocks, shapes, strict=True):
        weight = block.by_element(block.weight)
        ux, uy, uz = np.split(u[rows(block)], [xy.shape[1], 2 * xy.shape[1]], axis=1)
        found, true = np.stack([ux @ xy.T, uy @ xy.T, uz @ z.T], axis=2), manufactured(place.reshape(-1, 3))
        F = manufactured_gradient(place)
        for k, v in enumerate([found - true.reshape(place.shape), true.reshape(place.shape)]):
            sums[0, k] += np.einsum("mq,mqi->", weight, v**2)
        for k, v in enumerate([deformation(block, u) - F, F - np.eye(3)]):
            sums[1, k] += np.einsum("mq,mqij->", weight, v**2)
    return float(np.sqrt(sums[0, 0] / sums[0, 1])), float(np.sqrt(sums[1, 0] / sums[1, 1]))


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
def test_a_manufactured_solution_converges_at_third_order_and_its_gradient_at_second(poisson: float) -> None:
    scene = flap(length=HEIGHT)
    section = section_mesh(scene, None, Resolution("test", 1, 0.3, 0.6, 0.5))
    found = []
    for layers in (2, 4, 8):
        found.append(errors(section, layers, poisson))
        section = split(section, scene)
    displacement, gradient = np.log2(np.array(found[-2]) / np.array(found[-1]))
    assert displacement == pytest.approx(3, abs=0.2)
    assert gradient == pytest.approx(2, abs=0.2)
    assert found[-1][0] < 0.003


# --- Cantilevers under their own weight


def tip_drops(scene: Scene, cells: int, levels: int) -> Array:
    """Tip drop (levels,) m of meshes that are halved from one to the next."""
    length, height = scene.tissue.length, scene.tissue.height
    section = grid_section(np.linspace(-length, 0, cells + 1), np.linspace(0, height, 3), scene)
    out = []
    for _ in range(levels):
        model = FlapModel(scene, section, None)
        u, _ = settled(model)
        tip = np.argmin(np.hypot(*(section.points - [-length, height / 2]).T))
        out.append(section.points[tip, 1] - model.positions(u)[tip, 1])
        section = split(section, scene)
    return np.array(out)


def beam_drop(scene: Scene, flexible: bool = True) -> float:
    """Tip drop, m, of a slender rod under its weight, whatever it turns.

    Reissner's rod with EI, EA and 5/6 GA; the elastica, where it is not flexible in shear and stretch.
    """
    tissue = scene.tissue
    modulus, height, length = tissue.modulus, tissue.height, tissue.length
    area = height * tissue.depth
    bending = modulus * area * height**2 / 12
    shear = 5 / 6 * modulus / (2 * (1 + tissue.poisson)) * area
    weight = tissue.density * scene.gravity * area

    def slopes(s: Array, y: Array) -> Array:
        load, (sin, cos) = weight * (length - s), (np.sin(y[2]), np.cos(y[2]))
        stretch = 1 + load * sin / (modulus * area) * flexible
        angle = load * cos / shear * flexible
        dx = stretch * cos - angle * sin
        return np.array([dx, stretch * sin + angle * cos, y[3] / bending, -load * dx])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], a[1], a[2], b[3]])

    return float(solve_bvp(slopes, ends, np.linspace(0, length, 40), np.zeros((4, 40)), tol=1e-7).y[1, -1])


def limit(values: Array) -> float:
    """Where the last three of a geometric sequence lead (Aitken)."""
    a, b = np.diff(values[-3:])
    return float(values[-1] + b**2 / (a - b))


def corner_exponent(poisson: float) -> float:
    """Exponent of displacement where a clamped and a free side meet at right angles (Williams 1952)."""
    kappa = 3 - 4 * poisson
    return brentq(
        lambda e: np.sin(e * np.pi / 2) ** 2 - ((kappa + 1) ** 2 - 4 * e**2) / (4 * kappa), 0.3, 0.999
    )


def test_a_small_load_bends_the_flap_as_timoshenkos_beam() -> None:
    scene = flap(modulus=600e3, poisson=0.0, gravity=0.01, bed=False)
    drop = limit(tip_drops(scene, cells=10, levels=3))
    # without lateral contraction the clamp disturbs nothing; warping at it has the size of (h / l)^3
    assert drop == pytest.approx(beam_drop(scene), rel=(HEIGHT / LENGTH) ** 3)
    tissue = scene.tissue
    euler = 1.5 * tissue.density * scene.gravity * LENGTH**4 / (tissue.modulus * HEIGHT**2)
    shear = 0.6 * 2 * tissue.density * scene.gravity * LENGTH**2 / tissue.modulus
    assert drop == pytest.approx(euler + shear, rel=(HEIGHT / LENGTH) ** 3)


def test_a_large_load_bends_the_flap_as_reissners_rod() -> None:
    scene = flap(modulus=600e3, poisson=0.0, bed=False)
    drops = tip_drops(scene, cells=10, levels=3)
    # the material's moment differs from E I times curvature by the square of the strain, 3 % at the clamp
    assert limit(drops) == pytest.approx(beam_drop(scene), rel=0.03**2)
    assert beam_drop(scene, flexible=False) == pytest.approx(0.7756e-2, abs=1e-6)  # published: the elastica
    order = np.log2(np.diff(drops)[0] / np.diff(drops)[1])
    # between those of displacement, 3, and of energy, 4
    assert 2.9 < order < 4.1


def test_the_published_cantilever() -> None:
    """Tip drop 0.7675 cm of the finest of several codes' meshes, E = 600 kPa, nu = 0.45."""
    scene = flap(modulus=600e3, bed=False)
    assert limit(tip_drops(scene, cells=10, levels=3)) == pytest.approx(0.7675e-2, rel=2e-3)


def test_a_clamped_corner_sets_the_rate_of_nearly_incompressible_tissue() -> None:
    """Energy, and with it the drop under a dead load, converges with twice the singularity's exponent."""
    scene = flap(length=4 * HEIGHT, gravity=0.01, bed=False)
    drops = tip_drops(scene, cells=4, levels=4)
    order = np.log2(np.diff(drops)[-2] / np.diff(drops)[-1])
    assert order == pytest.approx(2 * corner_exponent(0.45), abs=0.15)
    assert (np.diff(drops) > 0).all()  # too stiff, never too soft
