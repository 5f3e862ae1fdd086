"""One flap's section as a mesh of two triangles an element: where its points are, strains, jaw forces.

What a `TissueState` says besides what is measured: pictures and observations of a single flap are made of it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.rod.block import Block, jaws_in
from retract_env.rod.chain import LANES, LENGTH
from retract_env.rod.flap import DEPTH, FREE, HEIGHT, INNER, MODULUS, SHORTEST
from retract_env.rod.grip import COMPRESSION, squeeze
from retract_env.rod.measures import COLUMNS, DRAG_1, DRAG_2, NORMAL_1, NORMAL_2, PINCH
from retract_env.rod.mechanics import strains

Array = NDArray[np.float64]

ROWS = 3
"""Points of a section that are told: of the lower surface, the axis, the upper surface."""
TRIANGLES = 2 * (FREE + INNER)


@njit(cache=True, nogil=True, error_model="numpy")
def columns_of(length, height, jaw_x):
    """(COLUMNS,) where the sections are at rest that are told of, m, from the free end to the fixed one."""
    left = min(-length, jaw_x - SHORTEST * height)
    columns = np.empty(COLUMNS)
    for k in range(2 * FREE):
        columns[k] = left + (jaw_x - left) * (k / (2 * FREE))
    for k in range(2 * INNER + 1):
        columns[2 * FREE + k] = jaw_x * (1 - k / (2 * INNER))
    return columns


def section_of(
    block: Block, lane: int, columns: Array, jaw_x: float
) -> tuple[Array, Array, Array, Array, Array]:
    """What one lane's section looks like.

    Returns points (ROWS COLUMNS, 2) m; mean strain of each triangle (TRIANGLES,); jaws (4,) m; reactions
    (2, 2) N, tissue on jaw; where at rest the flap is strained most (2,) m.
    """
    points, strain = np.empty((ROWS * COLUMNS, 2)), np.empty(TRIANGLES)
    jaws, reactions, spot = np.empty(4), np.empty((2, 2)), np.empty(2)
    _fill(block, lane, columns, jaw_x, points, strain, jaws, reactions, spot)
    return points, strain, jaws, reactions, spot


@njit(cache=True, nogil=True, error_model="numpy")
def reactions_on(flap, felt, jaws):
    """Forces of the tissue on the lower and on the upper jaw, x, y, x, y, N. flap: (NUMBERS,); felt:
    (MEASURED,); jaws: (4,) m."""
    ax, ay = jaws[2] - jaws[0], jaws[3] - jaws[1]
    long = math.sqrt(ax * ax + ay * ay)
    ax, ay = ax / long, ay / long
    unit = flap[MODULUS] * flap[HEIGHT] * flap[DEPTH]
    press_1, drag_1 = unit * felt[NORMAL_1], unit * felt[DRAG_1]
    press_2, drag_2 = unit * -felt[NORMAL_2], unit * felt[DRAG_2]
    return (
        -(press_1 * ax + drag_1 * ay),
        -(press_1 * ay - drag_1 * ax),
        -(press_2 * ax + drag_2 * ay),
        -(press_2 * ay - drag_2 * ax),
    )


@njit(cache=True, error_model="numpy")
def _fill(block, lane, columns, jaw_x, points, strain, jaws, reactions, spot):
    height = block.flap[lane, HEIGHT]
    for column in range(COLUMNS):
        at = 4 * column * LANES + lane
        for k in range(2):
            low, high = block.points[at + k * LANES] * height, block.points[at + (2 + k) * LANES] * height
            points[ROWS * column, k], points[ROWS * column + 2, k] = low, high
            points[ROWS * column + 1, k] = (low + high) / 2
    jaws_in(block, lane, jaws)
    on = reactions_on(block.flap[lane], block.measured[lane], jaws)
    for jaw in range(2):
        reactions[jaw, 0], reactions[jaw, 1] = on[2 * jaw], on[2 * jaw + 1]
    compression = block.grip[lane, COMPRESSION]
    worst = squeeze(block.grip[lane], compression)[1]
    spot[0], spot[1] = jaw_x, 0.0
    for e in range(FREE + INNER):
        U, P, k = (block.free_u, block.free, e) if e < FREE else (block.inner_u, block.inner, e - FREE)
        u, per = 3 * k * LANES + lane, 1.0 / P[LENGTH * LANES + lane]
        middle = 0.5 * (U[u + 2 * LANES] + U[u + 5 * LANES])
        dx, dy = (U[u + 3 * LANES] - U[u]) * per, (U[u + 4 * LANES] - U[u + LANES]) * per
        stretch = strains(dx, dy, math.sin(middle), math.cos(middle))[0]
        bend = (U[u + 5 * LANES] - U[u + 2 * LANES]) * per
        low, high = abs(stretch + 0.5 * bend), abs(stretch - 0.5 * bend)
        x = columns[2 * e + 1]
        far = (x - jaw_x) / (PINCH * height)
        pinched = compression / (1.0 + far * far)
        # the mean over a triangle is that over the middles of its edges, two of which are on the axis
        strain[2 * e] = max((low + 2 * abs(stretch)) / 3, pinched)
        strain[2 * e + 1] = max((high + 2 * abs(stretch)) / 3, pinched)
        if max(low, high) > worst:
            worst = max(low, high)
            spot[0], spot[1] = x, 0.0 if low > high else height
