"""Random flaps as plain arrays, drawn by one compiled kernel: what `sample_scene` makes its scenes of.

Whoever needs thousands of flaps, as a batch of environments does, takes the arrays as they are: those of the
scenes that `sample_scene` would have made of the same states, to the last bit. That a scene may have the
values that are drawn is for `SceneRanges` to see to; `draw_flap` does so for the veins.

Arrays of a flap that may have up to `most` veins, the upper end of the range of their number:

    scalars (8,)            length, height, depth, modulus, camera_x, camera_y, target_x, slope; SI units
    vertices (10 most, 2)   m, the outlines one after the other from the free end on, counter-clockwise
    offsets (most + 1,)     vein v has vertices[offsets[v]:offsets[v + 1]]; none beyond the last vein
    moduli (most,)          Pa, of each vein; 0 where there is none
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.scene.bounds import CAMERA_DISTANCE
from retract_env.scene.pcg64 import State, integers, random, uniform
from retract_env.scene.veins import MIN_CORNER, MIN_EDGE, MIN_GAP

if TYPE_CHECKING:
    from retract_env.scene.sampling import SceneRanges

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SCALARS = ("length", "height", "depth", "modulus", "camera_x", "camera_y", "target_x", "slope")
LENGTH, HEIGHT, DEPTH, MODULUS, CAMERA_X, CAMERA_Y, TARGET_X, SLOPE = range(len(SCALARS))
MOST_CORNERS = 10
"""of a vein that is drawn"""

_RANGES = (
    "length", "height", "depth", "tissue_modulus", "target", "slope", "veins", "vein_modulus", "vein_width",
    "vein_height",
)  # fmt: skip
_LENGTH, _HEIGHT, _DEPTH, _MODULUS, _TARGET, _SLOPE, _VEINS, _VEIN_MODULUS, _WIDTH, _THICKNESS = range(10)

_TRIES = 300
_SHRINK = np.array([0.85**k for k in range(_TRIES // 20)])
"""By what a vein's size is multiplied that has found no room, after every 20 tries."""
_GAP = 2 * MIN_GAP  # m; rounding the outlines leaves MIN_GAP of it
_DIGITS = 1e6  # outlines are rounded to 1 um
_SHARPEST = math.tan(MIN_CORNER)
_LEFT, _RIGHT, _LOW, _HIGH = range(4)
_WIDE = _GAP * (1 + 1e-9)
"""m, where it is rounding that decides, distances are found in full; beyond this they need not be."""


def table(ranges: SceneRanges) -> Array:
    """(10, 2): the ranges as the kernels take them, least and greatest."""
    return np.array([getattr(ranges, name) for name in _RANGES], dtype=np.float64)


def room(most: int) -> tuple[Array, Array, Indices, Array]:
    """Scalars, vertices, offsets and moduli for a flap of up to `most` veins."""
    scalars, vertices = np.zeros(len(SCALARS)), np.zeros((MOST_CORNERS * most, 2))
    return scalars, vertices, np.zeros(most + 1, dtype=np.int64), np.zeros(most)


