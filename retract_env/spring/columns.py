"""How stiff a flap is to squeeze at given places: k_eq(x) from plain arrays, compiled. Sec. IV-B, Eq. 2.

For many flaps at a few places each, as observations need it; `Stiffness` has the whole curve of one flap, and
the same values. A flap's veins are flat arrays, as those of `retract_env.scene.flaps`:

    vertices (n, 2)        m, the outlines one after the other, each counter-clockwise
    offsets (veins + 1,)   vein v has vertices[offsets[v]:offsets[v + 1]]; one without vertices is none
    moduli (veins,)        Pa

The veins do not overlap and lie within the flap, as in every scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

if TYPE_CHECKING:
    from retract_env.scene import Tissue

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def veins_of(tissue: Tissue) -> tuple[Array, Indices, Array]:
    """Vertices (n, 2) m, offsets (veins + 1,) and moduli (veins,) Pa."""
    corners = [len(vein.outline) for vein in tissue.veins]
    vertices = [vertex for vein in tissue.veins for vertex in vein.outline]
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 2),
        np.cumsum([0, *corners], dtype=np.int64),
        np.array([vein.modulus for vein in tissue.veins], dtype=np.float64),
    )


def k_eq(tissue: Tissue, x: Array) -> Array:
    """Stiffness per area, Pa/m, of the columns at x (m,) m, ascending within [-length, 0]; as `columns`."""
    at = np.ascontiguousarray(x, dtype=np.float64)
    if at.ndim != 1 or not ((at >= -tissue.length) & (at <= 0)).all() or (np.diff(at) < 0).any():
        raise ValueError(f"x: allowed ascending numbers in [{-tissue.length:g}, 0] m")
    stiffness = np.empty(at.size)
    columns(tissue.length, tissue.height, tissue.modulus, *veins_of(tissue), at, stiffness)
    return stiffness


# No fastmath: whatever these arrays are part of, the same flap gives the same bits.
@njit(cache=True, nogil=True, error_model="numpy")
def columns(
    length: float,
    height: float,
    modulus: float,
    vertices: Array,
    offsets: Indices,
    moduli: Array,
    x: Array,
    stiffness: Array,
) -> None:
    """Write k_eq, Pa/m, at x (m,) m, ascending within [-length, 0], to stiffness (m,). O(edges log m + m).

    At a vertical edge it is the stiffer of both one-sided values. length, height: m, of the flap;
    modulus: Pa, of its tissue.
    """
    m = x.size
    # Compliance that the veins add, m/Pa, just left and just right of each place. A vein's chord is what lies
    # between the edges above, which go left, and those below, which go right.
    left, right = np.zeros(m), np.zeros(m)
    softest, stiffest = modulus, modulus
    for v in range(moduli.size):
        begin, end = offsets[v], offsets[v + 1]
        if begin == end:
            continue
        softest, stiffest = min(softest, moduli[v]), max(stiffest, moduli[v])
        weight = 1.0 / moduli[v] - 1.0 / modulus
        ax, ay = vertices[end - 1, 0], vertices[end - 1, 1]
        for k in range(begin, end):
            bx, by = vertices[k, 0], vertices[k, 1]
            if ax < bx:
                _add_edge(ax, ay, bx, by, -weight, x, left, right)
            elif ax > bx:
                _add_edge(bx, by, ax, ay, weight, x, left, right)
            ax, ay = bx, by
    # springs in a row are no stiffer than the stiffest and no softer than the softest all through
    least, most, tissue = height / stiffest, height / softest, height / modulus
    for i in range(m):
        if x[i] <= -length:
            compliance = right[i]  # at the ends of the flap only one side is within
        elif x[i] >= 0.0:
            compliance = left[i]
        else:
            compliance = min(left[i], right[i])
        stiffness[i] = 1.0 / min(max(tissue + compliance, least), most)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_edge(
    ax: float, ay: float, bx: float, by: float, weight: float, x: Array, left: Array, right: Array
) -> None:
    """Add weight times the height of the edge from a to b, ax < bx, where it passes over x."""
    first, beyond = 0, x.size
    while first < beyond:  # the first place that is not left of a
        middle = (first + beyond) // 2
        if x[middle] < ax:
            first = middle + 1
        else:
            beyond = middle
    for i in range(first, x.size):
        if x[i] > bx:
            break
        added = weight * (ay + (by - ay) * ((x[i] - ax) / (bx - ax)))
        if x[i] > ax:
            left[i] += added
        if x[i] < bx:
            right[i] += added
