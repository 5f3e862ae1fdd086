"""Finite elements: section triangles with six nodes, extruded over the depth.

The flap is a prism that mirrors itself in the plane z = 0, so only z in [0, d/2] is meshed, in layers. In the
first layer u_x and u_y are even in z and u_z is odd, and the basis says so: {1 - s^2, s^2} for u_x, u_y and
{s} for u_z with s = z / z_1. That is the quadratic element of a full-depth layer with its symmetric half left
out; it needs 5 unknowns a section node where the ordinary quadratic half layer needs 8, and it represents
bending with its anticlastic curvature exactly. Further layers, for deep flaps, are ordinary quadratic ones,
18-node wedges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.kernels import LANES, gram
from retract_env.mesh import quadratic_shares

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

# Points in the unit triangle (barycentric l0, l1, l2) and weights that add up to 1/2; degree 2 and degree 4
# (Dunavant 1985).
_A, _B = 0.445948490915965, 0.091576213509771
TRIANGLE_RULES = {
    3: (
        np.array([[2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]]),
        np.full(3, 1 / 6),
    ),
    6: (
        np.array(
            [[1 - 2 * _A, _A, _A], [_A, 1 - 2 * _A, _A], [_A, _A, 1 - 2 * _A],
             [1 - 2 * _B, _B, _B], [_B, 1 - 2 * _B, _B], [_B, _B, 1 - 2 * _B]]
        ),
        np.repeat([0.223381589678011 / 2, 0.109951743655322 / 2], 3),
    ),
}  # fmt: skip


PARTS = 4
"""Strain is measured in the middles of the PARTS^2 equal parts of a triangle. In bending, the worst-strained
1 % of volume is a thin skin, up to 7 % more strained than the outermost of three Gauss points."""


def equal_parts(parts: int) -> Array:
    """(parts^2, 3) barycentric middles of the equal triangles that edges cut into so many parts make."""
    i, j = np.indices((parts, parts))
    up, down = i + j < parts, i + j < parts - 1
    middles = np.concatenate(
        [
            np.stack([i[up] + 1 / 3, j[up] + 1 / 3], axis=1),
            np.stack([i[down] + 2 / 3, j[down] + 2 / 3], axis=1),
        ]
    )
    return np.column_stack([parts - middles.sum(axis=1), middles]) / parts


@dataclass(frozen=True)
class ElementBlock:
    """Elements of one kind, in chunks of LANES as the kernels take them (see kernels.py for the shapes)."""

    gxy: Array
    gz: Array
    weight: Array
    """volumes of the points, times their stiffness where it varies in an element"""
    mu: Array
    lam: Array
    dofs: Ints
    count: int
    """elements; what is left of the last chunk has no weight"""
    gram_xy: Array
    gram_z: Array
    """the tangent's constant part"""
    mix: Array
    """(nr, nq) displacement gradients where strain is measured, from those at the points"""
    measured: Array
    """(m, nr) m^3, volume around each place where strain is measured"""

    @classmethod
    def of(
        cls,
        gxy: Array,
        gz: Array,
        weight: Array,
        mu: Array,
        lam: Array,
        dofs: Ints,
        mix: Array | None = None,
        share: Array | None = None,
        relative: Array | None = None,
    ) -> ElementBlock:
        """From arrays element by element: gxy (m, nq, 3, na), gz (m, nq, 3, nz), weight (m, nq), mu and lam
        (m,), dofs (m, 2 na + nz); mix and share (nr, nq): of gradients and volumes at the points, where
        strain is measured, at the points themselves unless told; relative (m, nq): how many times as stiff
        as mu and lam say the material is at a point."""

        def lanes(a: NDArray[Any]) -> NDArray[Any]:
            filled = np.concatenate([a, np.zeros((-len(a) % LANES, *a.shape[1:]), a.dtype)])
            return np.ascontiguousarray(np.moveaxis(filled.reshape(-1, LANES, *a.shape[1:]), 1, -1))

        # energy is linear in mu and lam together, so a stiffer point is one of more weight
        stiff = weight if relative is None else weight * relative
        gxy_, gz_, weight_, mu_ = lanes(gxy), lanes(gz), lanes(stiff), lanes(mu)
        chunks, na, nz = len(gxy_), gxy.shape[3], gz.shape[3]
        gram_xy, gram_z = np.empty((chunks, na, na, LANES)), np.empty((chunks, nz, nz, LANES))
        gram(gxy_, weight_, mu_, gram_xy)
        gram(gz_, weight_, mu_, gram_z)
        one = np.eye(gxy.shape[1])
        mix, share = one if mix is None else mix, one if share is None else share
        return cls(
            gxy_, gz_, weight_, mu_, lanes(lam), lanes(np.asarray(dofs, np.int32)), len(gxy), gram_xy, gram_z,
            np.ascontiguousarray(mix), weight @ share.T,
        )  # fmt: skip

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array, Ints]:
        """What the kernels take besides displacements."""
        return self.gxy, self.gz, self.weight, self.mu, self.lam, self.dofs

    def by_element(self, values: Array) -> Array:
        """(c, ..., LANES) of the kernels to (m, ...), one row an element."""
        rows = np.moveaxis(values, -1, 1)
        return rows.reshape(-1, *rows.shape[2:])[: self.count]