# No fastmath below: every number has to be rounded as Python and NumPy round it.
@njit(cache=True, nogil=True, error_model="numpy")
def draw_flap(
    row: State, ranges: Array, scalars: Array, vertices: Array, offsets: Indices, moduli: Array
) -> tuple[np.int64, np.int64]:
    """Draw one flap from the generator's state `row` (6,), which goes on, and `ranges` (10, 2) of `table`.

    Returns how many veins were wanted and how many found room. Where these differ the flap is none.
    """
    length = uniform(row, ranges[_LENGTH, 0], ranges[_LENGTH, 1])
    height = uniform(row, ranges[_HEIGHT, 0], ranges[_HEIGHT, 1])
    depth = uniform(row, ranges[_DEPTH, 0], ranges[_DEPTH, 1])
    modulus = _log_uniform(row, ranges[_MODULUS, 0], ranges[_MODULUS, 1])
    target = -length * uniform(row, ranges[_TARGET, 0], ranges[_TARGET, 1]) + 0.0  # no -0.0, as in scenes
    slope = uniform(row, ranges[_SLOPE, 0], ranges[_SLOPE, 1])
    scalars[LENGTH], scalars[HEIGHT], scalars[DEPTH], scalars[MODULUS] = length, height, depth, modulus
    scalars[CAMERA_X] = target - CAMERA_DISTANCE * math.cos(slope)
    scalars[CAMERA_Y] = CAMERA_DISTANCE * math.sin(slope)
    scalars[TARGET_X], scalars[SLOPE] = target, slope

    count = integers(row, np.int64(ranges[_VEINS, 0]), np.int64(ranges[_VEINS, 1]))
    outlines, boxes = np.empty((count, MOST_CORNERS, 2)), np.empty((count, 4))
    corners, order = np.empty(count, np.int64), np.empty(count, np.int64)
    placed = np.int64(0)  # a literal would have what takes it compiled twice
    while placed < count and _place(row, ranges, length, height, outlines, corners, boxes, placed):
        place = placed
        while place > 0 and _is_left_of(outlines, corners, placed, order[place - 1]):
            order[place] = order[place - 1]
            place -= 1
        order[place] = placed
        placed += 1

    end, veins = 0, count if placed == count else 0
    offsets[0] = 0
    for v in range(moduli.size):
        moduli[v] = 0.0
        if v < veins:
            for k in range(corners[order[v]]):
                vertices[end, 0], vertices[end, 1] = outlines[order[v], k, 0], outlines[order[v], k, 1]
                end += 1
            moduli[v] = _log_uniform(row, ranges[_VEIN_MODULUS, 0], ranges[_VEIN_MODULUS, 1])
        offsets[v + 1] = end
    for k in range(end, vertices.shape[0]):
        vertices[k, 0], vertices[k, 1] = 0.0, 0.0
    return count, placed


@njit(cache=True, nogil=True, error_model="numpy")
def _log_uniform(row: State, low: float, high: float) -> float:
    return float(low * (high / low) ** random(row))


@njit(cache=True, nogil=True)
def _is_left_of(outlines: Array, corners: Indices, i: int, j: int) -> bool:
    """Whether outline i has a vertex further left, of equals lower, than all of outline j."""
    a, b = _leftmost(outlines[i], corners[i]), _leftmost(outlines[j], corners[j])
    return bool(a < b)


@njit(cache=True, nogil=True)
def _leftmost(outline: Array, corners: int) -> tuple[float, float]:
    x, y = outline[0, 0], outline[0, 1]
    for k in range(1, corners):
        if outline[k, 0] < x or (outline[k, 0] == x and outline[k, 1] < y):
            x, y = outline[k, 0], outline[k, 1]
    return x, y


@njit(cache=True, nogil=True, error_model="numpy")
def _place(
    row: State,
    ranges: Array,
    length: float,
    height: float,
    outlines: Array,
    corners: Indices,
    boxes: Array,
    new: int,
) -> bool:
    """Write outline `new`, an oval at a random place clear of those before it; False if none has room, or
    only one that no vein may have."""
    oval = outlines[new]
    for attempt in range(_TRIES):
        size = _SHRINK[attempt // 20] * height
        a = size * uniform(row, ranges[_WIDTH, 0], ranges[_WIDTH, 1]) / 2
        b = size * uniform(row, ranges[_THICKNESS, 0], ranges[_THICKNESS, 1]) / 2
        n = _draw_oval(row, a, b, oval)
        left, right, low, high = _bounds(oval, n)
        left, right, low, high = left - _GAP, right + _GAP, low - _GAP, high + _GAP
        if right - left > length or high - low > height:
            continue
        x = uniform(row, -length - left, -right)
        y = uniform(row, -low, height - high)
        for k in range(n):
            oval[k, 0], oval[k, 1] = _rounded(oval[k, 0] + x), _rounded(oval[k, 1] + y)
        corners[new] = n
        boxes[new, _LEFT], boxes[new, _RIGHT], boxes[new, _LOW], boxes[new, _HIGH] = _bounds(oval, n)
        clear = True
        for other in range(new):
            if _boxes_within_gap(boxes[new], boxes[other]) and _within_gap(
                oval, n, boxes[new], outlines[other], corners[other], boxes[other]
            ):
                clear = False
                break
        if clear and _is_sound(oval, n):
            return True
    return False


@njit(cache=True, nogil=True)
def _is_sound(outline: Array, n: int) -> bool:
    """Whether an oval of n corners is as thick as a vein has to be, its edges as long and its corners as
    blunt (`veins.simple`)."""
    area, around = 0.0, 0.0
    for k in range(n):
        before, after = outline[k - 1 if k else n - 1], outline[k + 1 if k + 1 < n else 0]
        x, y = outline[k, 0], outline[k, 1]
        ahead_x, ahead_y, back_x, back_y = after[0] - x, after[1] - y, before[0] - x, before[1] - y
        edge = math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y)
        along, across = ahead_x * back_x + ahead_y * back_y, ahead_x * back_y - ahead_y * back_x
        if edge < MIN_EDGE or abs(across) < _SHARPEST * along:
            return False
        area += x * after[1] - y * after[0]
        around += edge
    return bool(area >= MIN_GAP * around)  # twice the area over the outline


