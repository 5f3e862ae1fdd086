"""What pushes tissue away besides the bed: the block that holds the fixed end, and the sides of jaws' pads.

Both are rigid and without friction, and push nodes of the surface by a penalty. The block's sides lie along
the axes, so that it adds to the tangent's diagonal alone; a node goes out the shorter way, and where both are
as long the energy is continuous and the push turns. A pad's side stands upright on the end of the patch,
without end, and turns with it: tissue that a firm grip squeezes out beside the patch leans against it instead
of passing through it. A node at p is behind the side of a pad, whose patch leads from o to its end e, by

    d = (e - p) . (e - o) / |e - o| - r,

bilinear in the positions, so that derivatives are exact and the pad's push and the tissue's are opposite, in
force and in moment. The pad's edge is round by r: a soft solid folds at a sharp edge on the scale of the
elements, and would touch it in every grip.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.fem.prism import AnyInts, Prism
from retract_env.mesh import SectionMesh
from retract_env.mesh.section import edge_lengths
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

ROUND = 0.1
"""Radius of a pad's edge, over the patch's width. The surface comes as far over the edge in 11 of 360
retractions by `ctc` and `circular`, and in 107 of 180 by `linear60` (benchmarks/contact.py)."""
PASSES_OVER = 1.5
"""Over the pad's thickness: how far from the edge, at rest, nodes count; what is farther away goes over the
pad, not against its side."""
PAD_STIFFNESS, BLOCK_STIFFNESS = 10.0, 20.0
"""Per area, in E of the tissue over the patch's width, and in E / h: pushes of a tenth of E, as they occur,
give by a hundredth of the width, and by half a hundredth of the height."""


class Contact:
    """Block and pads, for the unknowns u (n,) of a prism."""

    def __init__(
        self, scene: Scene, section: SectionMesh, prism: Prism, held: AnyInts, numbers: AnyInts, indptr: Ints
    ):
        """held: depth levels that the jaws hold; numbers: (n,) of the free unknowns, -1 for others; indptr:
        (f + 1,) where rows begin in the tangent, an upper triangle."""
        tissue, jaws = scene.tissue, scene.jaws
        every = np.arange(prism.levels)
        area = prism.depth_weight[:, None] * edge_lengths(section.points, section.boundary)
        # of nodes on the surface that move: those of a patch do where narrow jaws do not hold them
        level, node = np.nonzero(area)
        x = prism.x(np.arange(len(section.points)), every).reshape(area.shape)[level, node]
        moves = (numbers[x] >= 0) & (numbers[x + 1] >= 0)
        self._height = tissue.height
        self._x, self._rest = x[moves], section.points[node[moves]]
        self._stiffness = BLOCK_STIFFNESS * tissue.modulus / tissue.height * area[level, node][moves]
        self._rows = np.stack([indptr[numbers[self._x]], indptr[numbers[self._x + 1]]], axis=-1)

        sides = _beside_pads(section, PASSES_OVER * jaws.thickness)
        self._pads = np.stack([prism.x(nodes, held) for nodes in sides.T], axis=-1)
        self._pads_rest = np.tile(section.points[sides], (len(held), 1, 1))
        beside = area[held][:, sides[:, 0]].ravel()
        self._pads_stiffness = PAD_STIFFNESS * tissue.modulus / jaws.width * beside
        self._pads_rows = np.stack([indptr[numbers[self._pads[:, 0] + k]] for k in (0, 1)], axis=-1)
        self._pads_given = self._pads, self._pads_rest, ROUND * jaws.width, self._pads_stiffness

    def add_force(self, u: Array, force: Array, on_pads: bool = False) -> float:
        """Add to the forces (n,) N that hold the nodes; returns the energy, J.

        on_pads: add also what holds the pads' sides. It is left out of the forces on jaws, as friction on the
        patches has not to hold it.
        """
        energy = _block_force(u, self._x, self._rest, self._height, self._stiffness, force)
        return float(energy + _pads_force(u, *self._pads_given, on_pads, force))

    def add_tangent(self, u: Array, values: Array) -> None:
        """Add to the tangent's upper triangle over the free unknowns."""
        _block_tangent(u, self._x, self._rest, self._height, self._stiffness, self._rows, values)
        _pads_tangent(u, *self._pads_given, self._pads_rows, values)

    def add_tangent_times(self, u: Array, v: Array, out: Array, on_pads: bool = False) -> None:
        """Add the tangent at u, columns of prescribed unknowns too, applied to v (n,); on_pads: as above."""
        _block_times(u, v, self._x, self._rest, self._height, self._stiffness, out)
        _pads_times(u, v, *self._pads_given, on_pads, out)

    def touches(self, u: Array) -> tuple[int, int]:
        """How many nodes are pressed into the block, and how many against pads' sides."""
        block, pads = np.zeros_like(u), np.zeros_like(u)
        _block_force(u, self._x, self._rest, self._height, self._stiffness, block)
        _pads_force(u, *self._pads_given, False, pads)
        x, beside = self._x, self._pads[:, 0]
        return (
            int(np.count_nonzero(block[x] + block[x + 1])),
            int(np.count_nonzero(np.hypot(pads[beside], pads[beside + 1]))),
        )


