"""Boxes of ordinary elements, hex-27 and tet-10, for the kernels to be tried on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.verification.bodies import Body, Field
from retract_env.fem.elements import ElementBlock, lame

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Shape:
    """Reference element: shape functions at its quadrature points."""

    value: Array
    """(q, k)"""
    slope: Array
    """(q, 3, k)"""
    weight: Array
    """(q,)"""


def hex27() -> Shape:
    """Triquadratic, nodes (a, b, c) in {-1, 0, 1}^3 with c running fastest, 3 x 3 x 3 points."""
    s, w = np.polynomial.legendre.leggauss(3)
    n = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=1)
    d = np.stack([s - 0.5, -2 * s, s + 0.5], axis=1)

    def tensor(x: Array, y: Array, z: Array) -> Array:
        found: Array = np.einsum("pa,qb,rc->pqrabc", x, y, z).reshape(27, 27)
        return found

    slope = np.stack([tensor(d, n, n), tensor(n, d, n), tensor(n, n, d)], axis=1)
    return Shape(tensor(n, n, n), slope, np.einsum("p,q,r->pqr", w, w, w).ravel())


TET_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def tet10() -> Shape:
    """Quadratic tetrahedron, corners and then TET_EDGES, the four-point rule of degree 2."""
    a, b = (5 + 3 * np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20
    l = np.full((4, 4), b) + (a - b) * np.eye(4)
    dl = np.array([[-1.0, 1, 0, 0], [-1, 0, 1, 0], [-1, 0, 0, 1]])
    i, j = np.transpose(TET_EDGES)
    value = np.concatenate([l * (2 * l - 1), 4 * l[:, i] * l[:, j]], axis=1)
    corner = dl * (4 * l[:, None] - 1)
    edge = 4 * (dl[:, i] * l[:, None, j] + dl[:, j] * l[:, None, i])
    return Shape(value, np.concatenate([corner, edge], axis=2), np.full(4, 1 / 24))


def box_grid(cells: Sequence[int], size: ArrayLike, warp: float = 0.0, seed: int = 0) -> tuple[Array, Ints]:
    """Points (n, 3) m of a box on [0, size] and its hex-27 cells (m, 27), corners moved by `warp` cells.

    Faces stay plane and edges straight, so that the quadrature of hex-27 stays exact.
    """
    counts = np.array([2 * n + 1 for n in cells])
    index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).astype(float)
    shift = np.random.default_rng(seed).uniform(-2 * warp, 2 * warp, (*(np.array(cells) + 1), 3))
    for axis in range(3):
        for end in (0, -1):
            np.moveaxis(shift, axis, 0)[end, ..., axis] = 0
    for axis in range(3):  # nodes between corners stay half-way
        along = np.moveaxis(shift, axis, 0)
        filled = np.empty((2 * len(along) - 1, *along.shape[1:]))
        filled[::2], filled[1::2] = along, (along[1:] + along[:-1]) / 2
        shift = np.moveaxis(filled, 0, axis)
    points = ((index + shift) / (counts - 1) * np.asarray(size, float)).reshape(-1, 3)
    number = np.arange(len(points)).reshape(counts)
    first = number[:-2:2, :-2:2, :-2:2].ravel()
    return points, first[:, None] + (number[:3, :3, :3].ravel())


def tetrahedra(points: Array, hexes: Ints) -> tuple[Array, Ints]:
    """Points, edges straightened, and cells (6 m, 10): six around one long diagonal of each hex-27."""
    out = []
    for order in permutations(range(3)):
        corner = np.zeros((4, 3), int)
        for step, axis in enumerate(order):
            corner[step + 1] = corner[step]
            corner[step + 1, axis] = 2
        if np.linalg.det(corner[1:] - corner[0]) < 0:
            corner = corner[[0, 2, 1, 3]]
        nodes = np.concatenate([corner, [(corner[i] + corner[j]) // 2 for i, j in TET_EDGES]])
        out.append(hexes[:, nodes @ [9, 3, 1]])
    cells = np.concatenate(out)
    straight = points.copy()
    for middle, (i, j) in enumerate(TET_EDGES, start=4):
        straight[cells[:, middle]] = (points[cells[:, i]] + points[cells[:, j]]) / 2
    return straight, cells


def isoparametric(
    points: Array, cells: Ints, shape: Shape, modulus: ArrayLike = 40e3, poisson: ArrayLike = 0.45
) -> Body:
    """Ordinary elements, three unknowns a node; modulus [Pa] and poisson: () or (m,)."""
    jacobian = np.einsum("qjk,mki->mqij", shape.slope, points[cells])
    gradient = np.einsum("qjk,mqji->mqik", shape.slope, np.linalg.inv(jacobian))
    weight = np.linalg.det(jacobian) * shape.weight
    assert (weight > 0).all()
    mu, lam = (np.broadcast_to(v, len(cells)) for v in lame(np.asarray(modulus), np.asarray(poisson)))
    block = ElementBlock.of(
        gradient, gradient, weight, mu, lam, np.concatenate([3 * cells + i for i in range(3)], axis=1)
    )
    n = np.arange(len(points))
    return Body([block], 3 * len(points), (3 * n, 3 * n + 1, 3 * n + 2), points)


def body_load(points: Array, cells: Ints, shape: Shape, force: Field) -> Array:
    """Nodal forces (3 n,) N of a body force (k, 3) -> (k, 3) N/m^3 on isoparametric elements."""
    weight = np.linalg.det(np.einsum("qjk,mki->mqij", shape.slope, points[cells])) * shape.weight
    at = np.einsum("qk,mki->mqi", shape.value, points[cells])
    density = force(at.reshape(-1, 3)).reshape(at.shape)
    out = np.zeros(points.shape)
    np.add.at(out, cells, np.einsum("mq,mqi,qk->mki", weight, density, shape.value))
    return out.ravel()