@njit(cache=True, nogil=True)
def _draw_oval(row: State, a: float, b: float, oval: Array) -> int:
    """8 to 10 vertices around the origin, semi-axes about a and b m, dented and tilted a little."""
    n: int = integers(row, np.int64(8), np.int64(MOST_CORNERS))
    for k in range(n):
        oval[k, 0] = (uniform(row, -0.25, 0.25) + k) * (math.tau / n)
    for k in range(n):
        radius, angle = uniform(row, 0.85, 1.0), oval[k, 0]
        oval[k, 0], oval[k, 1] = a * radius * math.cos(angle), b * radius * math.sin(angle)
    tilt = uniform(row, -0.35, 0.35)
    c, s = math.cos(tilt), math.sin(tilt)
    for k in range(n):
        x, y = oval[k, 0], oval[k, 1]
        oval[k, 0], oval[k, 1] = c * x - s * y, s * x + c * y
    return n


@njit(cache=True, nogil=True)
def _bounds(outline: Array, n: int) -> tuple[float, float, float, float]:
    """Left, right, low, high."""
    left, low = outline[0, 0], outline[0, 1]
    right, high = left, low
    for k in range(1, n):
        x, y = outline[k, 0], outline[k, 1]
        left, right, low, high = min(left, x), max(right, x), min(low, y), max(high, y)
    return left, right, low, high


@njit(cache=True, nogil=True)
def _rounded(value: float) -> float:
    """Value to 6 decimals, as Python's `round` has it: the nearest such number, of two the even one."""
    scaled = value * _DIGITS
    whole = np.rint(scaled)
    if abs(scaled - whole) == 0.5:
        # The product may have been rounded to the middle between two: its error, after Veltkamp and Dekker,
        # says on which side the value lies. _DIGITS has less than 27 bits, so it need not be split.
        spread = value * 134217729.0
        upper = spread - (spread - value)
        error = (upper * _DIGITS - scaled) + (value - upper) * _DIGITS
        if error != 0.0:
            whole = math.floor(scaled) if error < 0.0 else math.ceil(scaled)
    return float(whole / _DIGITS)


@njit(cache=True, nogil=True)
def _boxes_within_gap(a: Array, b: Array) -> bool:
    """Whether two boxes (left, right, low, high) are as close as veins must not be."""
    if a[_LEFT] - b[_RIGHT] > _WIDE or b[_LEFT] - a[_RIGHT] > _WIDE:
        return False
    if a[_LOW] - b[_HIGH] > _WIDE or b[_LOW] - a[_HIGH] > _WIDE:
        return False
    width = max(a[_RIGHT], b[_RIGHT]) - min(a[_LEFT], b[_LEFT])
    height = max(a[_HIGH], b[_HIGH]) - min(a[_LOW], b[_LOW])
    dx = max(0.0, width - (a[_RIGHT] - a[_LEFT]) - (b[_RIGHT] - b[_LEFT]))
    dy = max(0.0, height - (a[_HIGH] - a[_LOW]) - (b[_HIGH] - b[_LOW]))
    return math.sqrt(dx * dx + dy * dy) <= _GAP