def lame(modulus: Array, poisson: Array) -> tuple[Array, Array]:
    """Shear modulus mu and Lame's lambda [Pa] from Young's modulus [Pa] and Poisson's ratio."""
    modulus, poisson = np.asarray(modulus, float), np.asarray(poisson, float)
    return modulus / (2 * (1 + poisson)), modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))


def triangle6(points: Array, corners: Array) -> tuple[Array, Array, Array]:
    """Quadratic shape functions on straight-sided triangles.

    points: (p, 3) barycentric; corners: (m, 3, 2) m.
    Returns values (p, 6), gradients (m, p, 2, 6) 1/m and twice the areas (m,) m^2.
    """
    low = points
    values = quadratic_shares(low)
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double_area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    # grad l_i is the inward normal of the opposite edge over twice the area
    edge = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    grad = np.stack([-edge[..., 1], edge[..., 0]], axis=1) / double_area[:, None, None]  # (m, 2, 3)
    of_corner = np.einsum("mji,pi->mpji", grad, 4 * low - 1)
    nxt = np.roll(low, -1, axis=1)
    of_edge = 4 * (
        np.einsum("mji,pi->mpji", grad, nxt) + np.einsum("mji,pi->mpji", np.roll(grad, -1, axis=2), low)
    )
    return values, np.concatenate([of_corner, of_edge], axis=3), double_area


def symmetric_depth(z1: float) -> tuple[Array, Array, Array, Array, Array]:
    """Basis of the layer [0, z1] next to the plane of symmetry at its Gauss points.

    Returns u_xy values and derivatives (p, 2), u_z values and derivatives (p, 1), weights (p,) m. The points
    are the positive half of the four-point rule on [-z1, z1], exact to degree 7 for what is even.
    """
    s, w = np.polynomial.legendre.leggauss(4)
    s, w = s[2:], w[2:] * z1
    xy = np.stack([1 - s**2, s**2], axis=1)
    dxy = np.stack([-2 * s, 2 * s], axis=1) / z1
    return xy, dxy, s[:, None], np.full((2, 1), 1 / z1), w


def quadratic_depth(thickness: float) -> tuple[Array, Array, Array, Array, Array]:
    """Basis of an ordinary layer with three levels of nodes, in the form of `symmetric_depth`."""
    s, w = np.polynomial.legendre.leggauss(3)
    value = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=1)
    slope = np.stack([s - 0.5, -2 * s, s + 0.5], axis=1) * (2 / thickness)
    return value, slope, value, slope, w * thickness / 2


def extruded_block(
    corners: Array,
    depth: tuple[Array, Array, Array, Array, Array],
    dofs: Ints,
    modulus: Array,
    poisson: Array,
    triangle_points: int = 3,
    relative: Array | None = None,
) -> ElementBlock:
    """Elements of one layer over all section triangles.

    corners: (m, 3, 2) m; dofs: (m, 2 na + nz); modulus [Pa] and poisson: (m,); relative: (m,
    triangle_points), stiffness at a triangle's points over its modulus, 1 unless told.
    """
    points, tri_weights = TRIANGLE_RULES[triangle_points]
    value, grad, double_area = triangle6(points, corners)
    xy, dxy, z, dz, depth_weights = depth

    def gradients(basis: Array, slope: Array) -> Array:
        planar = np.einsum("mpjt,rl->mprjlt", grad, basis)
        across = np.broadcast_to(
            np.einsum("pt,rl->prlt", value, slope), (len(corners), *planar.shape[1:3], *planar.shape[4:])
        )
        both = np.concatenate([planar, across[:, :, :, None]], axis=3)
        m, p, r = both.shape[:3]
        return both.reshape(m, p * r, 3, -1)

    weight = np.einsum("m,p,r->mpr", double_area, tri_weights, depth_weights).reshape(len(corners), -1)
    mu, lam = lame(modulus, poisson)
    # displacements are quadratic in the section, so their gradients there are linear
    linear = equal_parts(PARTS) @ np.linalg.pinv(points)
    even = np.full(linear.shape, 1 / len(linear))
    mix, share = (np.kron(in_section, np.eye(len(depth_weights))) for in_section in (linear, even))
    if relative is not None:
        relative = np.repeat(relative, len(depth_weights), axis=1)
    return ElementBlock.of(gradients(xy, dxy), gradients(z, dz), weight, mu, lam, dofs, mix, share, relative)
