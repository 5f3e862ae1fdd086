"""What a drawing of the section shows, as plain geometry in metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.mesh import quadratic_shares
from retract_env.objectives import bed_hits

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh
    from retract_env.scene import Scene, Vein

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

FINGER, PAD = 0.14, 0.016  # of the flap's length

SMALL = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # a quadratic triangle as four plain ones


class SectionTopology:
    """What is drawn of a section mesh, whatever its shape now.

    nodes: (v,) node of each drawn vertex. faces: (4 m, 3) vertices; straight: (m, 3), with straight edges,
    which are drawn faster and differ by less than a pixel. outline: (k,) boundary nodes from the foot of the
    fixed end along the lower surface and round, the first again at the end.
    """

    def __init__(self, section: SectionMesh, veins: Sequence[Vein]) -> None:
        """veins: of the scene, drawn as they are there, whatever corners the mesh gives them."""
        triangles, vein = np.asarray(section.triangles), np.asarray(section.vein)
        count = len(section.points)
        # Strain jumps between vein and tissue, so a node on a vein's outline is drawn as two vertices.
        sided = triangles + count * (vein >= 0)[:, None]
        vertices, owner = np.unique(sided, return_inverse=True)
        self._vertex: Ints = owner.reshape(triangles.shape)
        self._shares: Ints = np.bincount(self._vertex.ravel())
        self.nodes: Ints = vertices % count
        self.faces: Ints = np.ascontiguousarray(self._vertex[:, SMALL].reshape(-1, 3))
        self.straight: Ints = self._vertex[:, :3]
        rings = []
        for one in veins:
            within, shares = embedded(section, vein_ring(one.outline, section))
            rings.append((triangles[within].astype(np.intp), shares))
        gap = np.zeros((1, 6), np.intp), np.full((1, 6), np.nan)
        self._ring_nodes, self._ring_shares = (
            np.concatenate([np.concatenate((ring[k], gap[k])) for ring in rings] or [gap[k][:0]])
            for k in range(2)
        )
        self.outline: Ints = _loop(np.asarray(section.points), np.asarray(section.boundary))

    def vein_lines(self, points: Array) -> Array:
        """(k, 2) the veins' closed outlines, a gap after each, for nodes at points (n, 2), m or pixels."""
        rings: Array = (points[self._ring_nodes] * self._ring_shares[..., None]).sum(axis=1)
        return rings

    def smooth(self, strain: Array) -> Array:
        """(v,) strain at the vertices: mean of the (m,) triangles around each, on its side of a vein."""
        return np.bincount(self._vertex.ravel(), np.repeat(strain, 6)) / self._shares


def vein_ring(outline: Sequence[tuple[float, float]], section: SectionMesh) -> Array:
    """(k, 2) m, a closed outline in pieces so short that they may bend with the tissue."""
    corners = np.array([*outline, outline[0]])
    longest = np.ptp(section.points[:, 1]) / 8
    pieces = []
    for p, q in pairwise(corners):
        count = max(math.ceil(math.dist(p, q) / longest), 1)
        pieces.append(p + np.arange(count)[:, None] / count * (q - p))
    return np.concatenate([*pieces, corners[:1]])


def embedded(section: SectionMesh, places: Array) -> tuple[Ints, Array]:
    """The triangles (k,) that the places (k, 2) m lie in, and the shares (k, 6) of their nodes that move the
    places along with them."""
    corners = section.corners
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    off = places[:, None] - corners[:, 0]
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    b = (off[..., 0] * d2[:, 1] - off[..., 1] * d2[:, 0]) / area
    c = (d1[:, 0] * off[..., 1] - d1[:, 1] * off[..., 0]) / area
    low = np.stack([1 - b - c, b, c], axis=-1)
    triangle = low.min(axis=-1).argmax(axis=1)  # the one that it lies in, or misses by rounding
    shares = quadratic_shares(low[np.arange(len(places)), triangle])
    return np.asarray(triangle, np.intp), shares


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


def hidden_region(outline: Array, camera: ArrayLike) -> Array:
    """(r, 2) m, polygon that the flap hides from the camera: under the flap, down to the bed.

    outline: (k, 2) m, from the foot of the fixed end along the lower surface and round. The polygon ends at
    the first ray, from the camera's side, that does not get past the flap.
    """
    hits = bed_hits(outline, camera)
    hits = np.where(np.isfinite(hits), hits, np.inf)
    first = int(np.argmin(hits))
    return np.vstack((outline[: first + 1], [(hits[first], 0.0)]))


def sight_reach(target: ArrayLike, away: ArrayLike, distance: float, left: float, top: float) -> float:
    """How much of the line of sight a picture shows from B on: up to A, or to a border of the picture.

    target: B (2,); away: (2,) unit, from B to A; distance of the two; borders x = left and y = top. All in
    the same unit, y up.
    """
    (x, y), (across, up) = np.asarray(target, np.float64).tolist(), np.asarray(away, np.float64).tolist()
    room = [distance, (top - y) / up]
    if across < 0:
        room.append((left - x) / across)
    return float(min(room))


class JawShapes:
    """Two rounded pads outside the tissue, as wide as a jaw patch, and the gripper's fingers behind them."""

    def __init__(self, scene: Scene, bold: float = 1.0) -> None:
        """bold: how many times as thick as they are. A tool that is in sight is as the scene says."""
        length, half, how = scene.tissue.length, bold * scene.jaws.width / 2, scene.jaws
        thick, reach = bold * PAD * length, FINGER * length
        if how.in_sight:
            thick, reach = how.thickness, how.thickness + how.stem
        radius = 0.7 * min(half, thick)
        turn = np.linspace(0.0, np.pi / 2, 5)[:, None]
        corner = radius * np.hstack((np.cos(turn), np.sin(turn))) + (half - radius, thick - radius)
        pad = np.vstack(([(half, 0.0)], corner, corner[::-1] * (-1, 1), [(-half, 0.0)]))
        slim = np.array([0.25, 0.25, 0.25] if how.in_sight else [0.3, 0.6, 0.6]) * thick
        right = np.stack([slim, (0.9 * thick, reach / 2, reach)], axis=1)
        finger = np.vstack((right, right[::-1] * (-1, 1)))
        self._finger, self._pad = (np.vstack((s, s[:1], [(np.nan, np.nan)])) for s in (finger, pad))

    def at(self, jaws: ArrayLike) -> tuple[Array, Array]:
        """Fingers and pads, each (2, k, 2) m: convex polygons, the lower jaw's first.

        A polygon's last point but one is its first again, the last is a gap. jaws: (4,) m, x1, y1, x2, y2.
        """
        ends = np.asarray(jaws, dtype=np.float64).reshape(2, 2)
        axis = ends[1] - ends[0]
        axis = axis / max(math.hypot(*axis), 1e-12)
        across = (axis[1], -axis[0])
        frames = np.array([(across, -axis), (across, axis)])
        place = [s[:, :1] * frames[:, :1] + s[:, 1:] * frames[:, 1:] for s in (self._finger, self._pad)]
        return place[0] + ends[:, None], place[1] + ends[:, None]
