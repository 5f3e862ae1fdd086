"""The flap, its veins and the jaws as solids: their section, drawn out over the depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from retract_env.drawing.shapes import SectionTopology
    from retract_env.mesh import SectionMesh

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

LIGHT: Array = np.array([-0.3, 0.75, 0.6]) / np.linalg.norm([-0.3, 0.75, 0.6])
"""(3,) unit, where the light comes from: from above, the viewer's side, and the free end."""
AMBIENT, GLOSS, SHARP = 0.72, 0.14, 24
"""Light from all around; the sheen of wet tissue, and how narrow it is. Lambert's law has the rest."""


class Solid(NamedTuple):
    """A surface of flat faces."""

    points: Array
    """(v, 3) m"""
    faces: Ints
    """(m, 3)"""
    normals: Array
    """(v, 3) unit, out of the solid"""


def lit(solid: Solid, eye: Array, gloss: float = 0.0) -> Array:
    """(v,) light at the corners: Lambert's law over an ambient part, and beyond 1 a sheen."""
    light = AMBIENT + (1 - AMBIENT) * np.maximum(solid.normals @ LIGHT, 0.0)
    if gloss > 0.0:
        way = eye - solid.points
        half = way / np.linalg.norm(way, axis=1, keepdims=True) + LIGHT
        aligned = (solid.normals * half).sum(axis=1) / np.linalg.norm(half, axis=1)
        light = light + gloss * np.maximum(aligned, 0.0) ** SHARP
    return np.asarray(light, dtype=np.float64)


def _left_of(points: Array) -> Array:
    """(n, 2) unit normals on the left of a line through points (n, 2), the mean of both sides at each."""
    along = np.empty_like(points)
    along[1:-1] = points[2:] - points[:-2]
    along[0], along[-1] = points[1] - points[0], points[-1] - points[-2]
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1])[:, None], 1e-12)
    return np.column_stack((-along[:, 1], along[:, 0]))


def _strip(count: int) -> Ints:
    """(2 (count - 1), 3) faces between two rows of vertices, 0 to count - 1 and count to 2 count - 1."""
    near = np.arange(count - 1)
    far = near + count
    return np.concatenate([np.stack([near, near + 1, far], 1), np.stack([near + 1, far + 1, far], 1)])


