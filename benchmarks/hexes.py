"""The flap as a regular mesh of hex-27, which other finite-element codes can take as it is; see
against_felupe.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.assembly import Assembly
from retract_env.fem.descent import Turn
from retract_env.fem.elements import ElementBlock, lame
from retract_env.scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class HexFlap:
    """Half depth of a homogeneous flap, z = 0 its plane of symmetry, without bed and weight.

    Unknown 3 k + i is the displacement of node k along axis i.
    """

    scene: Scene
    jaw_x: float
    points: Array
    """(n, 3) m, at rest"""
    cells: Ints
    """(m, 27) nodes at (a, b, c) in {-1, 0, 1}^3 of the reference cube, c fastest"""
    patches: tuple[Ints, Ints]
    """nodes under the lower and the upper jaw"""
    prescribed: Ints
    """unknowns, sorted"""
    free: Ints

    @property
    def lame(self) -> tuple[float, float]:
        """mu and lambda, Pa."""
        tissue = self.scene.tissue
        mu, lam = lame(np.array(tissue.modulus), np.array(tissue.poisson))
        return float(mu), float(lam)

    def place_jaws(self, u: Array, jaws: Array) -> None:
        """Write into u (3 n,) m both patches' displacement, rigid in x-y and free in z; jaws: (4,) m."""
        axis = (jaws[2:] - jaws[:2]) / np.hypot(*(jaws[2:] - jaws[:2]))
        along = np.array([axis[1], -axis[0]])
        for k, nodes in enumerate(self.patches):
            offset = self.points[nodes, 0] - self.jaw_x
            moved = jaws[2 * k : 2 * k + 2] + offset[:, None] * along
            u.reshape(-1, 3)[nodes, :2] = moved - self.points[nodes, :2]

    def assembly(self) -> Assembly:
        """This project's kernels on these elements, 3 x 3 x 3 points."""
        s, w = np.polynomial.legendre.leggauss(3)
        value = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=1)
        slope = np.stack([s - 0.5, -2 * s, s + 0.5], axis=1)
        factors = [[slope if i == j else value for j in range(3)] for i in range(3)]
        local = np.stack([np.einsum("pa,qb,rc->pqrabc", *f).reshape(27, 27) for f in factors], axis=1)
        jacobian = np.einsum("qjk,mki->mqij", local, self.points[self.cells])
        gradient = np.einsum("qjk,mqji->mqik", local, np.linalg.inv(jacobian))
        weight = np.linalg.det(jacobian) * np.einsum("p,q,r->pqr", w, w, w).ravel()
        mu, lam = (np.full(len(self.cells), v) for v in self.lame)
        dofs = np.concatenate([3 * self.cells + i for i in range(3)], axis=1).astype(np.int32)
        block = ElementBlock.of(gradient, gradient, weight, mu, lam, dofs)
        return Assembly([block], 3 * len(self.points), self.free.astype(np.int32))


class HexModel:
    """What `Equilibrium` asks of a model, on the elements of a HexFlap."""

    def __init__(self, flap: HexFlap):
        self.scene, self.free, self.assembly = flap.scene, flap.free, flap.assembly()
        self.residual, self.tangent = self.assembly.residual, self.assembly.tangent
        self.tangent_times = self.assembly.tangent_times

    def on_bed(self, u: Array) -> NDArray[np.bool_]:  # noqa: ARG002
        """There is no bed."""
        return np.zeros(0, bool)

    def turned(self, u: Array, v: Array) -> Turn:  # noqa: ARG002
        """None of the unknowns is said to turn, as in the other code."""
        return np.zeros(0, np.int32), np.zeros(0), np.zeros(0)


def hex_flap(scene: Scene, jaw_x: float, patch: int, rows: int, growth: float = 1.5) -> HexFlap:
    """Mesh the flap: `patch` elements along a jaw, `rows` over the height, one over the half depth.

    Along the flap elements grow from the patches by the factor `growth`, up to the height of the flap.
    """
    tissue, half = scene.tissue, scene.jaws.width / 2
    low, high = jaw_x - half, jaw_x + half
    size = scene.jaws.width / patch
    xs = np.concatenate(
        [
            low - _graded(low + tissue.length, size, growth, tissue.height)[::-1],
            np.linspace(low, high, patch + 1)[1:-1],
            high + _graded(-high, size, growth, tissue.height),
        ]
    )
    lines = [
        _with_middles(a)
        for a in (xs, np.linspace(0, tissue.height, rows + 1), np.array([0, tissue.depth / 2]))
    ]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape([len(a) for a in lines])
    first = number[:-2:2, :-2:2, :-2:2].ravel()
    cells = first[:, None] + number[:3, :3, :3].ravel()

    x, y, z = points.T
    near = 1e-9 * tissue.length
    held = np.abs(x - jaw_x) < half + near
    patches = tuple(np.flatnonzero(held & (np.abs(y - level) < near)) for level in (0.0, tissue.height))
    fixed = np.zeros(points.shape, bool)
    fixed[np.abs(x) < near] = True
    fixed[np.abs(z) < near, 2] = True
    for nodes in patches:
        fixed[nodes, :2] = True
    return HexFlap(
        scene, jaw_x, points, cells, (patches[0], patches[1]), np.flatnonzero(fixed), np.flatnonzero(~fixed)
    )


def _graded(length: float, first: float, growth: float, largest: float) -> Array:
    """Breaks from 0 to length whose steps grow from about `first`."""
    steps = [first]
    while sum(steps) < length:
        steps.append(min(steps[-1] * growth, largest))
    return np.concatenate([[0.0], np.cumsum(steps)]) * (length / sum(steps))


def _with_middles(breaks: Array) -> Array:
    out = np.empty(2 * len(breaks) - 1)
    out[::2], out[1::2] = breaks, (breaks[1:] + breaks[:-1]) / 2
    return out
