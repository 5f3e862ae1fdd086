"""How stiff a flap is to squeeze, along its length: k_eq(x) of the spring model, by sweep. Sec. IV-B.

A column of the flap is a row of springs, vein and tissue in turn. Its compliance per area, m/Pa, is
1/k_eq(x) = sum_i l_i(x) / E_i (Eq. 2) with l_i the chord of each part; Poisson's ratio does not enter. It is
piecewise linear between polygon vertices, so a sweep over the v sorted vertices finds it in O(v log v).

What the paper leaves open, decided here:

* Overlapping veins count once, the stiffer in front.
* A vertical edge makes k_eq jump; `compliance` and `k_eq` give the stiffer of both one-sided values at the
  jump itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numba import njit
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from typing_extensions import Self

    from retract_env.scene import Tissue

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

GRID = 2.0**40
"""Vertices within length / GRID, 0.05 pm on 50 mm, share an abscissa; so no slope is too steep to compute."""
STRAY = 1e-9
"""Vertices may lie outside the flap by this fraction of its size, as those of a rounded drawing do."""


class Stiffness:
    """k_eq(x) of a flap at rest. Sec. IV-B, Eq. 2.

    length, height: m. knots: (m,) m, ascending from -length to 0, where the compliance may bend or jump.
    left, right: (m,) m/Pa, compliance just left and just right of each knot; at the two ends both are inside.
    """

    length: float
    height: float
    knots: Array
    left: Array
    right: Array

    def __init__(self, tissue: Tissue) -> None:
        """Sweep the veins of `tissue`, which do not overlap. O(v log v)."""
        outlines = [np.asarray(vein.outline, dtype=np.float64) for vein in tissue.veins]
        moduli = np.array([vein.modulus for vein in tissue.veins], dtype=np.float64)
        self._sweep(tissue.length, tissue.height, tissue.modulus, _polygons(outlines), moduli)

    @classmethod
    def from_outlines(
        cls, length: float, height: float, modulus: float, outlines: Sequence[ArrayLike], moduli: ArrayLike
    ) -> Self:
        """A flap (m, m, Pa) with veins that may overlap: outlines (n, 2) m, either way round, and moduli, Pa.

        Overlaps cost O(v log v) more where each vein meets few others. Raises ValueError, one line, where an
        outline crosses itself or leaves the flap, or a size or modulus is not positive.
        """
        stiffness = np.asarray(moduli, dtype=np.float64)
        for name, value in (("length", length), ("height", height), ("modulus", modulus)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value:g}, allowed above 0")
        if stiffness.shape != (len(outlines),) or not (np.isfinite(stiffness) & (stiffness > 0)).all():
            raise ValueError(f"moduli = {stiffness.tolist()}, allowed {len(outlines)} numbers above 0 Pa")
        vertices = [np.asarray(outline, dtype=np.float64) for outline in outlines]
        low, high = np.array([-length, 0.0]), np.array([0.0, height])
        stray = STRAY * np.array([length, height])
        for i, points in enumerate(vertices):
            if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
                raise ValueError(f"outlines[{i}] has shape {points.shape}, allowed (n >= 3, 2)")
            if not ((points >= low - stray) & (points <= high + stray)).all():
                raise ValueError(f"outlines[{i}] leaves the flap, [{-length:g}, 0] x [0, {height:g}] m")
        polygons = _polygons(vertices)
        crossed = np.flatnonzero(~shapely.is_valid(polygons))
        if crossed.size:
            raise ValueError(f"outlines[{crossed[0]}] crosses itself or has no area")
        model = cls.__new__(cls)
        model._sweep(length, height, modulus, _without_overlap(polygons, stiffness), stiffness)
        return model

    def _sweep(
        self, length: float, height: float, modulus: float, pieces: NDArray[np.object_], moduli: Array
    ) -> None:
        """Set the knots and their compliances from disjoint pieces (n,) with moduli (n,) Pa.

        Going right, an edge that rises by dy, its vein to the left of it, takes dy off the chord: evenly over
        its width, at once where it is vertical. That adds -w dy to the compliance, w = 1/E_vein - 1/E_tissue.
        """
        self.length, self.height = float(length), float(height)
        parts, vein = shapely.get_parts(pieces, return_index=True)
        rings, part = shapely.get_rings(parts, return_index=True)
        outer = np.diff(part, prepend=-1) > 0
        weight = (1 / moduli - 1 / modulus)[vein[part]] * np.where(shapely.is_ccw(rings) == outer, 1.0, -1.0)
        points, ring = shapely.get_coordinates(rings, return_index=True)
        edge = np.flatnonzero(ring[1:] == ring[:-1])
        change = -weight[ring[edge]] * (points[edge + 1, 1] - points[edge, 1])
        x = np.clip(np.concatenate([[-self.length, 0.0], points[:, 0]]), -self.length, 0.0)
        places = np.rint(x / self.length * GRID)
        grid, first, index = np.unique(places, return_index=True, return_inverse=True)
        index = index[2:]  # of the vertices alone
        start, stop = np.minimum(index[edge], index[edge + 1]), np.maximum(index[edge], index[edge + 1])
        sloped = start < stop
        start, stop, sloped_change = start[sloped], stop[sloped], change[sloped]
        slope = sloped_change / (grid[stop] - grid[start])

        # events: an edge begins (+1), ends (-1), or is vertical (0)
        at = np.concatenate([start, stop, index[edge[~sloped]]])
        amount = np.concatenate([slope, -slope, change[~sloped]])
        kind = np.repeat(np.array([1, -1, 0]), [slope.size, slope.size, at.size - 2 * slope.size])
        order = np.argsort(at, kind="stable")
        bounds = np.searchsorted(at[order], np.arange(grid.size + 1))
        left, right = _integrate(grid, bounds, amount[order], kind[order])
        # springs in a row are no stiffer than the stiffest and no softer than the softest all through
        softest, stiffest = moduli.min(initial=modulus), moduli.max(initial=modulus)
        self.knots = x[first]
        self.left = np.clip(height / modulus + left, height / stiffest, height / softest)
        self.right = np.clip(height / modulus + right, height / stiffest, height / softest)
        self.left[0], self.right[-1] = self.right[0], self.left[-1]
        for values in (self.knots, self.left, self.right):
            values.setflags(write=False)

    def compliance(self, x: ArrayLike) -> Array:
        """1/k_eq, m/Pa, at x (...,) m; at a jump the stiffer side. ValueError outside [-length, 0]. Eq. 2."""
        at = np.asarray(x, dtype=np.float64)
        outside = ~((at >= -self.length) & (at <= 0))
        if outside.any():
            raise ValueError(f"x = {at[outside].flat[0]:g} m, allowed [{-self.length:g}, 0] m")
        i = np.clip(np.searchsorted(self.knots, at, side="right") - 1, 0, self.knots.size - 2)
        t = (at - self.knots[i]) / (self.knots[i + 1] - self.knots[i])
        between = self.right[i] + t * (self.left[i + 1] - self.right[i])
        return np.asarray(np.where(t == 0, np.minimum(self.left[i], between), between))

    def k_eq(self, x: ArrayLike) -> Array:
        """Stiffness per area, Pa/m, of the column at x (...,) m; otherwise as `compliance`. Eq. 2."""
        return 1 / self.compliance(x)


def _polygons(outlines: Sequence[Array]) -> NDArray[np.object_]:
    """(n,) shapely polygons from outlines of (k, 2) m."""
    if not outlines:
        return np.empty(0, dtype=object)
    owner = np.repeat(np.arange(len(outlines)), [len(outline) for outline in outlines])
    return np.asarray(shapely.polygons(shapely.linearrings(np.concatenate(outlines), indices=owner)))


def _without_overlap(polygons: NDArray[np.object_], moduli: Array) -> NDArray[np.object_]:
    """(n,) disjoint pieces with the same union: the stiffer keeps what two share, of equals the earlier."""
    own, other = shapely.STRtree(polygons).query(polygons, predicate="intersects")
    loses = (moduli[own] < moduli[other]) | ((moduli[own] == moduli[other]) & (own > other))
    own, other = own[loses], other[loses]
    crossing = ~shapely.touches(polygons[own], polygons[other])
    order = np.argsort(own[crossing], kind="stable")
    own, other = own[crossing][order], other[crossing][order]
    pieces = polygons.copy()
    losers, begins = np.unique(own, return_index=True)
    for loser, winners in zip(losers, np.split(other, begins[1:]), strict=False):
        pieces[loser] = shapely.difference(polygons[loser], shapely.union_all(polygons[winners]))
    return pieces


# The kernels below must round as written: no fastmath.
@njit(cache=True)
def _add(high: float, low: float, term: float) -> tuple[float, float]:
    """(high + low) + term as an unevaluated sum of two doubles (Knuth 1969, Dekker 1971)."""
    total = high + term
    part = total - high
    low += (high - (total - part)) + (term - part)
    high = total + low
    return high, low - (high - total)


@njit(cache=True)
def _integrate(grid: Array, bounds: Indices, amount: Array, kind: Indices) -> tuple[Array, Array]:
    """Values left and right (m,) of each grid point (m,), zero where no edge is open.

    Events bounds[i]:bounds[i+1] happen at grid[i]: kind +1 or -1 adds `amount` to the slope, 0 to the value.
    Both are double-doubles, as steep edges leave rounding behind in a plain sum, and are reset in every gap.
    """
    left, right = np.zeros(grid.size), np.zeros(grid.size)
    value, value_low, slope, slope_low = 0.0, 0.0, 0.0, 0.0
    still_open = 0
    for i in range(grid.size):
        if i > 0 and still_open > 0:
            step = grid[i] - grid[i - 1]
            value, value_low = _add(value, value_low, slope * step)
            value, value_low = _add(value, value_low, slope_low * step)
        left[i] = value
        for e in range(bounds[i], bounds[i + 1]):
            if kind[e] == 0:
                value, value_low = _add(value, value_low, amount[e])
            else:
                still_open += kind[e]
                slope, slope_low = _add(slope, slope_low, amount[e])
        if still_open == 0:
            value, value_low, slope, slope_low = 0.0, 0.0, 0.0, 0.0
        right[i] = value
    return left, right