class FlapSolid:
    """A flap of one section mesh: the deformed section, at every depth the same.

    Physics in three dimensions bulge a little more in the middle of the depth than at its sides; what a
    state tells is the section, so this is what is drawn.
    """

    def __init__(self, topology: SectionTopology, section: SectionMesh, depth: float):
        """depth: m."""
        self.topology, self.half = topology, depth / 2
        outline, rest = topology.outline, np.asarray(section.points)[topology.outline]
        (left, low), (right, high) = rest.min(axis=0), rest.max(axis=0)
        near = 1e-6 * (right - left)
        # the sides between the section's corners: on each the surface is smooth; that of the fixed end is
        # not seen
        middle = (rest[1:] + rest[:-1]) / 2
        sides = (
            abs(middle[:, 1] - low) < near,
            abs(middle[:, 0] - left) < near,
            abs(middle[:, 1] - high) < near,
        )
        runs = [np.flatnonzero(side) for side in sides]
        self._runs: list[Ints] = [outline[run[0] : run[-1] + 2] for run in runs]
        drawn = np.full(len(section.points), -1)
        drawn[topology.nodes[::-1]] = np.arange(len(topology.nodes))[::-1]  # of two, the one of the tissue
        self.skin_vertices: Ints = np.concatenate([drawn[np.tile(run, 2)] for run in self._runs])
        """(v,) drawn vertex of the topology at each corner of `skin`"""
        starts = np.cumsum([0, *(2 * len(run) for run in self._runs)])
        self._skin_faces: Ints = np.concatenate(
            [_strip(len(run)) + start for run, start in zip(self._runs, starts, strict=False)]
        )
        corners = [self._runs[1][0], self._runs[1][-1], self._runs[2][-1]]
        self._edges: Ints = np.array(corners)

    def skin(self, points: Array) -> Solid:
        """Lower surface, free end and upper surface of a section with nodes at points (n, 2) m."""
        at, out = [], []
        for run in self._runs:
            line = points[run]
            normal = _left_of(line)
            at += [line, line]
            out += [normal, normal]
        flat, normals = np.concatenate(at), np.concatenate(out)
        z = np.concatenate([np.repeat((self.half, -self.half), len(run)) for run in self._runs])
        return Solid(
            np.column_stack((flat, z)), self._skin_faces, np.column_stack((normals, np.zeros(len(normals))))
        )

    def cut(self, points: Array, side: int) -> Solid:
        """The section where it ends, at z = d/2 (side 1) or -d/2 (side -1)."""
        flat = points[self.topology.nodes]
        z, nothing = np.full(len(flat), side * self.half), np.zeros(len(flat))
        normals = np.column_stack((nothing, nothing, nothing + side))
        return Solid(np.column_stack((flat, z)), self.topology.faces, normals)

    def lines(self, points: Array, side: int) -> Array:
        """(k, 3) m, outline of the cut and edges over the depth, with gaps."""
        outline = points[self.topology.outline]
        loop = np.column_stack((outline, np.full(len(outline), side * self.half)))
        gap, parts = np.full((1, 3), np.nan), [loop]
        for x, y in points[self._edges]:
            parts += [gap, np.array([(x, y, self.half), (x, y, -self.half)])]
        return np.concatenate(parts)

    def vein_lines(self, points: Array, side: int) -> Array:
        """(k, 3) m, the veins' outlines where they are cut, with gaps."""
        flat = self.topology.vein_lines(points)
        return np.column_stack((flat, np.full(len(flat), side * self.half)))

    def veins(self, points: Array) -> Solid:
        """The veins' surfaces over the whole depth."""
        flat = self.topology.vein_lines(points)
        if not len(flat):
            return Solid(np.empty((0, 3)), np.empty((0, 3), np.intp), np.empty((0, 3)))
        normals = np.nan_to_num(
            _left_of(flat)
        )  # what faces away from the light is as bright as its other side
        away = normals @ LIGHT[:2] < 0
        normals[away] *= -1
        near, far = (np.column_stack((flat, np.full(len(flat), z))) for z in (self.half, -self.half))
        out = np.column_stack((normals, np.zeros(len(flat))))
        return Solid(np.concatenate((near, far)), _strip(len(flat)), np.concatenate((out, out)))


def bar(shape: Array, half: float) -> tuple[Solid, Array]:
    """A convex polygon (n, 2) m drawn out from z = -half to half, and the lines (k, 3) m of its edges that
    are cut, with a gap."""
    count = len(shape)
    ahead = np.roll(shape, -1, axis=0)
    along = ahead - shape
    normals = np.column_stack((along[:, 1], -along[:, 0], np.zeros(count)))
    if float((shape[:, 0] * ahead[:, 1] - shape[:, 1] * ahead[:, 0]).sum()) < 0:
        normals *= -1
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    near, far = (np.column_stack((shape, np.full(count, z))) for z in (half, -half))
    near_ahead, far_ahead = np.roll(near, -1, axis=0), np.roll(far, -1, axis=0)
    k = np.arange(count)
    sides = [
        np.stack([k, k + count, k + 2 * count], 1),
        np.stack([k + count, k + 3 * count, k + 2 * count], 1),
    ]
    fan = np.stack([np.zeros(count - 2, np.intp), k[1:-1], k[2:]], 1)
    faces = np.concatenate([*sides, fan + 4 * count, fan + 5 * count])
    ends = [np.tile((0.0, 0.0, side), (count, 1)) for side in (1.0, -1.0)]
    points = np.concatenate([near, near_ahead, far, far_ahead, near, far])
    solid = Solid(points, faces, np.concatenate([normals] * 4 + ends))
    gap = np.full((1, 3), np.nan)
    return solid, np.concatenate([near, near[:1], gap, far, far[:1], gap])