@njit(cache=True, nogil=True)
def _within_gap(p: Array, n: int, p_box: Array, q: Array, m: int, q_box: Array) -> bool:
    """Whether the polygons p (n vertices) and q (m) are as close as veins must not be; they may overlap.

    Vertices lie on a lattice of 1 um, so that distances of just 2 MIN_GAP do occur, which rounding decides.
    Here it decides as in GEOS, with which scenes were drawn at first, so that seeds keep their scenes.
    """
    for i in range(n):
        ax, ay = p[i, 0], p[i, 1]
        after = i + 1 if i + 1 < n else 0
        bx, by = p[after, 0], p[after, 1]
        left, right = min(ax, bx) - _WIDE, max(ax, bx) + _WIDE
        low, high = min(ay, by) - _WIDE, max(ay, by) + _WIDE
        if left > q_box[_RIGHT] or right < q_box[_LEFT] or low > q_box[_HIGH] or high < q_box[_LOW]:
            continue
        cx, cy = q[m - 1, 0], q[m - 1, 1]
        for j in range(m):
            dx, dy = q[j, 0], q[j, 1]
            if max(cx, dx) >= left and min(cx, dx) <= right and max(cy, dy) >= low and min(cy, dy) <= high:
                if _vertex_within_gap(ax, ay, cx, cy, dx, dy) or _vertex_within_gap(cx, cy, ax, ay, bx, by):
                    return True
                if _cross(ax, ay, bx, by, cx, cy, dx, dy):
                    return True
            cx, cy = dx, dy
    # No edges meet: one is inside the other, or they are apart.
    return bool(_is_inside(p[0, 0], p[0, 1], q, m, q_box) or _is_inside(q[0, 0], q[0, 1], p, n, p_box))


@njit(cache=True, nogil=True)
def _vertex_within_gap(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether a vertex is as close to the edge from a to b as veins must not be."""
    ex, ey, ux, uy = bx - ax, by - ay, ax - x, ay - y
    square, along = ex * ex + ey * ey, -(ux * ex + uy * ey)
    if along <= 0.0:
        return math.sqrt(ux * ux + uy * uy) <= _GAP
    if along >= square:
        vx, vy = bx - x, by - y
        return math.sqrt(vx * vx + vy * vy) <= _GAP
    across = uy * ex - ux * ey
    if across * across > _WIDE * _WIDE * square:
        return False  # without the division
    return abs(across / square) * math.sqrt(square) <= _GAP


@njit(cache=True, nogil=True)
def _cross(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> bool:
    """Whether the edges from a to b and from c to d cross; where rounding decides they are close anyway."""
    ex, ey, fx, fy = bx - ax, by - ay, dx - cx, dy - cy
    c_side, d_side = ex * (cy - ay) - ey * (cx - ax), ex * (dy - ay) - ey * (dx - ax)
    a_side, b_side = fx * (ay - cy) - fy * (ax - cx), fx * (by - cy) - fy * (bx - cx)
    return (c_side > 0.0) != (d_side > 0.0) and (a_side > 0.0) != (b_side > 0.0)


@njit(cache=True, nogil=True)
def _is_inside(x: float, y: float, outline: Array, n: int, box: Array) -> bool:
    """Whether a point well away from the outline's edges lies inside."""
    if x < box[_LEFT] or x > box[_RIGHT] or y < box[_LOW] or y > box[_HIGH]:
        return False
    inside = False
    ax, ay = outline[n - 1, 0], outline[n - 1, 1]
    for k in range(n):
        bx, by = outline[k, 0], outline[k, 1]
        if (ay > y) != (by > y):
            left_of_edge = (x - ax) * (by - ay) < (bx - ax) * (y - ay)
            if left_of_edge == (by > ay):
                inside = not inside
        ax, ay = bx, by
    return inside
