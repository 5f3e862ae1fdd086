"""What of a flap's mesh is seen from outside, veins included: vertices, faces and edges of its section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from retract_env.drawing.shapes import SMALL, embedded, vein_ring

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_EDGES = np.array([[0, 3, 1], [1, 4, 2], [2, 5, 0]])


@dataclass(frozen=True)
class Surface:
    """The section as the page draws it: the faces close both ends of the depth, the edges are drawn out over
    it. A node where a vein meets tissue is two vertices, as strain jumps there."""

    nodes: Ints
    """(v,) the node that moves each vertex; from the mesh's number of nodes on, one of `places`"""
    faces: Ints
    """(f, 3) vertices, counter-clockwise"""
    in_vein: NDArray[np.bool_]
    """(f,) whether a face is a vein's"""
    skin: Ints
    """(s, 2) edges of the flap's outline that are tissue's, counter-clockwise"""
    walls: Ints
    """(w, 2) edges round the veins, counter-clockwise"""
    rings: tuple[tuple[int, int], ...]
    """first vertex and number of vertices of each vein that the mesh does not follow: its outline"""
    within: Ints
    """(k,) triangles that the vertices of those outlines lie in"""
    shares: Array
    """(k, 6) of those triangles' nodes"""
    triangles: Ints
    """(m, 6) vertices of the mesh's triangles"""
    mesh_triangles: Ints
    """(m, 6) nodes of the same"""

    def moved(self, points: Array) -> Array:
        """(n + k, c) where all that moves vertices is, for the mesh's nodes at points (n, c)."""
        own = (points[self.mesh_triangles[self.within]] * self.shares[..., None]).sum(axis=1)
        return np.concatenate([points, own])

    def strains(self, strain: Array) -> Array:
        """(v,) strain at the vertices, of (m,) at the triangles: their mean around it, on its own side."""
        count = np.bincount(self.triangles.ravel())
        sums = np.bincount(self.triangles.ravel(), np.repeat(strain, 6))
        return np.concatenate([sums / count, strain[self.within]])


def surface_of(section: SectionMesh) -> Surface:
    """The surface of a flap with that section."""
    triangles, vein = np.asarray(section.triangles, np.intp), np.asarray(section.vein, np.intp)
    count = len(section.points)
    numbered, vertices = np.unique(triangles + count * (vein[:, None] + 1), return_inverse=True)
    corners = vertices.reshape(triangles.shape)
    places, within, shares, rings = numbered % count, [], [], []
    walls = [_pairs(_around(corners[vein >= 0]))]
    begin = len(places)
    for one in section.smeared:
        outline = vein_ring(one.outline, section)[:-1]
        inside, share = embedded(section, outline)
        within.append(inside)
        shares.append(share)
        rings.append((begin, len(outline)))
        along = begin + np.arange(len(outline))
        walls.append(np.stack([along, np.roll(along, -1)], axis=1))
        begin += len(outline)
    extra = count + np.arange(begin - len(places))
    outer = np.isin(triangles[:, _EDGES][..., 1], np.asarray(section.boundary)[:, 1])
    return Surface(
        nodes=np.concatenate([places, extra]),
        faces=corners[:, SMALL].reshape(-1, 3),
        in_vein=np.repeat(vein >= 0, 4),
        skin=_pairs(corners[:, _EDGES][outer & (vein < 0)[:, None]]),
        walls=np.concatenate(walls),
        rings=tuple(rings),
        within=np.concatenate([*within, np.empty(0, np.intp)]),
        shares=np.concatenate([*shares, np.empty((0, 6))]),
        triangles=corners,
        mesh_triangles=triangles,
    )


def _around(triangles: Ints) -> Ints:
    """(e, 3) edges, corner, middle, corner, that belong to one triangle alone."""
    edges = triangles[:, _EDGES].reshape(-1, 3)
    _, first, times = np.unique(edges[:, 1], return_index=True, return_counts=True)
    found: Ints = edges[np.sort(first[times == 1])]
    return found


def _pairs(edges: Ints) -> Ints:
    """(2 e, 2) halves of quadratic edges (e, 3)."""
    return edges[:, [[0, 1], [1, 2]]].reshape(-1, 2)
