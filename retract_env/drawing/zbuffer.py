"""Compiled drawing in space: what is nearer hides what is farther, pixel by pixel.

Points are (x, y, w): pixels, as `raster` counts them, and one over the distance ahead of the eye, which is
linear over a flat face. Of faces with a corner that is not finite nothing is drawn.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.drawing.palette import Bytes
from retract_env.drawing.raster import EDGE, first_centre, inner_span, last_centre, lay_edges

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Floats32 = NDArray[np.float32]

FLOOR, SHADED, SOLID, INNER = 0, 1, 2, 3
"""What a pixel shows: the bed, the bed in a shadow, a solid, or what lies inside another solid and shines
through."""


@njit(cache=True, nogil=True, error_model="numpy")
def fill_faces(
    image: Bytes,
    depth: Floats32,
    kind: Bytes,
    points: Array,
    faces: Ints,
    values: Array,
    light: Array,
    colours: Bytes,
    own: int,
    through: float,
    dim: float,
) -> None:
    """Draw faces (m, 3) of points (v, 3) where nothing nearer is.

    image (h, w, 3), depth (h, w), the greatest w so far, and kind (h, w) are drawn on. values (v,) in [0, 1]
    choose from a table of colours (k, 3), light (v,) multiplies them up to 1 and whitens beyond; both linear
    in between. own: the kind of what is drawn. through: how much of what is INNER shows through where it is
    just behind, less by e with every `dim` m.
    """
    height, width = depth.shape
    size = len(colours)
    at, per_row = np.empty(3), np.empty(3)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, aw = points[a, 0], points[a, 1], points[a, 2]
        bx, by, bw = points[b, 0], points[b, 1], points[b, 2]
        cx, cy, cw = points[c, 0], points[c, 1], points[c, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not 1e-12 < abs(area) < 1e18:  # degenerate or not finite
            continue
        first, last = first_centre(min(ay, by, cy)), last_centre(max(ay, by, cy), height)
        low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
        if first > last or high_x < 0.0 or low_x > width:
            continue
        rises = (by - ay, cy - by, ay - cy)
        lay_edges(at, per_row, rises, (bx - ax, cx - bx, ax - cx), ((ax, ay), (bx, by), (cx, cy)))
        u1, u2, v1, v2 = (cy - ay) / area, (by - ay) / area, (bx - ax) / area, (cx - ax) / area
        va, la = values[a] * size, light[a]
        dv1, dv2 = values[b] * size - va, values[c] * size - va
        dl1, dl2, dw1, dw2 = light[b] - la, light[c] - la, bw - aw, cw - aw
        v_across, v_down = dv1 * u1 - dv2 * u2, dv2 * v1 - dv1 * v2
        l_across, l_down = dl1 * u1 - dl2 * u2, dl2 * v1 - dl1 * v2
        w_across, w_down = dw1 * u1 - dw2 * u2, dw2 * v1 - dw1 * v2
        for row in range(first, last + 1):
            y = row + 0.5
            low, high = inner_span(low_x, high_x, y, area, rises, at, per_row)
            y -= ay
            for column in range(first_centre(low - EDGE), last_centre(high + EDGE, width) + 1):
                x = column + 0.5 - ax
                w = aw + w_across * x + w_down * y
                before = depth[row, column]
                if not w > before:
                    continue
                value = va + v_across * x + v_down * y
                index = int(min(max(value, 0.0), size - 1.0)) if value == value else 0
                lit = la + l_across * x + l_down * y
                shade, gloss = min(lit, 1.0), 255.0 * max(lit - 1.0, 0.0)
                red = colours[index, 0] * shade + gloss
                green = colours[index, 1] * shade + gloss
                blue = colours[index, 2] * shade + gloss
                if through > 0.0 and kind[row, column] == INNER:
                    share = through * math.exp((1.0 / w - 1.0 / before) / dim)
                    red += (image[row, column, 0] - red) * share
                    green += (image[row, column, 1] - green) * share
                    blue += (image[row, column, 2] - blue) * share
                depth[row, column] = w
                kind[row, column] = own
                image[row, column, 0] = int(min(red, 255.0))
                image[row, column, 1] = int(min(green, 255.0))
                image[row, column, 2] = int(min(blue, 255.0))


@njit(cache=True, nogil=True, error_model="numpy")
def draw_lines(
    image: Bytes,
    depth: Floats32,
    points: Array,
    width: float,
    red: int,
    green: int,
    blue: int,
    nearer: float,
    faint: float,
) -> None:
    """Line through points (n, 3), `width` px wide, with gaps at points that are not finite.

    It is drawn as if it were nearer by this part of its distance, so that lines on a face are seen, and does
    not hide anything itself. faint: how much of it is seen where something hides it; for a single segment.
    """
    rows, columns = depth.shape
    reach = width / 2
    for i in range(len(points) - 1):
        ax, ay, aw = points[i]
        dx, dy, dw = points[i + 1, 0] - ax, points[i + 1, 1] - ay, points[i + 1, 2] - aw
        length = math.sqrt(dx * dx + dy * dy)
        if not length < 1e9 or not abs(ax) + abs(ay) < 1e9:
            continue
        ux, uy = (dx / length, dy / length) if length > 0 else (1.0, 0.0)
        slope = dw / length if length > 0 else 0.0
        left, right = min(ax, ax + dx) - reach, max(ax, ax + dx) + reach
        first, last = first_centre(min(ay, ay + dy) - reach), last_centre(max(ay, ay + dy) + reach, rows)
        for row in range(first, last + 1):
            y = row + 0.5 - ay
            low, high = left, right
            if abs(uy) > 1e-9:
                middle, half = ax + y * ux / uy, reach / abs(uy)
                low, high = max(low, middle - half), min(high, middle + half)
            for column in range(first_centre(low), last_centre(high, columns) + 1):
                x = column + 0.5 - ax
                along = min(max(x * ux + y * uy, 0.0), length)
                if (x - along * ux) ** 2 + (y - along * uy) ** 2 > reach * reach:
                    continue
                seen = (aw + along * slope) * (1.0 + nearer) >= depth[row, column]
                if seen:
                    image[row, column, 0], image[row, column, 1], image[row, column, 2] = red, green, blue
                elif faint > 0.0:
                    pixel = image[row, column]
                    pixel[0] = int(pixel[0] + (red - pixel[0]) * faint)
                    pixel[1] = int(pixel[1] + (green - pixel[1]) * faint)
                    pixel[2] = int(pixel[2] + (blue - pixel[2]) * faint)


@njit(cache=True, nogil=True, error_model="numpy")
def cast_shadow(image: Bytes, kind: Bytes, points: Array, faces: Ints, share: float) -> None:
    """Darken the bed where faces (m, 3) of points (v, 3) lie on the picture, to this share of its light.

    A pixel is darkened once, however many faces lie over it.
    """
    height, width = kind.shape
    at, per_row = np.empty(3), np.empty(3)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by = points[b, 0], points[b, 1]
        cx, cy = points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not 1e-12 < abs(area) < 1e18:
            continue
        rises = (by - ay, cy - by, ay - cy)
        lay_edges(at, per_row, rises, (bx - ax, cx - bx, ax - cx), ((ax, ay), (bx, by), (cx, cy)))
        for row in range(first_centre(min(ay, by, cy)), last_centre(max(ay, by, cy), height) + 1):
            y = row + 0.5
            low, high = inner_span(min(ax, bx, cx), max(ax, bx, cx), y, area, rises, at, per_row)
            for column in range(first_centre(low - EDGE), last_centre(high + EDGE, width) + 1):
                if kind[row, column] == FLOOR:
                    kind[row, column] = SHADED
                    for k in range(3):
                        image[row, column, k] = int(image[row, column, k] * share)


@njit(cache=True, nogil=True, error_model="numpy")
def halved(image: Bytes, out: Bytes) -> None:
    """Means over 2 x 2 pixels: (2 h, 2 w, 3) into out (h, w, 3). As `raster.shrunk`, three times as fast."""
    for row in range(out.shape[0]):
        upper, lower = image[2 * row].reshape(-1), image[2 * row + 1].reshape(-1)
        line = out[row]
        for column in range(out.shape[1]):
            k = 6 * column
            for j in range(3):
                total = int(upper[k + j]) + int(upper[k + 3 + j]) + int(lower[k + j]) + int(lower[k + 3 + j])
                line[column, j] = (total + 2) >> 2
