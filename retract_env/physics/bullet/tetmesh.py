"""A flap of cubes cut into five tetrahedra each, as Bullet takes it, with the section that is drawn of it.

Neighbouring cubes are cut as mirror images, so faces meet. Bullet has one material a body; a stiffer vein is
made by listing its tetrahedra several times, an odd number of times: an even one would cancel faces of the
surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from retract_env.errors import FlapRefused
from retract_env.mesh import SectionMesh, patch_ends
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

MOST_TETRAHEDRA = 20_000
"""Copies included. Bullet takes a microsecond for each of them a time step, of which a move has some hundred;
the paper's flap with twenty veins has 1,500 at `medium`."""
MOST_COPIES = 99
"""Stiffest vein, over the tissue's modulus: its tetrahedra are listed so often, and each copy costs as much
as another tetrahedron."""
LEAST_OVERHANG = 0.5
"""A patch that ends nearer than this, over its width, to the free end reaches up to it."""

# Corners of the five tetrahedra in the unit cube.
_FIVE = np.array(
    [
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
        [(1, 1, 0), (0, 1, 0), (1, 0, 0), (1, 1, 1)],
        [(1, 0, 1), (1, 0, 0), (0, 0, 1), (1, 1, 1)],
        [(0, 1, 1), (0, 1, 0), (0, 0, 1), (1, 1, 1)],
        [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)],
    ]
)


@dataclass(frozen=True)
class VeinRounding:
    """What became of a vein."""

    stiffness: float
    """its modulus over the tissue's, as in the scene"""
    copies: int
    """the same in the mesh: how many times its tetrahedra are listed"""
    area: float
    """m^2, of its outline"""
    meshed_area: float
    """m^2, of the tetrahedra whose centres lie in it, over the depth"""


@dataclass(frozen=True)
class TetMesh:
    """Linear tetrahedra over the whole depth, z in [-d/2, d/2]."""

    points: Array
    """(n, 3) m, at rest"""
    cells: Ints
    """(m, 4) positively oriented"""
    copies: Ints
    """(m,) how many times each is listed"""
    fixed: Ints
    """nodes of the fixed end"""
    patches: tuple[Ints, Ints]
    """nodes under the lower and the upper jaw"""
    section: SectionMesh
    """at a plane of nodes near the middle of the depth"""
    section_nodes: Ints
    """(k, 2) nodes whose middle is each node of the section"""
    share: csr_matrix
    """(section triangles, m) part of each tetrahedron that lies over or under a triangle"""
    veins: tuple[VeinRounding, ...]

    def vtk(self) -> str:
        """Legacy ASCII VTK, copies listed one after the other."""
        listed = np.repeat(self.cells, self.copies, axis=0)
        lines = ["# vtk DataFile Version 2.0", "flap", "ASCII", "DATASET UNSTRUCTURED_GRID"]
        lines.append(f"POINTS {len(self.points)} double")
        lines += [f"{x!r} {y!r} {z!r}" for x, y, z in self.points.tolist()]
        lines.append(f"CELLS {len(listed)} {5 * len(listed)}")
        lines += [f"4 {a} {b} {c} {d}" for a, b, c, d in listed.tolist()]
        lines.append(f"CELL_TYPES {len(listed)}")
        lines += ["10"] * len(listed)
        return "\n".join(lines) + "\n"


