"""Bodies to be deformed: the flap as a prism, any body's fields, and a plain Newton solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.fem.assembly import Assembly
from retract_env.fem.elements import ElementBlock, lame
from retract_env.fem.linear import cholesky
from retract_env.fem.model import FlapModel
from retract_env.fem.prism import Prism
from retract_env.fem.solver import Equilibrium
from retract_env.mesh import SectionMesh
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Field = Callable[[Array], Array]


@dataclass(frozen=True, repr=False, eq=False)
class Body:
    """Element blocks with the place of every unknown."""

    blocks: Sequence[ElementBlock]
    size: int
    dofs: tuple[Ints, Ints, Ints]
    """unknowns u_x, u_y, u_z of the nodes; the first nodes have no u_z where they lie on a mirror, z = 0"""
    at: Array
    """(n, 3) m, rest position of each node"""
    b: float = 0.0
    """of Fung's law, 0 for the neo-Hookean one"""

    @property
    def mirrored(self) -> bool:
        """Whether it is half a body, the other half its image."""
        return len(self.dofs[2]) < len(self.at)

    @cached_property
    def whole(self) -> Assembly:
        """Assembly with every unknown free."""
        return self.assembly(np.ones(self.size, bool))

    def assembly(self, free: NDArray[np.bool_]) -> Assembly:
        """free: (size,)."""
        return Assembly(self.blocks, self.size, np.flatnonzero(free).astype(np.int32), self.b)

    def vectors(self, u: Array) -> Array:
        """Unknowns (size,) as a vector a node (n, 3)."""
        out = np.zeros_like(self.at)
        for i, dofs in enumerate(self.dofs):
            out[len(self.at) - len(dofs) :, i] = u[dofs]
        return out

    def unknowns(self, vectors: Array) -> Array:
        """The inverse of `vectors`, (n, 3) to (size,)."""
        out = np.empty(self.size, vectors.dtype)
        for i, dofs in enumerate(self.dofs):
            out[dofs] = vectors[len(self.at) - len(dofs) :, i]
        return out

    def face(self, axis: int, high: bool) -> NDArray[np.bool_]:
        """(n,) nodes of one side of a box."""
        x = self.at[:, axis]
        found: NDArray[np.bool_] = np.abs(x - (x.max() if high else x.min())) < 1e-9
        return found

    def held(self, nodes: NDArray[np.bool_], *axes: int) -> NDArray[np.bool_]:
        """(size,) unknowns of nodes (n,) in directions."""
        mask = np.zeros(self.at.shape)
        for axis in axes:
            mask[nodes, axis] = 1
        return self.unknowns(mask) > 0

    def affine(self, F: ArrayLike, shift: ArrayLike = (0, 0, 0)) -> Array:
        """Unknowns of x -> F x + shift."""
        return self.unknowns(self.at @ np.asarray(F, float).T + np.asarray(shift, float) - self.at)


def prism_body(
    scene: Scene, section: SectionMesh, triangle_points: int = 3, per_height: float | None = None
) -> Body:
    """The half depth of a flap, as the product meshes it unless told how many layers."""
    prism = Prism(
        section, scene, triangle_points, **({} if per_height is None else {"per_height": per_height})
    )
    nodes, levels = np.arange(len(section.points), dtype=np.int32), np.arange(prism.levels, dtype=np.int32)
    at = np.concatenate([np.column_stack([section.points, np.full(len(nodes), z)]) for z in prism.z])
    dofs = [prism.x(nodes, levels), prism.y(nodes, levels), prism.w(nodes, levels[1:])]
    x, y, w = (d.astype(np.int64) for d in dofs)
    return Body(prism.blocks, prism.size, (x, y, w), at)


def deformation(block: ElementBlock, u: Array) -> Array:
    """Deformation gradients (m, q, 3, 3), in NumPy."""
    gxy, gz = block.by_element(block.gxy), block.by_element(block.gz)
    dofs = np.moveaxis(block.dofs, -1, 1).reshape(-1, block.dofs.shape[1])[: block.count]
    ux, uy, uz = np.split(u[dofs], [gxy.shape[3], 2 * gxy.shape[3]], axis=1)
    rows = [np.einsum("ma,mqja->mqj", v, g) for v, g in ((ux, gxy), (uy, gxy), (uz, gz))]
    return np.stack(rows, axis=2) + np.eye(3)


def stress(F: Array, modulus: ArrayLike, poisson: ArrayLike, b: float = 0.0) -> Array:
    """First Piola-Kirchhoff stress (..., 3, 3) Pa of the logarithmic neo-Hookean solid, or of Fung's."""
    mu, lam = (v[..., None, None] for v in lame(np.asarray(modulus), np.asarray(poisson)))
    log_j = np.log(np.linalg.det(F))[..., None, None]
    first = (F**2).sum(axis=(-2, -1))[..., None, None] - 3
    grown = np.exp(b * (first - 2 * log_j + lam / mu * log_j**2))
    found: Array = grown * (mu * F + (lam * log_j - mu) * np.swapaxes(np.linalg.inv(F), -1, -2))
    return found


def relax(solid: Assembly | FlapModel, u: Array, load: Array | float = 0.0) -> tuple[Array, Array]:
    """Equilibrium to rounding, by Newton with a line search: u (n,) m and the forces (n,) N that hold it.

    A flap bears its own loads already.
    """
    assembly = solid if isinstance(solid, Assembly) else solid.assembly
    free = assembly.free
    factor = cholesky(assembly.indptr, assembly.indices)
    energy, force = solid.residual(u)
    last = np.inf
    for _ in range(60):
        out = force - load
        factor.factorize(solid.tangent(u))
        step = np.zeros_like(u)
        step[free] = -factor.solve(out[free])
        size, most = float(np.abs(step).max()), float(np.abs(u).max())
        if size <= 1e-14 * most or 0.5 * last < size < 1e-6 * most:  # rounding
            return u, out
        last = size
        length, norm = 1.0, np.linalg.norm(out[free])
        while True:
            trial = u + length * step
            trial_energy, force = solid.residual(trial)
            # close to equilibrium differences of energy are but rounding
            if trial_energy - energy <= float(np.sum(load * (trial - u))) or (
                np.isfinite(trial_energy) and np.linalg.norm((force - load)[free]) < 0.5 * norm
            ):
                break
            length /= 2
            assert length > 1e-9, "no descent"
        u, energy = trial, trial_energy
    raise AssertionError("no equilibrium")


def settled(model: FlapModel, u: Array | None = None) -> tuple[Array, Array]:
    """The flap's equilibrium to rounding, from a first guess, and the forces that hold it."""
    rough, _ = Equilibrium(model).solve(np.zeros(model.prism.size) if u is None else u)
    return relax(model, rough)
