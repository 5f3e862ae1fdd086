"""The continuous spring model: where to close the jaws on a flap with veins, how far. Sec. IV-B, IV-C.

Stable grasps are the minima of k_eq(x), which `retract_env.spring.stiffness` finds by sweep.

What the paper leaves open, decided here:

* A vertical edge makes k_eq jump. Both one-sided values count as extrema.
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
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp
from retract_env.mesh import SLIVER
from retract_env.spring.stiffness import Stiffness

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FLAT = 1e-10
"""Differences of compliance below this part of its maximum count as none: rounding over 10^5 edges stays
below."""


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


class SpringModel(Stiffness):
    """k_eq(x) of a flap at rest, and the stable grasps in it. Sec. IV-B, IV-C."""

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
        # a patch that touched the fixed end would be held twice
        low, high = -self.length + jaw_width / 2, -(0.5 + SLIVER) * jaw_width
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
