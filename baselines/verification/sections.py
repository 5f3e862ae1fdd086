"""Sections of the flap, laid out by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.mesh import SectionMesh
from retract_env.mesh.section import edge_lengths
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def section_of(points: Array, corners: Ints, scene: Scene, jaw_x: float | None = None) -> SectionMesh:
    """Quadratic section over given triangles: points (n, 2) m, corners (m, 3) counter-clockwise."""
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    triangles = np.concatenate([corners, len(points) + inverse.reshape(3, -1).T], axis=1)
    points = np.concatenate([points, points[unique].mean(axis=1)])
    x, y = points.T
    near = 1e-9
    low = np.abs(y) < near
    patch = np.abs(x - np.inf if jaw_x is None else x - jaw_x) < scene.jaws.width / 2 + near
    sides = np.concatenate([triangles[:, [a, 3 + a, (a + 1) % 3]] for a in range(3)])
    share = edge_lengths(points, sides[low[sides].all(axis=1)])

    def nodes(where: NDArray[np.bool_]) -> NDArray[np.int32]:
        return np.flatnonzero(where).astype(np.int32)

    return SectionMesh(
        points=points,
        triangles=triangles.astype(np.int32),
        vein=np.full(len(corners), -1, np.int32),
        fixed=nodes(np.abs(x) < near),
        patches=(nodes(low & patch), nodes((np.abs(y - scene.tissue.height) < near) & patch)),
        bottom=nodes(low),
        bottom_length=share[low],
    )


def grid_section(xs: ArrayLike, ys: ArrayLike, scene: Scene, jaw_x: float | None = None) -> SectionMesh:
    """Triangles over a grid, its own mirror image in the line half-way up where `ys` is and counts odd."""
    xs, ys = np.asarray(xs, float), np.asarray(ys, float)
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    corners = []
    for i, j in product(range(len(xs) - 1), range(len(ys) - 1)):
        a, b = i * len(ys) + j, (i + 1) * len(ys) + j
        if 2 * j < len(ys) - 1:
            corners += [(a, b, b + 1), (a, b + 1, a + 1)]
        else:
            corners += [(a, b, a + 1), (b, b + 1, a + 1)]
    return section_of(points, np.array(corners), scene, jaw_x)


def split(section: SectionMesh, scene: Scene, jaw_x: float | None = None) -> SectionMesh:
    """Every triangle cut into four."""
    t = section.triangles
    corners = np.concatenate([t[:, k] for k in ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5])])
    cut = section_of(section.points, corners.astype(np.int64), scene, jaw_x)
    return replace(cut, vein=np.tile(section.vein, 4), smeared=section.smeared)


def turned_over(section: SectionMesh, height: float) -> SectionMesh:
    """The mirror image y -> height - y, nodes in the same order; the upper patch becomes the lower one."""
    triangles = section.triangles[:, [0, 2, 1, 5, 4, 3]]
    points = np.column_stack([section.points[:, 0], height - section.points[:, 1]])
    patches = section.patches[1], section.patches[0]
    return replace(section, points=points, triangles=triangles, patches=patches)
