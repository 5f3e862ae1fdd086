"""Chains of rod elements laid out by hand: rows by lanes, every lane the same unless told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.rod import chain, equilibrium
from retract_env.rod.chain import LANES

Array = NDArray[np.float64]

POISSON = 0.45
PLAIN = (1.0, 0.0, 1 / 12, 5 / 6 / (2 * (1 + POISSON)))
"""A, B, D and G of a section of plain tissue, E h d and flap heights."""
LENGTH = 8.0
"""of a flap of usual slenderness, h"""
ROUNDING = 1e-12
"""of forces and shapes of order 1 that go through some hundred operations"""


@dataclass
class Chains:
    """LANES chains of as many elements, and where they are."""

    elements: int
    P: Array
    """(rows, LANES) parameters"""
    U: Array
    """(3 (elements + 1), LANES) x, y, theta of each node"""
    clamped: bool = False
    """whether the left end is, too"""

    @property
    def nodes(self) -> Array:
        """(elements + 1, 3, LANES), a view"""
        return self.U.reshape(-1, 3, LANES)

    def moved(self, U: Array) -> Chains:
        return Chains(self.elements, self.P, U, self.clamped)

    @property
    def first(self) -> int:
        """The first node that is free."""
        return int(self.clamped)

    @property
    def free(self) -> slice:
        """Rows of U that are unknowns."""
        return slice(3 * self.first, 3 * self.elements)


@dataclass
class Swept:
    """What one sweep found."""

    W: Array
    """(rows, LANES) scratch"""
    Z: Array
    """(rows, LANES) factors"""

    @property
    def energy(self) -> Array:
        """(LANES,) of the chains."""
        found: Array = self.W[chain.ENERGY]
        return found

    @property
    def pivots(self) -> Array:
        """(LANES,) how many had to be turned positive."""
        found: Array = self.W[chain.PIVOTS]
        return found

    @property
    def left(self) -> Array:
        """(3, LANES) what holds the left end"""
        return self.W[chain.LEFT : chain.LEFT + 3]

    @property
    def right(self) -> Array:
        """(3, LANES) what holds the right end."""
        return self.W[chain.RIGHT : chain.RIGHT + 3]


def straight(
    elements: int,
    length: float = LENGTH,
    section: tuple[float, float, float, float] = PLAIN,
    weight: ArrayLike = 0.0,
    bed: ArrayLike = 0.0,
    block: ArrayLike = 0.0,
    load: tuple[ArrayLike, ArrayLike, ArrayLike] = (0.0, 0.0, 0.0),
    clamped: bool = False,
) -> Chains:
    """A chain at rest along the x axis up to x = 0, at y = 1/2; numbers, or (LANES,) one for each lane."""
    P = np.zeros((chain.parameters_rows(elements), LANES))
    P[chain.LENGTH] = length / elements
    P[chain.WEIGHT], P[chain.BED], P[chain.BLOCK] = weight, bed, block
    P[chain.LOAD], P[chain.LOAD + 1], P[chain.LOAD + 2] = load
    for k, stiffness in enumerate(section):
        P[chain.STIFFNESS + k :: 4] = stiffness
    U = np.zeros((3 * (elements + 1), LANES))
    U[0::3] = np.linspace(-length, 0.0, elements + 1)[:, None]
    U[1::3] = 0.5
    return Chains(elements, P, U, clamped)


def swept(chains: Chains) -> Swept:
    """One sweep over the chains where they are."""
    W = np.zeros(chain.SCRATCH * LANES)
    Z = np.zeros(chain.factor_rows(chains.elements) * LANES)
    chain.sweep(chains.P.ravel(), chains.U.ravel(), W, Z, chains.elements, chains.clamped)
    return Swept(W.reshape(-1, LANES), Z.reshape(-1, LANES))


def residual(chains: Chains) -> Array:
    """(free unknowns, LANES)"""
    Z = swept(chains).Z
    rows = [chain.PER_NODE * node + 15 + k for node in range(chains.first, chains.elements) for k in range(3)]
    return Z[rows]


def total_energy(chains: Chains) -> Array:
    """(LANES,)"""
    out = np.zeros(LANES)
    chain.total_energy(chains.P.ravel(), chains.U.ravel(), chains.elements, chains.clamped, out)
    return out


def solved(chains: Chains, todo: ArrayLike = True) -> tuple[Chains, NDArray[np.bool_], Swept]:
    """Brought into equilibrium: the chains there, which lanes are, and the last sweep's arrays."""
    U = chains.U.copy().ravel()
    W = np.zeros(chain.SCRATCH * LANES)
    Z = np.zeros(chain.factor_rows(chains.elements) * LANES)
    done = np.zeros(LANES, bool)
    wanted = np.broadcast_to(np.asarray(todo), (LANES,)).copy()
    equilibrium.equilibrate(chains.P.ravel(), U, W, Z, chains.elements, chains.clamped, wanted, done)
    return chains.moved(U.reshape(-1, LANES)), done, Swept(W.reshape(-1, LANES), Z.reshape(-1, LANES))


def settled(chains: Chains) -> Chains:
    """Brought into equilibrium in every lane."""
    there, done, _ = solved(chains)
    assert done.all()
    return there


def factorised_tangent(chains: Chains) -> Array:
    """(LANES, n, n) the tangent that the factors of a sweep stand for."""
    swept_ = swept(chains)
    assert not swept_.pivots.any(), "pivots were turned positive: the factors are not the tangent's"
    first, count = chains.first, chains.elements - chains.first
    K = np.zeros((LANES, 3 * count, 3 * count))
    for i in range(count):
        F = swept_.Z[chain.PER_NODE * (first + i) : chain.PER_NODE * (first + i + 1)]
        L = np.broadcast_to(np.eye(3), (LANES, 3, 3)).copy()
        L[:, 1, 0], L[:, 2, 0], L[:, 2, 1] = F[0], F[1], F[2]
        D = np.zeros((LANES, 3, 3))
        for k in range(3):
            D[:, k, k] = 1 / F[18 + k]
        here, after = slice(3 * i, 3 * i + 3), slice(3 * i + 3, 3 * i + 6)
        K[:, here, here] += L @ D @ L.transpose(0, 2, 1)
        if i + 1 < count:
            coupling = F[3:12].T.reshape(LANES, 3, 3)
            K[:, here, after] = L @ D @ coupling
            K[:, after, here] = K[:, here, after].transpose(0, 2, 1)
            K[:, after, after] += coupling.transpose(0, 2, 1) @ D @ coupling
    return K


def differenced_tangent(chains: Chains, step: float = 1e-5) -> Array:
    """(LANES, n, n) central differences of the residual, one unknown (a row of the result) at a time."""
    rows = range(chains.free.start, chains.free.stop)
    K = np.empty((LANES, len(rows), len(rows)))
    for k, row in enumerate(rows):
        ahead, behind = chains.U.copy(), chains.U.copy()
        ahead[row] += step
        behind[row] -= step
        K[:, k] = ((residual(chains.moved(ahead)) - residual(chains.moved(behind))) / (2 * step)).T
    return K


def rates(errors: ArrayLike) -> Array:
    """Orders of convergence between errors, each of them with twice as many elements as the last."""
    errors = np.asarray(errors)
    found: Array = np.log2(errors[:-1] / errors[1:])
    return found
