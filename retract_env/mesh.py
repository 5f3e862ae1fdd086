"""Meshes of the flap: a section that follows veins and jaw patches, and its extrusion over half the depth."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Resolution:
    """Sizes of the elements, as fractions of what they resolve."""

    name: str
    patch: int
    """elements along a jaw patch"""
    edge: float
    """size of the elements at the patch's ends, where stress is singular, over the patch's width"""
    growth: float
    """how fast elements grow away from the patches, per unit length"""
    bulk: float
    """largest element over the flap's height"""


RESOLUTIONS = {
    "coarse": Resolution("coarse", patch=2, edge=0.2, growth=0.7, bulk=1.0),
    "medium": Resolution("medium", patch=4, edge=0.15, growth=0.6, bulk=0.8),
    "fine": Resolution("fine", patch=8, edge=0.12, growth=0.45, bulk=0.8),
    "finer": Resolution("finer", patch=12, edge=0.08, growth=0.25, bulk=0.3),
}
"""Certificates come from "fine": within 2 % of converged strain, 5 % of converged jaw forces (benchmarks/accuracy.py)."""


@dataclass(frozen=True)
class SectionMesh:
    """Quadratic triangles over the x-y section; nodes sorted along x, edges straight."""

    points: Array
    """(n, 2) m, at rest"""
    triangles: Ints
    """(m, 6) three corners counter-clockwise, then the middles of the edges (0, 1), (1, 2), (2, 0)"""
    vein: Ints
    """(m,) index of the vein that the triangle lies in, -1 for tissue"""
    fixed: Ints
    """nodes of the fixed end"""
    patches: tuple[Ints, Ints]
    """nodes under the lower and the upper jaw"""
    bottom: Ints
    """nodes of the lower surface"""
    bottom_length: Array
    """m, length of the lower surface that belongs to each of its nodes (Simpson's rule)"""

    @cached_property
    def corners(self) -> Array:
        """(m, 3, 2) m."""
        return self.points[self.triangles[:, :3]]

    @cached_property
    def boundary(self) -> Ints:
        """(b, 3) edges of the outline: corner, middle, corner, counter-clockwise."""
        edges = np.concatenate([self.triangles[:, [a, 3 + a, (a + 1) % 3]] for a in range(3)])
        middle, count = np.unique(edges[:, 1], return_counts=True)
        return edges[np.isin(edges[:, 1], middle[count == 1])]


_netgen = threading.Lock()  # netgen keeps global state


def section_mesh(scene: Scene, jaw_x: float | None, resolution: Resolution) -> SectionMesh:
    """Mesh the section so that veins and, where a grasp is given, both jaw patches end on element edges.

    jaw_x: m, middle of the patches, or None for no jaws.
    """
    from netgen.geom2d import SplineGeometry

    tissue = scene.tissue
    length, height, width = tissue.length, tissue.height, scene.jaws.width
    bulk = resolution.bulk * height
    # netgen's point tolerances are absolute, so mesh in units of the height
    geometry = SplineGeometry()
    if jaw_x is None:
        ends = np.empty(0)
    else:
        ends = np.array([jaw_x - width / 2, jaw_x + width / 2])
    xs = np.concatenate([[-length], ends[(ends > -length) & (ends < 0)], [0.0]])
    fine = width / resolution.patch

    def corner(x: float, y: float) -> int:
        size = resolution.edge * width if jaw_x is not None and -length < x < 0 else bulk
        return int(geometry.AppendPoint(x / height, y / height, size / height))

    ring = [(corner(x, 0.0), x) for x in xs] + [(corner(x, height), x) for x in xs[::-1]]
    for (p, xp), (q, xq) in zip(ring, ring[1:] + ring[:1], strict=True):
        under_jaw = jaw_x is not None and max(abs(xp - jaw_x), abs(xq - jaw_x)) < 0.51 * width and xp != xq
        geometry.Append(["line", p, q], leftdomain=1, rightdomain=0, maxh=(fine if under_jaw else bulk) / height)
    for i, vein in enumerate(tissue.veins):
        loop = [int(geometry.AppendPoint(x / height, y / height)) for x, y in vein.outline]
        for p, q in zip(loop, loop[1:] + loop[:1], strict=True):
            geometry.Append(["line", p, q], leftdomain=2 + i, rightdomain=1)
    with _netgen:
        mesh = geometry.GenerateMesh(maxh=resolution.bulk, grading=resolution.growth)
        points = np.array([p.p[:2] for p in mesh.Points()]) * height
        elements = mesh.Elements2D().NumPy()
    corners = elements["nodes"][:, :3].astype(np.int64) - 1
    vein_of = elements["index"].astype(np.int32) - 2
    return _finish(points, corners, vein_of, scene, jaw_x)


def _finish(points: Array, corners: NDArray[np.int64], vein: Ints, scene: Scene, jaw_x: float | None) -> SectionMesh:
    """Mid-edge nodes, order along x, and the named node sets."""
    tissue = scene.tissue
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middles = len(points) + inverse.reshape(3, -1).T
    points = np.concatenate([points, points[unique].mean(axis=1)])
    triangles = np.concatenate([corners, middles], axis=1)
    used = np.unique(triangles)
    order = used[np.lexsort((points[used, 1], points[used, 0]))]
    rank = np.full(len(points), -1)
    rank[order] = np.arange(len(order))
    points, triangles = points[order], rank[triangles].astype(np.int32)

    near = 1e-9 * tissue.length
    x, y = points.T

    def nodes(where: NDArray[np.bool_]) -> Ints:
        return np.flatnonzero(where).astype(np.int32)

    low, high = np.abs(y) < near, np.abs(y - tissue.height) < near
    under = np.zeros(len(x), bool) if jaw_x is None else np.abs(x - jaw_x) < scene.jaws.width / 2 + near
    share = np.zeros(len(x))
    for a in range(3):
        edge = triangles[:, [a, 3 + a, (a + 1) % 3]]
        edge = edge[low[edge].all(axis=1)]
        size = np.abs(x[edge[:, 2]] - x[edge[:, 0]])
        np.add.at(share, edge, size[:, None] * np.array([1, 4, 1]) / 6)
    bottom = nodes(low)
    return SectionMesh(
        points=points,
        triangles=triangles,
        vein=vein,
        fixed=nodes(np.abs(x) < near),
        patches=(nodes(low & under), nodes(high & under)),
        bottom=bottom,
        bottom_length=share[bottom],
    )
