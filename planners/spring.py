"""The continuous spring model: where to close the jaws on a flap with veins, how far. Sec. IV-B, IV-C.

A column of the flap is a row of springs, vein and tissue in turn. Its compliance per area, m/Pa, is
1/k_eq(x) = sum_i l_i(x) / E_i (Eq. 2) with l_i the chord of each part; Poisson's ratio does not enter. It is
piecewise linear between polygon vertices, so a sweep over the v sorted vertices finds it, and every extremum,
in O(v log v).

What the paper leaves open, decided here:

* Overlapping veins count once, the stiffer in front.
* A vertical edge makes k_eq jump. Both one-sided values count as extrema; `compliance` and `k_eq` give the
  stiffer at the jump itself.
* A flat minimum is one stable grasp, at its middle.
* Beyond the free end nothing is left to climb: a basin that runs out there has Escape = 0 and k_n = k_eq.
* Beyond the fixed end the tissue goes on and is held, so jaws cannot leave there: a basin that runs on to
  x = 0 has a wall without bound on that side, and its maximum towards the free end alone decides.
* A maximum of k_eq at an end of the flap is a neighbouring maximum like any other.
* Jaws stand on the flap with their whole width: x in [-length + width/2, -width/2]. A grasp nearer to an end
  is moved there, and dropped if that takes it to a maximum or over it into another basin.
* Tissue without any extremum (no veins, or one layer from end to end) is sampled uniformly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numba import njit
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp

if TYPE_CHECKING:
    from retract_env.scene import Tissue

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

GRID = 2.0**40
"""Vertices within length / GRID, 0.05 pm on 50 mm, share an abscissa; so no slope is too steep to compute."""
FLAT = 1e-10
"""Differences of compliance below this part of its maximum are none; rounding over 10^5 edges is smaller."""
STRAY = 1e-9
"""Vertices may leave the flap by this fraction of its size, the rounding of whoever drew them."""


@dataclass(frozen=True)
class Basin:
    """A local minimum of k_eq and the maxima beside it. Sec. IV-B.

    x: m, the minimum, or the middle of a flat one that is `width` wide, m.
    left, right: m, where the maxima towards the free and the fixed end begin; that end where there is none.
    k_eq, k_left, k_right: Pa/m, at the minimum and at the maxima; k_left = k_eq where the basin runs out at
    the free end, k_right = inf where it runs on to the fixed end.
    """

    x: float
    width: float
    left: float
    right: float
    k_eq: float
    k_left: float
    k_right: float

    @property
    def k_n(self) -> float:
        """Pa/m, the lower of the two maxima: the weaker way out."""
        return min(self.k_left, self.k_right)

    @property
    def escape(self) -> float:
        """Pa/m, Escape(x) = min(k_eq(x_r), k_eq(x_l)) - k_eq(x)."""
        return self.k_n - self.k_eq


def optimal_compression(k_eq: ArrayLike, k_n: ArrayLike, height: float, strain_limit: float) -> Array:
    """Compression delta [m] at which U_L = k_eq (eps_L h - delta)^2 / 2 equals U_n = k_n delta^2 / 2.

    k_eq, k_n: (...,) Pa/m. Sec. IV-C, Eq. 5, with its sigma read as compression and (1 - eps_L) as eps_L.
    """
    grasp, neighbour = np.sqrt(k_eq), np.sqrt(k_n)
    return np.asarray(strain_limit * height * grasp / (grasp + neighbour))


class SpringModel:
    """k_eq(x) of a flap at rest, and the stable grasps in it. Sec. IV-B, Eq. 2.

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
    ) -> SpringModel:
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

    def basins(self) -> list[Basin]:
        """The local minima of k_eq from the free to the fixed end; without any, one basin fills the flap."""
        x = np.repeat(self.knots, 2)
        compliance = np.column_stack([self.left, self.right]).ravel()
        first, best, last, soft = _turns(compliance, FLAT * compliance.max())
        near, k, far = x[first], 1 / compliance[best], x[last]
        # what lies before the first and after the last extremum: nothing to climb, and a wall
        before, k_before = np.append(-self.length, far), np.append(k[0], k)
        after, k_after = np.append(near, 0.0), np.append(k, math.inf)
        i = np.flatnonzero(soft)
        middle, width = (near[i] + far[i]) / 2, far[i] - near[i]
        columns = (middle, width, before[i], after[i + 1], k[i], k_before[i], k_after[i + 1])
        return [Basin(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]

    def stable_grasps(
        self, strain_limit: float = 0.5, jaw_width: float = 1e-3, samples: int = 10
    ) -> list[Grasp]:
        """Stable grasps with their compression (Eq. 5), highest score U_n = k_n delta^2 / 2 first, then by x.

        strain_limit: eps_L in (0, 1). jaw_width: m, less than the length. Where there is no extremum,
        `samples` grasps stand at -length i / samples, i = 1 ... samples (Fig. 8), moved so that the jaws fit;
        those that then coincide count once. Raises ValueError for arguments outside their range.
        """
        if not 0 < strain_limit < 1:
            raise ValueError(f"strain_limit = {strain_limit:g}, allowed (0, 1)")
        if not 0 < jaw_width < self.length:
            raise ValueError(f"jaw_width = {jaw_width:g} m, allowed (0, {self.length:g}) m")
        if samples < 1:
            raise ValueError(f"samples = {samples}, allowed 1 or more")
        low, high = -self.length + jaw_width / 2, -jaw_width / 2
        basins = self.basins()
        if len(basins) == 1 and basins[0].width == self.length:
            places = np.unique(np.clip(-self.length * np.arange(1, samples + 1) / samples, low, high))
            candidates = [(x, basins[0].k_eq, basins[0].k_n) for x in places]
        else:
            candidates = []
            for basin in basins:
                x, k = min(max(basin.x, low), high), basin.k_eq
                if x != basin.x:
                    k = float(self.k_eq(x))
                if basin.left < x < basin.right:
                    candidates.append((x, k, max(k, basin.k_n)))
        at, k_eq, k_n = np.array(candidates).reshape(-1, 3).T
        delta = optimal_compression(k_eq, k_n, self.height, strain_limit)
        rows = zip(at.tolist(), delta.tolist(), (k_n * delta**2 / 2).tolist(), strict=True)
        grasps = [Grasp(*row) for row in rows]
        return sorted(grasps, key=lambda grasp: (-grasp.score, grasp.x))


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


@njit(cache=True)
def _turns(values: Array, tolerance: float) -> tuple[Indices, Indices, Indices, NDArray[np.bool_]]:
    """Local extrema of values (n,) that stand out by more than `tolerance`, high and low in turn, ends too.

    Returns for each the first index of the run within `tolerance` of it, its own, the run's last, and whether
    it is high. Values that are all alike are one high.
    """
    n = values.size
    runs, is_high = np.empty((3, n), np.int64), np.empty(n, np.bool_)
    count, high, low, heading = 0, 0, 0, 0  # heading: +1 up, -1 down, 0 not known yet
    for i in range(n + 1):
        if i < n:
            if values[i] > values[high]:
                high = i
            if values[i] < values[low]:
                low = i
            fell = heading >= 0 and values[i] < values[high] - tolerance
            rose = heading <= 0 and values[i] > values[low] + tolerance
            if not (fell or rose):
                continue
        else:
            fell = heading >= 0
        at = high if fell else low
        a, b = at, at
        while a > 0 and abs(values[a - 1] - values[at]) <= tolerance:
            a -= 1
        while b < n - 1 and abs(values[b + 1] - values[at]) <= tolerance:
            b += 1
        runs[0, count], runs[1, count], runs[2, count], is_high[count] = a, at, b, fell
        count += 1
        heading = -1 if fell else 1
        high, low = i, i
    return runs[0, :count], runs[1, :count], runs[2, :count], is_high[:count]
