"""The flap as a planar rod: the compliances of its cross-sections.

The rod follows the medial axis y = h/2. Each cross-section carries a normal force N, a shear force Q and a
moment M about the axis; a fibre at height y above it stretches by strain - curvature y. The narrow flap is
free to contract sideways, so fibres answer with Young's modulus; a flap much deeper than high is stiffer, by
up to 1 / (1 - nu^2). Veins count by their chords: the section's fibres stretch side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.scene import Tissue

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
    places = left + length * (np.arange(count * SLICES) + 0.5) / SLICES
    area, first, second = _moments(tissue, places) * tissue.depth
    determinant = area * second - first**2
    stretch, couple, bend = second / determinant, first / determinant, area / determinant
    half = tissue.height / 2
    surfaces = [np.stack([stretch + s * couple, couple + s * bend], axis=-1) for s in (half, -half)]

    def mean(values: Array) -> Array:
        return values.reshape(count, SLICES).mean(axis=1)

    def softest(surface: Array) -> Array:
        by_element = surface.reshape(count, SLICES, 2)
        return by_element[np.arange(count), np.abs(by_element[:, :, 1]).argmax(axis=1)]

    shear = 2 * (1 + tissue.poisson) / (SHEAR * area)
    bottom, top = (softest(surface) for surface in surfaces)
    return Elements(length, mean(stretch), mean(couple), mean(bend), mean(shear), bottom, top)


def _moments(tissue: Tissue, x: Array) -> Array:
    """(3, n) integrals of E, E y and E y^2 over the height at x (n,), y from the axis; N/m, N, N m."""
    half = tissue.height / 2
    total = np.outer([2 * half, 0.0, 2 * half**3 / 3], np.full(x.shape, tissue.modulus))
    for vein in tissue.veins:
        outline = np.array(vein.outline)
        for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            cut = np.flatnonzero((x0 <= x) != (x1 <= x))
            y = y0 + (x[cut] - x0) / (x1 - x0) * (y1 - y0) - half
            # counter-clockwise, an edge that goes left closes a chord from above
            sign = np.sign(x0 - x1) * (vein.modulus - tissue.modulus)
            total[:, cut] += sign * np.stack([y, y**2 / 2, y**3 / 3])
    return total