def _beside_pads(section: SectionMesh, reach: float) -> Ints:
    """(s, 3) for every surface node within reach of an end of a patch: the node, that end, the other end."""
    x, y = section.points.T
    surface, found = np.unique(section.boundary), [np.empty((0, 3), np.int32)]
    for patch in section.patches:
        if len(patch) == 0:
            continue
        first, last = patch[x[patch].argmin()], patch[x[patch].argmax()]
        level = np.setdiff1d(surface[np.abs(y[surface] - y[first]) < 1e-6 * reach], section.fixed)
        for end, other in ((first, last), (last, first)):
            away = (x[level] - x[end]) * np.sign(x[end] - x[other])
            near = level[(away > 0) & (away <= reach)]
            found.append(np.stack([near, np.full_like(near, end), np.full_like(near, other)], axis=-1))
    return np.concatenate(found)


@njit(cache=True, nogil=True)
def _block_depth(u, at, rest, height):
    """How far a point is inside the block, and whether the way out leads up rather than aside."""
    x, deep = rest[0] + u[at], height - rest[1] - u[at + 1]
    return min(x, deep), deep <= x


@njit(cache=True, nogil=True)
def _block_force(u, x, rest, height, stiffness, force):
    energy = 0.0
    for i in range(len(x)):
        depth, up = _block_depth(u, x[i], rest[i], height)
        if depth > 0.0:
            energy += 0.5 * stiffness[i] * depth * depth
            if up:
                force[x[i] + 1] -= stiffness[i] * depth
            else:
                force[x[i]] += stiffness[i] * depth
    return energy


@njit(cache=True, nogil=True)
def _block_tangent(u, x, rest, height, stiffness, rows, values):
    for i in range(len(x)):
        depth, up = _block_depth(u, x[i], rest[i], height)
        if depth > 0.0:
            values[rows[i, 1 if up else 0]] += stiffness[i]


@njit(cache=True, nogil=True)
def _block_times(u, v, x, rest, height, stiffness, out):
    for i in range(len(x)):
        depth, up = _block_depth(u, x[i], rest[i], height)
        if depth > 0.0:
            at = x[i] + 1 if up else x[i]
            out[at] += stiffness[i] * v[at]


@njit(cache=True, nogil=True)
def _pad_depth(u, at, rest, edge):
    """d, from the node to the end of the patch, and the direction from its other end to this one; and the
    patch's width."""
    px, py = rest[0, 0] + u[at[0]], rest[0, 1] + u[at[0] + 1]
    ex, ey = rest[1, 0] + u[at[1]], rest[1, 1] + u[at[1] + 1]
    ox, oy = rest[2, 0] + u[at[2]], rest[2, 1] + u[at[2] + 1]
    wide = abs(rest[1, 0] - rest[2, 0])
    ax, ay = ex - px, ey - py
    tx, ty = (ex - ox) / wide, (ey - oy) / wide
    return ax * tx + ay * ty - edge, ax, ay, tx, ty, wide


@njit(cache=True, nogil=True)
def _pads_force(u, at, rest, edge, stiffness, on_pads, force):
    energy = 0.0
    for i in range(len(at)):
        depth, ax, ay, tx, ty, wide = _pad_depth(u, at[i], rest[i], edge)
        if depth > 0.0:
            push = stiffness[i] * depth
            energy += 0.5 * push * depth
            p, e, o = at[i]
            force[p] -= push * tx
            force[p + 1] -= push * ty
            if on_pads:
                force[e] += push * (tx + ax / wide)
                force[e + 1] += push * (ty + ay / wide)
                force[o] -= push * ax / wide
                force[o + 1] -= push * ay / wide
    return energy


@njit(cache=True, nogil=True)
def _pads_tangent(u, at, rest, edge, stiffness, rows, values):
    for i in range(len(at)):
        depth, _, _, tx, ty, _ = _pad_depth(u, at[i], rest[i], edge)
        if depth > 0.0:
            values[rows[i, 0]] += stiffness[i] * tx * tx
            values[rows[i, 0] + 1] += stiffness[i] * tx * ty
            values[rows[i, 1]] += stiffness[i] * ty * ty


@njit(cache=True, nogil=True)
def _pads_times(u, v, at, rest, edge, stiffness, on_pads, out):
    for i in range(len(at)):
        depth, ax, ay, tx, ty, wide = _pad_depth(u, at[i], rest[i], edge)
        if depth > 0.0:
            p, e, o = at[i]
            # changes of what `_pad_depth` returns
            bx, by = v[e] - v[p], v[e + 1] - v[p + 1]
            sx, sy = (v[e] - v[o]) / wide, (v[e + 1] - v[o + 1]) / wide
            push, more = stiffness[i] * depth, stiffness[i] * (bx * tx + by * ty + ax * sx + ay * sy)
            out[p] -= more * tx + push * sx
            out[p + 1] -= more * ty + push * sy
            if on_pads:
                out[e] += more * (tx + ax / wide) + push * (sx + bx / wide)
                out[e + 1] += more * (ty + ay / wide) + push * (sy + by / wide)
                out[o] -= more * ax / wide + push * bx / wide
                out[o + 1] -= more * ay / wide + push * by / wide
