"""A flap between jaws: elastic prism, gravity, bed, and the motion that the jaws prescribe."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.errors import FlapRefused
from retract_env.fem import descent
from retract_env.fem.assembly import Assembly
from retract_env.fem.contact import Contact
from retract_env.fem.descent import Turn
from retract_env.fem.prism import Prism, unknowns
from retract_env.mesh import RESOLUTIONS, Resolution, SectionMesh
from retract_env.scene import Scene

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


MOST_UNKNOWNS = 150_000
"""Beyond them an equilibrium takes minutes. The paper's wide flap has 22,000 at "fine", 91,000 at "finer"."""


class FlapModel:
    """Potential energy of the flap for jaws that hold two rigid patches.

    Displacements u (n,) m follow the numbering of Prism. Everything refers to the half depth.
    """

    def __init__(
        self,
        scene: Scene,
        section: SectionMesh,
        jaw_x: float | None,
        resolution: Resolution = RESOLUTIONS["fine"],
        triangle_points: int = 3,
    ):
        """resolution: gives the layers over the depth and the bed; the section comes with its own.

        Raises FlapRefused for a flap that takes more than `MOST_UNKNOWNS`.
        """
        tissue = scene.tissue
        self.scene, self.section, self.jaw_x = scene, section, jaw_x
        size = unknowns(section, scene, resolution.layers)  # before they take memory
        if size > MOST_UNKNOWNS:
            raise FlapRefused(
                f"tissue: {size} unknowns at {resolution.name!r}, allowed {MOST_UNKNOWNS}; "
                "the flap is too long or too deep for its height"
            )
        self.prism = prism = Prism(section, scene, triangle_points, resolution.layers)
        every = np.arange(prism.levels)
        held = np.flatnonzero(prism.z <= (scene.jaws.depth or tissue.depth) / 2 * (1 + 1e-9))
        self.fixed = np.concatenate(
            [prism.x(section.fixed, every), prism.y(section.fixed, every), prism.w(section.fixed, every[1:])]
        )
        self._patch_x = [prism.x(p, held) for p in section.patches]
        self._patch_y = [prism.y(p, held) for p in section.patches]
        self._patch_rest = [np.tile(section.points[p], (len(held), 1)) for p in section.patches]
        self.driven = np.concatenate([*self._patch_x, *self._patch_y])
        prescribed = np.zeros(prism.size, bool)
        prescribed[self.fixed] = True
        prescribed[self.driven] = True
        self.free = np.flatnonzero(~prescribed).astype(np.int32)
        self.assembly = Assembly(prism.blocks, prism.size, self.free, scene.material.stiffening)

        self._weight = np.zeros(prism.size)
        share = prism.depth_weight[:, None] * prism.area
        nodes = np.arange(len(section.points))
        self._weight[prism.y(nodes, every)] = -tissue.density * scene.gravity * share.ravel()
        self.load = self._weight

        self._bed = prism.y(section.bottom, every) if scene.bed else np.empty(0, np.int32)
        self._bed_modulus = resolution.bed * tissue.modulus / tissue.height
        share = prism.depth_weight[:, None] * section.bottom_length
        self._bed_stiffness = self._bed_modulus * share.ravel()[: len(self._bed)]
        number = np.full(prism.size, -1)
        number[self.free] = np.arange(len(self.free))
        row = number[self._bed]
        self._bed, self._bed_stiffness = self._bed[row >= 0], self._bed_stiffness[row >= 0]
        self._bed_diagonal = self.assembly.indptr[row[row >= 0]]

        self.contact = Contact(scene, section, prism, held, number, self.assembly.indptr)

        across = prism.x(nodes, every)
        turning = number[across] >= 0
        self._turning = number[across[turning]].astype(np.int32)
        self._turning_nodes = np.tile(nodes, prism.levels)[turning].astype(np.int32)

    def at_rest(self) -> Array:
        """First guess for the flap on its bed: pressed in by its own weight, so that the bed already bears
        it."""
        u = np.zeros(self.prism.size)
        if len(self._bed):
            tissue = self.scene.tissue
            sunk = tissue.density * self.scene.gravity * tissue.height / self._bed_modulus
            every = np.arange(self.prism.levels)
            heights = self.prism.y(np.arange(len(self.section.points)), every)
            u[np.intersect1d(heights, self.free)] = -sunk
        return u

    def weigh(self, part: float) -> None:
        """Let the tissue have that part of its weight."""
        self.load = part * self._weight

    def place_jaws(self, u: Array, jaws: Array) -> None:
        """Write into u the displacement of both patches, rigid and perpendicular to the jaw axis.

        jaws: (4,) m.
        """
        axis = jaws[2:] - jaws[:2]
        axis = axis / np.hypot(*axis)
        along = np.array([axis[1], -axis[0]])  # direction of the rest x axis
        for k in range(2):
            rest = self._patch_rest[k]
            base = np.array([self.jaw_x, k * self.scene.tissue.height])
            offset = rest - base
            moved = jaws[2 * k : 2 * k + 2] + offset[:, :1] * along + offset[:, 1:] * axis
            u[self._patch_x[k]] = moved[:, 0] - rest[:, 0]
            u[self._patch_y[k]] = moved[:, 1] - rest[:, 1]

    def jaws(self, u: Array) -> Array:
        """(4,) m, where the jaws are that hold the patches of u; the inverse of `place_jaws`."""
        assert self.jaw_x is not None, "a flap without jaws"
        found = np.empty(4)
        for k in range(2):
            rest, x = self._patch_rest[k], self._patch_x[k]
            ends = [int(rest[:, 0].argmin()), int(rest[:, 0].argmax())]
            moved = rest[ends] + np.stack([u[x[ends]], u[self._patch_y[k][ends]]], axis=-1)
            begin, long = rest[ends[0], 0], rest[ends[1], 0] - rest[ends[0], 0]
            found[2 * k : 2 * k + 2] = moved[0] + (moved[1] - moved[0]) * ((self.jaw_x - begin) / long)
        return found

    def residual(self, u: Array) -> tuple[float, Array]:
        """Potential energy [J] and its gradient (n,) [N], forces that hold prescribed nodes included."""
        energy, force = self.assembly.residual(u)
        energy += self.contact.add_force(u, force)
        return energy + float(_outer_force(u, self.load, self._bed, self._bed_stiffness, force)), force

    def on_bed(self, u: Array) -> Bools:
        """(b,) whether each of the bed's unknowns is pressed into it."""
        return u[self._bed] < 0

    def pulled(self, u: Array, force: Array, held: Bools) -> Array:
        """The forces (n,) where the bed also pulls, as hard as it would push, at those of its unknowns that
        are `held`."""
        out = force.copy()
        away = held & (u[self._bed] > 0)
        out[self._bed[away]] += self._bed_stiffness[away] * u[self._bed[away]]
        return out

    def tangent(self, u: Array, held: Bools | None = None) -> Array:
        """Upper triangle over the free unknowns.

        held: which of the bed's unknowns count as pressed into it besides those that are.
        """
        values = self.assembly.tangent(u)
        down = self.on_bed(u) if held is None else self.on_bed(u) | held
        values[self._bed_diagonal[down]] += self._bed_stiffness[down]
        self.contact.add_tangent(u, values)
        return values

    def tangent_times(self, u: Array, v: Array) -> Array:
        """The whole tangent at u, the bed's with it, applied to v (n,)."""
        out = self.assembly.tangent_times(u, v)
        down = self._bed[u[self._bed] < 0]
        out[down] += self._bed_stiffness[u[self._bed] < 0] * v[down]
        self.contact.add_tangent_times(u, v, out)
        return out

    def turned(self, u: Array, v: Array) -> Turn:
        """How far the tissue around each node has turned from u to v (n,) m."""
        cos, sin = np.empty(len(self._turning)), np.empty(len(self._turning))
        section, stride = self.section, self.prism.stride
        descent.turns(u, v, section.points, section.triangles, stride, self._turning_nodes, cos, sin)
        return self._turning, cos, sin

    def reactions(self, force: Array) -> Array:
        """(2, 2) N, force of the tissue on the lower and the upper jaw over the whole depth."""
        return np.array(
            [[-2 * force[self._patch_x[k]].sum(), -2 * force[self._patch_y[k]].sum()] for k in range(2)]
        )

    def positions(self, u: Array, level: int = 0) -> Array:
        """(n, 2) m, section nodes of one depth level."""
        return self.section.points + self.prism.in_plane(u, level)

    def solid(self, u: Array) -> Array:
        """(l, n, 3) m, section nodes of every depth level, the plane of symmetry first."""
        nodes, count = np.arange(len(self.section.points)), self.prism.levels
        points = np.zeros((count, len(nodes), 3))
        for level in range(count):
            points[level, :, :2] = self.positions(u, level)
        points[1:, :, 2] = u[self.prism.w(nodes, np.arange(1, count))].T
        points[:, :, 2] += self.prism.z[:, None]
        return points


@njit(cache=True, nogil=True)
def _outer_force(u, load, bed, stiffness, force):
    """Add to the internal forces weight and the bed's push on nodes below y = 0; returns their energy."""
    energy = 0.0
    for i in range(len(u)):
        energy -= load[i] * u[i]
        force[i] -= load[i]
    for i in range(len(bed)):
        gap = u[bed[i]]
        if gap < 0.0:
            force[bed[i]] += stiffness[i] * gap
            energy += 0.5 * stiffness[i] * gap * gap
    return energy
