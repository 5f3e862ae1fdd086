"""Mesh of the flap's section: quadratic triangles that follow the veins and the jaw patches."""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import FlapRefused, MeshError
from retract_env.mesh.jaws import SLIVER, patch_ends
from retract_env.mesh.resolutions import Resolution
from retract_env.scene import Scene, Vein

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


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
    smeared: tuple[Vein, ...] = ()
    """veins that no triangle follows: the stiffness of the triangles that they lie in changes instead"""

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


def edge_lengths(points: Array, edges: Ints) -> Array:
    """(n,) m, of straight quadratic edges (e, 3) corner, middle, corner, that belongs to each of the points
    (n, 2), by Simpson's rule."""
    size = np.hypot(*(points[edges[:, 2]] - points[edges[:, 0]]).T)
    length = np.zeros(len(points))
    np.add.at(length, edges, size[:, None] * np.array([1, 4, 1]) / 6)
    return length


def quadratic_shares(places: Array) -> Array:
    """(k, 6) values of a triangle's quadratic shape functions, in its nodes' order, at (k, 3) barycentric."""
    return np.concatenate([places * (2 * places - 1), 4 * places * np.roll(places, -1, axis=1)], axis=1)


MOST_SLENDER = 5000
"""Length over height at which a flap with elements as large as it is high has more unknowns than finite
elements take, and netgen more triangles than it makes in seconds."""
_netgen = threading.Lock()  # netgen keeps global state


def section_mesh(
    scene: Scene, jaw_x: float | None, resolution: Resolution, smeared: Collection[int] = ()
) -> SectionMesh:
    """Mesh the section so that veins and, where a grasp is given, both jaw patches end on element edges.

    jaw_x: m, middle of the patches, or None for no jaws; smeared: indices of veins that need not be followed.
    Raises MeshError, its kind FlapRefused for a flap of too many elements, and ValueError as `patch_ends`.
    """
    from netgen.geom2d import SplineGeometry

    tissue = scene.tissue
    length, height, width = tissue.length, tissue.height, scene.jaws.width
    if (slender := length / height) > (most := MOST_SLENDER * resolution.bulk):
        raise FlapRefused(
            f"tissue: {slender:.4g} times as long as high, allowed {most:g} at {resolution.name!r}"
        )
    bulk = resolution.bulk * height
    ends = None if jaw_x is None else patch_ends(scene, jaw_x)
    geometry = SplineGeometry()  # its tolerances are absolute, so it works in units of the height
    numbers: dict[tuple[float, float], int] = {}

    def vertex(x: float, y: float, size: float = bulk) -> int:
        if (x, y) not in numbers:
            numbers[x, y] = int(geometry.AppendPoint(x / height, y / height, size / height))
        return numbers[x, y]

    # Vein edges that lie on the flap's sides belong to the outline; the others bound two materials.
    sides = {(0, -length): {}, (0, 0.0): {}, (1, 0.0): {}, (1, height): {}}  # type: dict[tuple[int, float], dict[tuple[float, float], int]]
    inner: list[tuple[tuple[float, float], tuple[float, float], int]] = []
    for i, vein in enumerate(tissue.veins):
        if i in smeared:
            continue
        for p, q in zip(vein.outline, vein.outline[1:] + vein.outline[:1], strict=True):
            side = next((s for s in sides if p[s[0]] == q[s[0]] == s[1]), None)
            if side is None:
                inner.append((p, q, 2 + i))
            else:
                along = 1 - side[0]
                sides[side][min(p[along], q[along]), max(p[along], q[along])] = 2 + i

    if ends is not None:
        # a vein that ends just beside a patch would leave a sliver
        cuts = [x for (axis, _), spans in sides.items() if axis == 1 for span in spans for x in span]
        low, high = (
            min((x for x in cuts if abs(x - e) < SLIVER * width), key=lambda x: abs(x - e), default=e)
            for e in ends
        )
        ends = low, high

    def side_points(axis: int, level: float, low: float, high: float) -> list[float]:
        cuts = {low, high, *(c for span in sides[axis, level] for c in span)}
        if axis == 1 and ends is not None:
            # netgen keeps the size asked for at a point only if there is an edge of that size
            step = resolution.edge * width
            cuts |= set(ends) | {
                e + side * step for e in ends for side in (-1, 1) if low < e + side * step < high
            }
        return sorted(cuts)

    bottom = [(x, 0.0) for x in side_points(1, 0.0, -length, 0.0)]
    right = [(0.0, y) for y in side_points(0, 0.0, 0.0, height)]
    top = [(x, height) for x in reversed(side_points(1, height, -length, 0.0))]
    left = [(-length, y) for y in reversed(side_points(0, -length, 0.0, height))]
    singular = set() if ends is None else {(x, y) for x in ends if x > -length for y in (0.0, height)}
    patch = width / resolution.patch
    for points, (axis, level) in (
        (bottom, (1, 0.0)),
        (right, (0, 0.0)),
        (top, (1, height)),
        (left, (0, -length)),
    ):
        for p, q in pairwise(points):
            middle = (p[1 - axis] + q[1 - axis]) / 2
            domain = next((d for (a, b), d in sides[axis, level].items() if a < middle < b), 1)
            held = ends is not None and axis == 1 and ends[0] < middle < ends[1]
            at = [vertex(*c, resolution.edge * width if c in singular else bulk) for c in (p, q)]
            geometry.Append(
                ["line", *at], leftdomain=domain, rightdomain=0, maxh=(patch if held else bulk) / height
            )
    for p, q, domain in inner:
        geometry.Append(["line", vertex(*p), vertex(*q)], leftdomain=domain, rightdomain=1)
    with _netgen:
        try:
            mesh = geometry.GenerateMesh(maxh=resolution.bulk, grading=resolution.growth)
        except Exception as error:  # netgen raises its own kinds
            raise MeshError(
                f"scene {scene.name!r} with a grasp at {jaw_x} m cannot be meshed: {error}"
            ) from error
        nodes = np.array([p.p[:2] for p in mesh.Points()]) * height
        elements = mesh.Elements2D().NumPy()
    corners = elements["nodes"][:, :3].astype(np.int64) - 1
    vein_of = elements["index"].astype(np.int32) - 2
    averaged = tuple(vein for i, vein in enumerate(tissue.veins) if i in smeared)
    return _finish(nodes, corners, vein_of, scene, ends, averaged)


def _finish(
    points: Array,
    corners: NDArray[np.int64],
    vein: Ints,
    scene: Scene,
    ends: tuple[float, float] | None,
    smeared: tuple[Vein, ...],
) -> SectionMesh:
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
    under = np.zeros(len(x), bool) if ends is None else (x > ends[0] - near) & (x < ends[1] + near)
    edges = np.concatenate([triangles[:, [a, 3 + a, (a + 1) % 3]] for a in range(3)])
    share = edge_lengths(points, edges[low[edges].all(axis=1)])
    bottom = nodes(low)
    return SectionMesh(
        points=points,
        triangles=triangles,
        vein=vein,
        fixed=nodes(np.abs(x) < near),
        patches=(nodes(low & under), nodes(high & under)),
        bottom=bottom,
        bottom_length=share[bottom],
        smeared=smeared,
    )
