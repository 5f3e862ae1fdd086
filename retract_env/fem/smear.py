"""Veins that a coarse mesh does not follow, as stiffness at the integration points of its elements.

Veins of many corners decide how many elements there are, wherever they lie. Away from the jaws they only
stiffen the flap, and an average does that: with half the nodes, retractions on random flaps are as near to
`fine` as on a mesh that follows every vein (benchmarks/coarse.py, docs/how-it-works.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.elements import equal_parts
from retract_env.scene import Vein

Array = NDArray[np.float64]

PARTS = 8
"""A triangle is looked at in the middles of its PARTS^2 equal parts."""


def relative_stiffness(corners: Array, points: Array, modulus: Array, veins: Sequence[Vein]) -> Array:
    """(m, p) stiffness around each integration point of each triangle, over the triangle's own.

    corners: (m, 3, 2) m; points: (p, 3) barycentric; modulus: (m,) Pa, of what else is in the triangle. It is
    the harmonic mean over the part of the triangle that is nearest to the point: a mean of compliances,
    Reuss's bound, errs to the soft side as large elements err to the stiff one. Poisson's ratios of the veins
    do not count.
    """
    import shapely

    parts = equal_parts(PARTS)
    x, y = np.moveaxis(np.einsum("kc,mcd->mkd", parts, corners), -1, 0)
    compliance = np.ones(x.shape)
    for vein in veins:
        polygon = shapely.polygons(vein.outline)
        left, low, right, high = shapely.bounds(polygon)
        inside = (x > left) & (x < right) & (y > low) & (y < high)
        inside[inside] = shapely.contains_xy(polygon, x[inside], y[inside])
        of_vein = np.broadcast_to(modulus[:, None] / vein.modulus, x.shape)
        compliance[inside] = of_vein[inside]
    nearest = ((parts[:, None] - points) ** 2).sum(axis=-1).argmin(axis=1)
    return np.stack([1 / compliance[:, nearest == p].mean(axis=1) for p in range(len(points))], axis=1)
