"""How fast the finite elements tend to what is known: a manufactured solution, cantilevers that droop."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from baselines.verification.bodies import deformation, prism_body, relax, settled
from baselines.verification.flaps import HEIGHT, flap
from baselines.verification.sections import grid_section, split
from retract_env.fem.elements import (
    TRIANGLE_RULES,
    ElementBlock,
    lame,
    quadratic_depth,
    symmetric_depth,
    triangle6,
)
from retract_env.fem.model import FlapModel
from retract_env.mesh import SectionMesh
from retract_env.scene import Scene

Array = NDArray[np.float64]

# --- A manufactured solution

MODULUS = 40e3
"""Pa"""
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
        found: Array = -(mu * laplacian + (lam + mu - lam * np.log(J))[:, None] * pushed)
        return found

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
