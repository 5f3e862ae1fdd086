"""The flap as a planar rod: the compliances of its cross-sections.

The rod follows the medial axis y = h/2. Each cross-section carries a normal force N, a shear force Q and a
moment M about the axis; a fibre at height y above it stretches by strain - curvature y. The narrow flap is
free to contract sideways, so fibres answer with Young's modulus; a flap much deeper than high is stiffer, by
up to 1 / (1 - nu^2). Veins count by their chords: the section's fibres stretch side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.scene import Tissue
from retract_env.spring.columns import veins_of

Array = NDArray[np.float64]

SLICES = 8
"""Cross-sections looked at in each element."""
SHEAR = 5 / 6
"""Share of a rectangular section that carries shear (Timoshenko)."""


@dataclass(frozen=True)
class Elements:
    """Rod elements of equal length between two places along the flap, from the free to the fixed side."""

    length: float
    """m, of each"""
    stretch: Array
    """(n,) 1/N, strain of the axis per N"""
    couple: Array
    """(n,) 1/(N m), strain of the axis per M, and curvature per N"""
    bend: Array
    """(n,) 1/(N m^2), curvature per M"""
    shear: Array
    """(n,) 1/N, shear per Q"""
    bottom: Array
    """(n, 2) 1/N and 1/(N m), strain of the lower surface per N and per M, of each element's softest slice"""
    top: Array
    """(n, 2), the same for the upper surface"""


def elements(tissue: Tissue, left: float, right: float, count: int) -> Elements:
    """`count` elements between x = left and x = right, m. Compliances are means over slices."""
    length = (right - left) / count
    out = np.empty((3, count * SLICES))
    moments(
        left + length / SLICES / 2, length / SLICES, tissue.height / 2, tissue.modulus, *veins_of(tissue), out
    )
    area, first, second = out * tissue.depth
    determinant = area * second - first**2
    stretch, couple, bend = second / determinant, first / determinant, area / determinant
    half = tissue.height / 2
    surfaces = [np.stack([stretch + s * couple, couple + s * bend], axis=-1) for s in (half, -half)]

    def mean(values: Array) -> Array:
        found: Array = values.reshape(count, SLICES).mean(axis=1)
        return found

    def softest(surface: Array) -> Array:
        by_element = surface.reshape(count, SLICES, 2)
        found: Array = by_element[np.arange(count), np.abs(by_element[:, :, 1]).argmax(axis=1)]
        return found

    shear = 2 * (1 + tissue.poisson) / (SHEAR * area)
    bottom, top = (softest(surface) for surface in surfaces)
    return Elements(length, mean(stretch), mean(couple), mean(bend), mean(shear), bottom, top)


@njit(cache=True, nogil=True, error_model="numpy")
def moments(first, step, half, modulus, vertices, offsets, moduli, out):
    """Integrals of E, E y and E y^2 over the height, y from the axis, into out (3, n): N/m, N, N m.

    At x = first + step i, m; half: of the height, m; modulus: of the tissue, Pa; vertices (v, 2) m, offsets
    (k + 1,) into them and moduli (k,) Pa: of the veins, counter-clockwise. Any units that agree will do.
    """
    count = out.shape[1]
    for i in range(count):
        out[0, i] = 2 * half * modulus
        out[1, i] = 0.0
        out[2, i] = 2 * half**3 / 3 * modulus
    for vein in range(len(moduli)):
        more = moduli[vein] - modulus
        begin, end = offsets[vein], offsets[vein + 1]
        for a in range(begin, end):
            b = a + 1 if a + 1 < end else begin
            x0, y0, x1, y1 = vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1]
            if x0 == x1:
                continue
            # counter-clockwise, an edge that goes left closes a chord from above
            sign = more if x0 > x1 else -more
            low, high = min(x0, x1), max(x0, x1)
            i = max(0, math.ceil((low - first) / step) - 1)
            while i < count and first + step * i < low:
                i += 1
            while i < count and first + step * i < high:
                y = y0 + (first + step * i - x0) / (x1 - x0) * (y1 - y0) - half
                out[0, i] += sign * y
                out[1, i] += sign * y**2 / 2
                out[2, i] += sign * y**3 / 3
                i += 1
