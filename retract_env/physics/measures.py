"""From displacements to what is seen and felt: the one place where every physics takes its measures.

A physics that does not compute strains and jaw forces itself has both computed here from its nodes'
positions, by the finite-element kernels.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, hstack, identity

from retract_env.errors import Diverged
from retract_env.fem.assembly import Assembly
from retract_env.fem.elements import ElementBlock, lame
from retract_env.fem.linear import Factor, cholesky
from retract_env.mesh import SectionMesh
from retract_env.objectives import IN_BLOCK, clearance, inside_block, required_friction, worst_mean
from retract_env.physics.base import TissueState
from retract_env.scene import Scene

if TYPE_CHECKING:
    from retract_env.physics.bullet.tetmesh import TetMesh

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

EDGE = 0.2
"""Over a jaw's width, side of the square that may be covered twice. Beside the sharp edge of a rigid patch
the surface of a soft solid folds on the scale of the elements there, and may turn over the pad's round edge
(`fem.contact`). What covers more meets itself elsewhere, or so deeply that it matters."""


def linear_tetrahedra(points: Array, cells: Ints, modulus: Array, poisson: Array) -> ElementBlock:
    """Constant-strain tetrahedra; unknown 3 i + k is node i's displacement in direction k.

    points: (n, 3) m; cells: (m, 4); modulus [Pa] and poisson: (m,).
    """
    edges = np.swapaxes(points[cells[:, 1:]] - points[cells[:, :1]], 1, 2)
    inverse = np.linalg.inv(edges)
    gradient = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    gradient = np.swapaxes(gradient, 1, 2)[:, None]
    dofs = np.concatenate([3 * cells + k for k in range(3)], axis=1)
    mu, lam = lame(modulus, poisson)
    return ElementBlock.of(gradient, gradient, np.linalg.det(edges)[:, None] / 6, mu, lam, dofs)


def outline_ring(section: SectionMesh) -> Ints:
    """(r,) nodes of a section's outline in their order, counter-clockwise, the first not repeated."""
    after = {int(a): (int(middle), int(b)) for a, middle, b in section.boundary}
    node = begin = int(section.boundary[0, 0])
    ring = []
    while True:
        middle, following = after[node]
        ring += [node, middle]
        node = following
        if node == begin:
            return np.array(ring, np.int32)


def doubled(outline: Array) -> float:
    """m^2, area that a closed outline (k, 2) m, counter-clockwise, covers more than once or inside out."""
    ring = shapely.linearrings(outline)
    if shapely.is_simple(ring):
        return 0.0
    closed = np.vstack([outline, outline[:1]])
    area = 0.0
    crossed: Any = shapely.node(ring)
    for face in shapely.get_parts(shapely.polygonize([crossed])):
        away = closed - shapely.get_coordinates(shapely.point_on_surface(face))
        turned = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
        if round((turned[-1] - turned[0]) / (2 * np.pi)) not in (0, 1):
            area += float(shapely.area(face))
    return area


def tool_outline(scene: Scene, jaws: Array) -> Array:
    """(16, 2) m, corners of both pads and stems, lower jaw first, for jaws (4,) m."""
    how = scene.jaws
    ends = jaws.reshape(2, 2)
    axis = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    across = np.array([axis[1], -axis[0]])
    half, thin = how.width / 2, how.thickness / 4
    corners = [(half, 0.0), (half, how.thickness), (thin, how.thickness), (thin, how.thickness + how.stem)]
    points = []
    for end, away in zip(ends, (-axis, axis), strict=True):
        points += [end + side * a * across + b * away for a, b in corners for side in (-1, 1)]
    return np.array(points)


