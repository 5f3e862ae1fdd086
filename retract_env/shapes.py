"""What a drawing of the section shows, as plain geometry in metres, and what the camera sees of the bed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh
    from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

FINGER, PAD = 0.14, 0.016  # of the flap's length

_SMALL = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # a quadratic triangle as four plain ones
_EDGES = np.array([[0, 3, 1], [1, 4, 2], [2, 5, 0]])


class SectionTopology:
    """What is drawn of a section mesh, whatever its shape now.

    nodes: (v,) node of each drawn vertex. faces: (4 m, 3) vertices. outline: (k,) boundary nodes from the
    foot of the fixed end along the lower surface and round, the first again at the end. vein_edges: (e, 3)
    nodes along the outlines of the veins.
    """

    def __init__(self, section: SectionMesh) -> None:
        triangles, vein = np.asarray(section.triangles), np.asarray(section.vein)
        count = len(section.points)
        # Strain jumps between vein and tissue, so a node on a vein's outline is drawn as two vertices.
        sided = triangles + count * (vein >= 0)[:, None]
        vertices, owner = np.unique(sided, return_inverse=True)
        self._vertex: Ints = owner.reshape(triangles.shape)
        self._shares: Ints = np.bincount(self._vertex.ravel())
        self.nodes: Ints = vertices % count
        self.faces: Ints = np.ascontiguousarray(self._vertex[:, _SMALL].reshape(-1, 3))
        edges = triangles[:, _EDGES].reshape(-1, 3)
        inside = np.repeat(vein, 3)
        keys = np.column_stack((inside, edges[:, 1]))[inside >= 0]
        _, first, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
        self.vein_edges: Ints = edges[inside >= 0][np.sort(first[times == 1])].astype(np.intp)
        self.outline: Ints = _loop(np.asarray(section.points), np.asarray(section.boundary))

    def smooth(self, strain: Array) -> Array:
        """(v,) strain at the vertices: mean of the (m,) triangles around each, on its side of a vein."""
        return np.bincount(self._vertex.ravel(), np.repeat(strain, 6)) / self._shares


def _loop(points: Array, boundary: NDArray[np.integer]) -> Ints:
    after = {int(a): (int(b), int(middle)) for a, middle, b in boundary}
    corners = np.array(list(after))
    node = int(corners[np.argmax(points[corners, 0] - points[corners, 1])])
    loop = [node]
    for _ in after:
        node, middle = after[node]
        loop += [middle, node]
    # The edges run counter-clockwise, up the fixed end first; backwards the lower surface comes first.
    return np.array(loop[::-1], dtype=np.intp)


def broken(lines: Array) -> Array:
    """Lines (e, k, 2) as one line (e (k + 1), 2) with a gap after each."""
    gaps = np.full((len(lines), 1, 2), np.nan)
    return np.concatenate((lines, gaps), axis=1).reshape(-1, 2)


def bed_hits(points: ArrayLike, camera: ArrayLike) -> Array:
    """(n,) m, where the rays from the camera (2,) through points (n, 2) meet the bed y = 0.

    Infinite, on the side where the point is, for points that are not below the camera.
    """
    points, (ax, ay) = np.asarray(points, dtype=np.float64), np.asarray(camera, dtype=np.float64)
    drop = ay - points[:, 1]
    aside = points[:, 0] - ax
    below = drop > 0
    return np.where(below, ax + aside * ay / np.where(below, drop, 1.0), np.copysign(np.inf, aside))


def hidden_region(outline: Array, hits: Array) -> Array:
    """(r, 2) m, polygon that the flap hides from the camera: under the flap, down to the bed.

    outline: (k, 2) from the foot of the fixed end along the lower surface and round; hits: (k,) its
    `bed_hits`. The polygon ends at the first ray, from the camera's side, that does not get past the flap.
    """
    first = int(np.argmin(np.where(np.isfinite(hits), hits, np.inf)))
    return np.vstack((outline[: first + 1], [(hits[first], 0.0)]))


def seen_spans(hits: Array, near: float, far: float) -> Array:
    """(s, 2) m, the parts of the bed from x = near to far that the camera sees past an outline.

    hits: (k,) `bed_hits` of the outline, each edge of which hides what lies between its two.
    """
    clipped = np.clip(hits, near, far)
    begins, ends = np.minimum(clipped[:-1], clipped[1:]), np.maximum(clipped[:-1], clipped[1:])
    above = np.isinf(hits)
    ends = np.where(above[:-1] & above[1:], begins, ends)  # such an edge hides nothing, wherever it is
    order = np.argsort(begins)
    hidden_to = np.maximum.accumulate(np.concatenate(([near], ends[order])))
    next_begins = np.concatenate((begins[order], [far]))
    free = next_begins > hidden_to
    return np.column_stack((hidden_to[free], next_begins[free]))


class JawShapes:
    """Two rounded pads outside the tissue, as wide as a jaw patch, and the gripper's fingers behind them."""

    def __init__(self, scene: Scene, bold: float = 1.0) -> None:
        """bold: how many times as thick as they are."""
        length, half = scene.tissue.length, bold * scene.jaws.width / 2
        thick, reach = bold * PAD * length, FINGER * length
        radius = 0.7 * min(half, thick)
        turn = np.linspace(0.0, np.pi / 2, 5)[:, None]
        corner = radius * np.hstack((np.cos(turn), np.sin(turn))) + (half - radius, thick - radius)
        self._pad = np.vstack(([(half, 0.0)], corner, corner[::-1] * (-1, 1), [(-half, 0.0)]))
        right = np.array([(0.3 * thick, 0.9 * thick), (0.6 * thick, reach / 2), (0.6 * thick, reach)])
        self._finger = np.vstack((right, right[::-1] * (-1, 1)))

    def at(self, jaws: ArrayLike) -> tuple[list[Array], list[Array]]:
        """Pads and fingers, polygons (k, 2) m, convex, lower jaw first. jaws: (4,) m, x1, y1, x2, y2."""
        ends = np.asarray(jaws, dtype=np.float64).reshape(2, 2)
        axis = ends[1] - ends[0]
        axis = axis / max(float(np.hypot(*axis)), 1e-12)
        across = np.array([axis[1], -axis[0]])
        placed = [
            [end + shape[:, :1] * across + shape[:, 1:] * outward for shape in (self._pad, self._finger)]
            for end, outward in zip(ends, (-axis, axis), strict=True)
        ]
        return [pad for pad, _ in placed], [finger for _, finger in placed]