def tet_mesh(scene: Scene, jaw_x: float, along: float, across: int, deep: int) -> TetMesh:
    """Mesh the flap so that both jaw patches end on planes of nodes.

    jaw_x: m, middle of the patches; along: about the length of a cube over the flap's height; across, deep:
    cubes over the height and over a depth up to 1.5 heights; up to four times as many over a deeper flap.
    Raises ValueError for a grasp as `patch_ends`, FlapRefused for a vein stiffer than MOST_COPIES times the
    tissue.
    """
    tissue = scene.tissue
    low, high = patch_ends(scene, jaw_x)
    if low < -tissue.length + LEAST_OVERHANG * scene.jaws.width:
        low = -tissue.length
    xs = _lines([-tissue.length, low, high, 0.0], along * tissue.height)
    ys = np.linspace(0.0, tissue.height, across + 1)
    layers = (
        deep if tissue.depth <= 1.5 * tissue.height else min(deep * tissue.depth / tissue.height, 4 * deep)
    )
    half = tissue.depth / 2
    edge = half if scene.jaws.depth is None else scene.jaws.depth / 2
    zs = _lines([-half, -edge, edge, half], tissue.depth / layers)

    counts = (len(xs), len(ys), len(zs))
    if (listed := 5 * math.prod(n - 1 for n in counts)) > MOST_TETRAHEDRA:  # before they take memory
        raise _too_many(listed)
    points = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points), dtype=np.int32).reshape(counts)
    cubes = np.stack(np.meshgrid(*(np.arange(n - 1) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.broadcast_to(_FIVE, (len(cubes), *_FIVE.shape)).copy()
    odd = cubes.sum(axis=1) % 2 == 1
    corner[odd, ..., 0] = 1 - corner[odd, ..., 0]
    cells = number[tuple(np.moveaxis(cubes[:, None, None] + corner, -1, 0))].reshape(-1, 4)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    turned = np.linalg.det(edges) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]

    volume = np.abs(np.linalg.det(edges)) / 6
    near = 1e-9 * tissue.length
    held = (points[:, 0] > low - near) & (points[:, 0] < high + near) & (np.abs(points[:, 2]) < edge + near)
    lower, upper = (np.flatnonzero(held & (points[:, 1] == y)).astype(np.int32) for y in (0.0, ys[-1]))

    plane = int(np.abs(zs).argmin())
    beside = np.repeat(cubes[:, 2] == plane, 5)
    flat = number[:, :, plane]
    triangles = _faces(cells[beside], points, np.isin(cells[beside], flat))
    centres = points[cells].mean(axis=1)[:, :2]
    share = _share(points[triangles, :2], centres, np.repeat(cubes[:, 0] * across + cubes[:, 1], 5))
    vein, veins = _veins(scene, centres, volume)
    # a triangle shows the vein that has most of the volume over and under it
    parts = share.multiply(volume).tocsr()
    most = np.array([parts @ (vein == i) for i in range(-1, len(tissue.veins))]).argmax(axis=0) - 1
    section, section_nodes = _section(xs, ys, flat, triangles, most.astype(np.int32), (low, high))
    copies = np.array([1, *(v.copies for v in veins)], np.int32)[vein + 1]
    if (listed := int(copies.sum())) > MOST_TETRAHEDRA:
        raise _too_many(listed)
    return TetMesh(
        points, cells, copies, number[-1].ravel(), (lower, upper), section, section_nodes, share, veins
    )


def _too_many(listed: int) -> FlapRefused:
    return FlapRefused(
        f"tissue: {listed} tetrahedra, stiff veins counted several times, allowed in Bullet up to "
        f"{MOST_TETRAHEDRA}; a coarser resolution has fewer"
    )


def _lines(breaks: list[float], spacing: float) -> Array:
    """Coordinates from the first to the last break, all breaks among them, about `spacing` apart."""
    parts = [np.array(breaks[:1])]
    for low, high in pairwise(breaks):
        if high > low:
            parts.append(np.linspace(low, high, max(1, round((high - low) / spacing)) + 1)[1:])
    return np.concatenate(parts)


def _veins(scene: Scene, centres: Array, volume: Array) -> tuple[Ints, tuple[VeinRounding, ...]]:
    """The vein (m,) that each tetrahedron's centre (m, 2) lies in, -1 for tissue, and what was rounded."""
    tissue = scene.tissue
    vein = np.full(len(centres), -1, np.int32)
    roundings = []
    for i, v in enumerate(tissue.veins):
        ratio = v.modulus / tissue.modulus
        copies = max(1, 2 * round((ratio - 1) / 2) + 1)
        if copies > MOST_COPIES:
            most = MOST_COPIES * tissue.modulus
            raise FlapRefused(
                f"tissue.veins[{i}].modulus = {v.modulus:g} Pa, allowed in Bullet up to {most:g} Pa"
            )
        outline = shapely.Polygon(v.outline)
        inside = shapely.contains_xy(outline, *centres.T)
        vein[inside] = i
        area = float(volume[inside].sum()) / tissue.depth
        roundings.append(VeinRounding(ratio, copies, float(outline.area), area))
    return vein, tuple(roundings)


def _faces(cells: Ints, points: Array, on: NDArray[np.bool_]) -> Ints:
    """Faces (k, 3) of the cells that have three of their nodes on the plane, counter-clockwise in x and y."""
    three = on.sum(axis=1) == 3
    faces: Ints = cells[three][on[three]].reshape(-1, 3)
    p = points[faces, :2]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    turned = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
    faces[turned] = faces[turned][:, ::-1]
    return faces


def _share(corners: Array, centres: Array, column: Ints) -> csr_matrix:
    """Tetrahedra to the triangle of their column that their centre lies in, half to each of two.

    corners: (k, 3, 2) m, two triangles a column one after the other; centres: (m, 2) m; column: (m,).
    """
    rows, parts = [], []
    for side in range(2):
        row = 2 * column + side
        p = corners[row]
        edges, away = np.roll(p, -1, axis=1) - p, centres[:, None] - p
        left = edges[..., 0] * away[..., 1] - edges[..., 1] * away[..., 0]
        area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
        rows.append(row)
        parts.append((left > -1e-9 * area[:, None]).all(axis=1))
    inside = np.array(parts, float)
    inside /= inside.sum(axis=0)
    elements = np.tile(np.arange(len(centres)), 2)
    shape = (len(corners), len(centres))
    share = csr_matrix((inside.ravel(), (np.concatenate(rows), elements)), shape=shape)
    share.eliminate_zeros()
    return share


def _section(
    xs: Array, ys: Array, plane: Ints, triangles: Ints, vein: Ints, ends: tuple[float, float]
) -> tuple[SectionMesh, Ints]:
    """Quadratic triangles from linear ones: with the edges' middles their nodes are those of a finer grid.

    plane: (nx, ny) nodes of the mesh; triangles: (k, 3) of them. Returns the section and the two nodes that
    each of its nodes is the middle of.
    """
    place = np.full((int(plane.max()) + 1, 2), -1)
    nx, ny = plane.shape
    place[plane] = 2 * np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1)
    pairs = np.concatenate(
        [
            np.stack([triangles, triangles], axis=-1),
            np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1),
        ],
        axis=1,
    )
    at = place[pairs].sum(axis=2) // 2
    six = (at[..., 0] * (2 * ny - 1) + at[..., 1]).astype(np.int32)
    nodes = np.empty(((2 * nx - 1) * (2 * ny - 1), 2), np.int32)
    nodes[six] = pairs

    def refined(lines: Array) -> Array:
        out = np.empty(2 * len(lines) - 1)
        out[::2], out[1::2] = lines, (lines[1:] + lines[:-1]) / 2
        return out

    fine_x, fine_y = refined(xs), refined(ys)
    number = np.arange(len(nodes), dtype=np.int32).reshape(len(fine_x), len(fine_y))
    near = 1e-9 * (xs[-1] - xs[0])
    under = np.flatnonzero((fine_x > ends[0] - near) & (fine_x < ends[1] + near))
    length = np.zeros(len(fine_x))
    for k, weight in enumerate((1, 4, 1)):
        np.add.at(length, 2 * np.arange(nx - 1) + k, np.diff(xs) * weight / 6)
    section = SectionMesh(
        points=np.stack(np.meshgrid(fine_x, fine_y, indexing="ij"), axis=-1).reshape(-1, 2),
        triangles=six,
        vein=vein,
        fixed=number[-1],
        patches=(number[under, 0], number[under, -1]),
        bottom=number[:, 0],
        bottom_length=length,
    )
    return section, nodes
