"""From elements to one energy, one residual and one sparse tangent over the unknowns that are free."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.compilation import announce
from retract_env.fem import fung, kernels
from retract_env.fem.elements import ElementBlock
from retract_env.fem.stretches import greatest_strains, principal_stretches

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

COMPILES = 15.0
"""s that the kernels of Fung's law take to compile."""


def block_triangle(na: int, nz: int) -> tuple[Ints, Ints]:
    """Local row and column of each entry of an element tangent, in the order in which `kernels.tangent`
    visits them."""
    counts = (na, na, nz)
    offset = (0, na, 2 * na)
    rows, cols = [], []
    for i in range(3):
        for k in range(i, 3):
            a, b = np.meshgrid(np.arange(counts[i]), np.arange(counts[k]), indexing="ij")
            keep = np.ones_like(a, bool) if i != k else b >= a
            rows.append(offset[i] + a[keep])
            cols.append(offset[k] + b[keep])
    return np.concatenate(rows).astype(np.int32), np.concatenate(cols).astype(np.int32)


class Assembly:
    """Sums element energies, forces and tangents.

    The vector u (n,) m holds every unknown, prescribed ones too; the tangent holds the free ones alone, as
    the upper triangle of a symmetric CSR matrix (indptr, indices, values).
    """

    def __init__(self, blocks: Sequence[ElementBlock], size: int, free: Ints, b: float = 0.0):
        """free: sorted positions in u of the unknowns to solve for; b: of Fung's law, 0 for the neo-Hookean
        one."""
        self.blocks, self.b = tuple(blocks), b
        if b:
            announce(fung.tangent, "the kernels of Fung's law", COMPILES)
        self.size = size
        self.free = np.asarray(free, np.int32)
        number = np.full(size, -1, np.int32)
        number[self.free] = np.arange(len(self.free), dtype=np.int32)
        keys = []
        for block in self.blocks:
            rows, cols = block_triangle(block.gxy.shape[3], block.gz.shape[3])
            filled = np.any(block.weight, axis=1, keepdims=True)
            numbered = np.where(filled, number[block.dofs], -1)
            keys.append(_keys(numbered, rows, cols, len(self.free)))
        flat = np.sort(np.concatenate([k.ravel() for k in keys]))
        fresh = np.ones(len(flat), bool)
        fresh[1:] = np.not_equal(flat[1:], flat[:-1])
        unique = flat[fresh & (flat >= 0)]
        n = len(self.free)
        self.indices = (unique % n).astype(np.int32)
        self.indptr = np.searchsorted(unique, np.arange(n + 1, dtype=np.int64) * n).astype(np.int32)
        self.targets = [_positions(k, self.indptr, self.indices, n) for k in keys]

    def residual(self, u: Array) -> tuple[float, Array]:
        """Elastic energy [J] and internal forces (n,) [N]; infinite energy where an element is inverted."""
        out = np.zeros(self.size)
        energy = 0.0
        for block in self.blocks:
            energy += kernels.residual(u, *block.arrays, out)
            if self.b and np.isfinite(energy):
                energy += fung.residual(u, *block.arrays, self.b, out)
        return energy, out

    def tangent(self, u: Array) -> Array:
        """Values [N/m] of the tangent's upper triangle over the free unknowns."""
        values = np.zeros(len(self.indices))
        for block, target in zip(self.blocks, self.targets, strict=True):
            kernels.tangent(u, *block.arrays, block.gram_xy, block.gram_z, target, values)
            if self.b:
                fung.tangent(u, *block.arrays, self.b, target, values)
        return values

    def tangent_times(self, u: Array, v: Array) -> Array:
        """The whole tangent at u, prescribed rows and columns too, applied to v (n,)."""
        out = np.zeros(self.size)
        for block in self.blocks:
            kernels.tangent_times(u, v, *block.arrays, out)
            if self.b:
                fung.tangent_times(u, v, *block.arrays, self.b, out)
        return out

    def stretches(self, u: Array) -> list[Array]:
        """Principal stretches (m, nr, 3) where each block's strain is measured, ascending."""
        return [block.by_element(_stretches(block, u)) for block in self.blocks]

    def strains(self, u: Array) -> list[Array]:
        """`objectives.strain` of these, (m, nr)."""
        out = []
        for block in self.blocks:
            strain = np.empty((block.count, len(block.mix)))
            greatest_strains(_stretches(block, u), strain)
            out.append(strain)
        return out


def _stretches(block: ElementBlock, u: Array) -> Array:
    """Principal stretches (c, nr, 3, LANES)."""
    chunks, _, lanes = block.weight.shape
    out = np.empty((chunks, len(block.mix), 3, lanes))
    principal_stretches(u, block.gxy, block.gz, block.dofs, block.mix, out)
    return out


@njit(cache=True, nogil=True)
def _keys(numbered, rows, cols, n):
    """row * n + column of each element entry in the upper triangle, -1 where an unknown is prescribed; (c, m,
    LANES)."""
    chunks, _, lanes = numbered.shape
    out = np.empty((chunks, len(rows), lanes), np.int64)
    for c in range(chunks):
        for s in range(len(rows)):
            for lane in range(lanes):
                i = np.int64(numbered[c, rows[s], lane])
                j = np.int64(numbered[c, cols[s], lane])
                if i < 0 or j < 0:
                    out[c, s, lane] = -1
                else:
                    out[c, s, lane] = min(i, j) * n + max(i, j)
    return out


@njit(cache=True, nogil=True)
def _positions(keys, indptr, indices, n):
    """Where each key stands in the CSR arrays, by bisection in its row."""
    flat = keys.ravel()
    out = np.empty(len(flat), np.int32)
    for s in range(len(flat)):
        key = flat[s]
        if key < 0:
            out[s] = -1
            continue
        row = key // n
        col = key - row * n
        low = indptr[row]
        high = indptr[row + 1] - 1
        while low < high:
            mid = (low + high) // 2
            if indices[mid] < col:
                low = mid + 1
            else:
                high = mid
        out[s] = low
    return out.reshape(keys.shape)