class Measures:
    """Measures a flap that is made of element blocks."""

    def __init__(self, scene: Scene, section: SectionMesh, assembly: Assembly, share: csr_matrix):
        """share: (section triangles, elements), which part of an element lies over or under a triangle."""
        self.scene, self.section, self.assembly = scene, section, assembly
        self._share = share
        weights = [b.measured for b in assembly.blocks]
        self._weights = weights
        self._points_volume = np.concatenate([w.ravel() for w in weights])
        self._volume = share @ np.concatenate([w.sum(axis=1) for w in weights])
        # the triangle that has most of an element stands for its place
        self._triangle = np.asarray(share.tocsc().argmax(axis=0)).ravel()
        self._element_of = np.repeat(
            np.arange(sum(map(len, weights))), [w.shape[1] for w in weights for _ in w]
        )
        self._ring = outline_ring(section)
        line = scene.line_of_sight
        self._line = np.array(line.camera), np.array(line.target)

    @classmethod
    def of_layers(cls, scene: Scene, section: SectionMesh, assembly: Assembly, layers: int) -> Measures:
        """Of a prism, each of whose layers has one element over each triangle of the section."""
        shares = [identity(len(section.triangles), format="csr")] * layers
        return cls(scene, section, assembly, csr_matrix(hstack(shares)))

    def state(
        self,
        u: Array,
        jaws: Array,
        reactions: Array,
        levels: Array,
        progress: float,
        others: Array | None = None,
    ) -> TissueState:
        """The state at displacements u (n,) m.

        jaws: (4,) m; reactions: (2, 2) N, tissue on jaw; levels: (d, k, 2) m, where the section's nodes are
        at each depth, the drawn one first; others: (m, 2) m, nodes that belong to no level.
        """
        strains = self.assembly.strains(u)
        total = np.concatenate(
            [np.einsum("ep,ep->e", s, w) for s, w in zip(strains, self._weights, strict=True)]
        )
        every = np.concatenate([s.ravel() for s in strains])
        worst = self._element_of[every.argmax()]
        dx, dy = (jaws[2:] - jaws[:2]).tolist()
        long = math.hypot(dx, dy)
        normals = np.array([[dx, dy], [-dx, -dy]]) / long
        camera, target = self._line
        height = self.scene.tissue.height
        crease = max(doubled(p[self._ring]) for p in levels)
        nodes = [levels] if others is None else [levels, others]
        seen = [*nodes, tool_outline(self.scene, jaws)] if self.scene.jaws.in_sight else nodes
        return TissueState(
            points=levels[0],
            strain=(self._share @ total) / self._volume,
            jaws=jaws,
            reactions=reactions,
            normals=normals,
            worst_strain=worst_mean(every, self._points_volume),
            worst_at=self.section.corners[self._triangle[worst]].mean(axis=0),
            required_friction=required_friction(reactions, normals),
            clearance=min(clearance(p, camera, target) for p in seen),
            progress=progress,
            crease=crease,
            overlap=crease > (EDGE * self.scene.jaws.width) ** 2
            or any(inside_block(p, height, IN_BLOCK * height) for p in nodes),
        )


class TetrahedralFlap:
    """A flap of linear tetrahedra whose displacements (n, 3) m some other physics computes."""

    def __init__(self, scene: Scene, mesh: TetMesh):
        tissue = scene.tissue
        self.mesh = mesh
        self.held = np.zeros(len(mesh.points), bool)
        """(n,) nodes that do not move by themselves"""
        self.held[np.concatenate([mesh.fixed, *mesh.patches])] = True
        self._free = np.repeat(~self.held, 3)
        modulus, poisson = mesh.copies * np.float64(tissue.modulus), np.full(len(mesh.cells), tissue.poisson)
        self.blocks = [linear_tetrahedra(mesh.points, mesh.cells, modulus, poisson)]
        self.assembly = Assembly(self.blocks, self._free.size, np.flatnonzero(self._free).astype(np.int32))
        self._measures = Measures(scene, mesh.section, self.assembly, mesh.share)

    def factor(self) -> Factor:
        """A factorisation for tangents over the nodes that move."""
        return cholesky(self.assembly.indptr, self.assembly.indices)

    def state(self, u: Array, load: Array, jaws: Array, progress: float) -> TissueState:
        """The state at displacements u (n, 3) m under nodal loads (n, 3) N, jaws (4,) m.

        A jaw feels what its nodes are pulled with. Raises Diverged where an element is inside out.
        """
        energy, inner = self.assembly.residual(u.ravel())
        if not np.isfinite(energy):
            raise Diverged("an element is inside out")
        force = inner.reshape(-1, 3) - load
        reactions = -np.array([force[nodes, :2].sum(axis=0) for nodes in self.mesh.patches])
        now = (self.mesh.points + u)[:, :2]
        section = now[self.mesh.section_nodes].mean(axis=1)
        return self._measures.state(u.ravel(), jaws, reactions, section[None], progress, now)

    def frequency(self, u: Array, mass: float, mode: Array | None, iterations: int) -> tuple[float, Array]:
        """Highest angular frequency, rad/s, of small vibrations about u (n, 3) m, by the power method.

        mass: kg, of each node; mode: (3 n,) where an earlier call ended. Returns it and the mode; the
        frequency is one percent low after 30 iterations, and nan where an element is inside out.
        """
        if mode is None:
            mode = np.random.default_rng(0).normal(size=self._free.size) * self._free
        stiffness = np.nan
        for _ in range(iterations):
            force = self.assembly.tangent_times(u.ravel(), mode) * self._free
            stiffness = float(np.linalg.norm(force) / np.linalg.norm(mode))
            mode = force / np.linalg.norm(force)
        return float(np.sqrt(stiffness / mass)), mode
