"""The flap as a prism: numbering of unknowns over section nodes and depth levels, element blocks, weights of
nodes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.elements import (
    TRIANGLE_RULES,
    ElementBlock,
    extruded_block,
    quadratic_depth,
    symmetric_depth,
)
from retract_env.fem.smear import relative_stiffness
from retract_env.mesh import SectionMesh
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
AnyInts = NDArray[np.integer[Any]]


def depth_breaks(depth: float, height: float, jaw_depth: float | None, per_height: float = 0.8) -> Array:
    """Where layers end, m: from 0 at the plane of symmetry to depth / 2, with a break at the jaws' edge.

    A flap up to 1.5 times as deep as high gets one layer, which is 0.1 % off on eps_1%. Deeper ones get
    `per_height` layers for each height of depth where strain is uneven over it, under narrow jaws, and half
    as many where jaws hold the whole depth (35 mm of it with 20 veins: 0.04 % off).
    """
    half = depth / 2
    if jaw_depth is None or jaw_depth >= depth:
        edges, per_height = [0.0, half], per_height / 2
    else:
        edges = [0.0, jaw_depth / 2, half]
    parts = []
    for low, high in pairwise(edges):
        count = 1 if high - low <= 0.75 * height else math.ceil((high - low) / height * per_height)
        parts.append(np.linspace(low, high, count + 1)[1:])
    return np.concatenate([[0.0], *parts])


def level_count(scene: Scene, per_height: float = 0.8) -> int:
    """Levels of nodes that a `Prism` has: two of its first layer, and two more of each other one."""
    tissue = scene.tissue
    return 2 * len(depth_breaks(tissue.depth, tissue.height, scene.jaws.depth, per_height)) - 2


def unknowns(section: SectionMesh, scene: Scene, per_height: float = 0.8) -> int:
    """How many a `Prism` has."""
    return (3 * level_count(scene, per_height) - 1) * len(section.points)


class Prism:
    """Unknowns and elements of the extruded section, for the half depth z >= 0.

    Section node i owns `stride` unknowns in a row: (u_x, u_y) of each level, then u_z of each level but z =
    0.
    """

    def __init__(self, section: SectionMesh, scene: Scene, triangle_points: int = 3, per_height: float = 0.8):
        tissue = scene.tissue
        self.section = section
        self.breaks = depth_breaks(tissue.depth, tissue.height, scene.jaws.depth, per_height)
        middles = (self.breaks[1:-1] + self.breaks[2:]) / 2
        rest = np.stack([middles, self.breaks[2:]], axis=1).ravel()
        self.z = np.concatenate([self.breaks[:2], rest])
        """(levels,) m"""
        self.levels = len(self.z)
        self.stride = 3 * self.levels - 1
        self.size = self.stride * len(section.points)
        modulus = np.array([tissue.modulus, *(v.modulus for v in tissue.veins)])
        poisson = np.array([tissue.poisson, *(v.poisson for v in tissue.veins)])
        material = section.vein + 1
        relative = None
        if section.smeared:
            points, _ = TRIANGLE_RULES[triangle_points]
            relative = relative_stiffness(section.corners, points, modulus[material], section.smeared)
        self.depth_weight = np.zeros(self.levels)
        """(levels,) m, half depth that belongs to each level of nodes"""
        blocks: list[ElementBlock] = []
        for layer in range(len(self.breaks) - 1):
            thickness = self.breaks[layer + 1] - self.breaks[layer]
            depth = symmetric_depth(thickness) if layer == 0 else quadratic_depth(thickness)
            xy = np.arange(2) if layer == 0 else np.arange(3) + 2 * layer - 1
            z = xy[1:] if layer == 0 else xy
            dofs = np.concatenate(
                [self.x(section.triangles, xy), self.y(section.triangles, xy), self.w(section.triangles, z)],
                axis=1,
            )
            blocks.append(
                extruded_block(
                    section.corners,
                    depth,
                    dofs,
                    modulus[material],
                    poisson[material],
                    triangle_points,
                    relative,
                )
            )
            self.depth_weight[xy] += depth[4] @ depth[0]
        self.blocks = blocks
        # A quadratic triangle's load sits on its edge middles alone.
        d1, d2 = section.corners[:, 1] - section.corners[:, 0], section.corners[:, 2] - section.corners[:, 0]
        area = 0.5 * (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])
        self.area = np.zeros(len(section.points))
        """(n,) m^2, section area that belongs to each section node"""
        np.add.at(self.area, section.triangles[:, 3:], area[:, None] / 3)

    def x(self, nodes: AnyInts, levels: AnyInts) -> Ints:
        """Unknowns u_x of nodes (..., k) on levels (l,): (..., l * k), level by level."""
        return self._at(nodes, 2 * np.asarray(levels))

    def y(self, nodes: AnyInts, levels: AnyInts) -> Ints:
        """Unknowns u_y."""
        return self._at(nodes, 2 * np.asarray(levels) + 1)

    def w(self, nodes: AnyInts, levels: AnyInts) -> Ints:
        """Unknowns u_z; level 0 has none."""
        return self._at(nodes, 2 * self.levels + np.asarray(levels) - 1)

    def in_plane(self, u: Array, level: int) -> Array:
        """u_x and u_y (nodes, 2) of all section nodes on one level: a view into u (n,)."""
        return u.reshape(-1, self.stride)[:, 2 * level : 2 * level + 2]

    def _at(self, nodes: AnyInts, offset: AnyInts) -> Ints:
        nodes = np.asarray(nodes)
        return (
            (nodes[..., None, :] * self.stride + offset[:, None])
            .reshape(*nodes.shape[:-1], -1)
            .astype(np.int32)
        )
