"""Compiled drawing on arrays of pixels: shaded triangles, and anti-aliased strokes and convex polygons.

SDL's own drawing has no shaded triangles and no anti-aliased line of a given width. Coordinates are pixels,
x to the right and y down; the pixel in row i and column j covers [j, j + 1] x [i, i + 1]. Whatever lies
outside the image is clipped, and what is not finite is left out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from retract_env.palette import Bytes, Colour

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Floats32 = NDArray[np.float32]

EDGE = 1e-6
"""px by which triangles overlap, lest rounding leave a gap between neighbours."""


class Canvas:
    """An image to draw on."""

    def __init__(self, image: Bytes):
        """image: (h, w, 3), contiguous; drawn on in place."""
        self.image = image
        self._coverage: Floats32 = np.zeros(image.shape[:2], dtype=np.float32)

    def triangles(self, points: Array, faces: Ints, values: Array, colours: Bytes) -> None:
        """Shade faces (m, 3) of points (v, 2) by values (v,) in [0, 1], linear in between, from a table."""
        fill_triangles(self.image, points, faces, values, colours)

    def stroke(self, points: ArrayLike, colour: Colour, width: float, opacity: float = 1.0) -> None:
        """Line through points (n, 2), width in px; it breaks at points that are not finite."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        _stroke(self.image, self._coverage, points, width, *colour, opacity)

    def polygon(self, points: ArrayLike, colour: Colour, opacity: float = 1.0) -> None:
        """Convex polygon (n, 2), in either order."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        _convex(self.image, points, *colour, opacity)

    def box(self, left: float, top: float, right: float, bottom: float, colour: Colour) -> None:
        """Upright rectangle, its sides rounded to whole pixels."""
        rows = slice(max(round(top), 0), max(round(bottom), 0))
        self.image[rows, max(round(left), 0) : max(round(right), 0)] = colour


@njit(cache=True, nogil=True, error_model="numpy")
def _first(low: float) -> int:
    """First row or column, from 0, whose centre is not before `low`."""
    return int(math.ceil(min(max(low - 0.5, 0.0), 1e6)))


@njit(cache=True, nogil=True, error_model="numpy")
def _last(high: float, count: int) -> int:
    """Last row or column of `count` whose centre is not beyond `high`; -1 for none."""
    return int(math.floor(max(min(high - 0.5, count - 1.0), -1.0)))


@njit(cache=True, nogil=True, error_model="numpy")
def fill_triangles(image: Bytes, points: Array, faces: Ints, values: Array, colours: Bytes) -> None:
    """See Canvas.triangles. A row's pixels lie where all three edges have it on their inner side."""
    height, width = image.shape[0], image.shape[1]
    size = len(colours)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = points[a]
        bx, by = points[b]
        cx, cy = points[c]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not 1e-12 < abs(area) < 1e18:  # degenerate or not finite
            continue
        rise_x = ((values[b] - values[a]) * (cy - ay) - (values[c] - values[a]) * (by - ay)) / area
        rise_y = ((values[c] - values[a]) * (bx - ax) - (values[b] - values[a]) * (cx - ax)) / area
        side = 1.0 if area > 0 else -1.0
        low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
        for row in range(_first(min(ay, by, cy)), _last(max(ay, by, cy), height) + 1):
            y = row + 0.5
            low, high = low_x, high_x
            for edge in range(3):
                if edge == 0:
                    px, py, qx, qy = ax, ay, bx, by
                elif edge == 1:
                    px, py, qx, qy = bx, by, cx, cy
                else:
                    px, py, qx, qy = cx, cy, ax, ay
                slope = -(qy - py) * side
                start = ((qx - px) * (y - py) + (qy - py) * px) * side
                if slope > 0:
                    low = max(low, -start / slope)
                elif slope < 0:
                    high = min(high, -start / slope)
            for column in range(_first(low - EDGE), _last(high + EDGE, width) + 1):
                value = values[a] + rise_x * (column + 0.5 - ax) + rise_y * (y - ay)
                index = int(min(max(value * size, 0.0), size - 1.0)) if value == value else 0
                image[row, column, 0] = colours[index, 0]
                image[row, column, 1] = colours[index, 1]
                image[row, column, 2] = colours[index, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _blend(pixel: Bytes, red: int, green: int, blue: int, share: float) -> None:
    pixel[0] = int(pixel[0] + (red - pixel[0]) * share + 0.5)
    pixel[1] = int(pixel[1] + (green - pixel[1]) * share + 0.5)
    pixel[2] = int(pixel[2] + (blue - pixel[2]) * share + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _stroke(
    image: Bytes, coverage: Floats32, points: Array, width: float, red: int, green: int, blue: int, opacity: float
) -> None:
    """See Canvas.stroke. A pixel counts once, by the nearest segment: the first pass collects, the second
    paints and leaves `coverage` (h, w) at zero again."""
    rows, columns = image.shape[0], image.shape[1]
    reach = width / 2 + 0.5
    for painting in range(2):
        for i in range(len(points) - 1):
            ax, ay = points[i]
            dx, dy = points[i + 1, 0] - ax, points[i + 1, 1] - ay
            length = math.sqrt(dx * dx + dy * dy)
            if not length < 1e9 or not abs(ax) + abs(ay) < 1e9:
                continue
            ux, uy = (dx / length, dy / length) if length > 0 else (1.0, 0.0)
            left, right = min(ax, ax + dx) - reach, max(ax, ax + dx) + reach
            for row in range(_first(min(ay, ay + dy) - reach), _last(max(ay, ay + dy) + reach, rows) + 1):
                y = row + 0.5 - ay
                low, high = left, right
                if abs(uy) > 1e-9:
                    middle, half = ax + y * ux / uy, reach / abs(uy)
                    low, high = max(low, middle - half), min(high, middle + half)
                for column in range(_first(low), _last(high, columns) + 1):
                    x = column + 0.5 - ax
                    if painting:
                        share = coverage[row, column]
                        if share > 0.0:
                            _blend(image[row, column], red, green, blue, share * opacity)
                            coverage[row, column] = 0.0
                    else:
                        along = min(max(x * ux + y * uy, 0.0), length)
                        away = math.sqrt((x - along * ux) ** 2 + (y - along * uy) ** 2)
                        share = min(reach - away, 1.0, width)
                        coverage[row, column] = max(coverage[row, column], share)


@njit(cache=True, nogil=True, error_model="numpy")
def _convex(image: Bytes, points: Array, red: int, green: int, blue: int, opacity: float) -> None:
    """See Canvas.polygon. Coverage from the distance to the nearest side, half a pixel on either side."""
    count = len(points)
    area = 0.0
    for i in range(count):
        j = (i + 1) % count
        area += points[i, 0] * points[j, 1] - points[j, 0] * points[i, 1]
    if not 1e-12 < abs(area) < 1e18:
        return
    side = 1.0 if area > 0 else -1.0
    left, right = points[:, 0].min() - 0.5, points[:, 0].max() + 0.5
    top, bottom = points[:, 1].min() - 0.5, points[:, 1].max() + 0.5
    for row in range(_first(top), _last(bottom, image.shape[0]) + 1):
        for column in range(_first(left), _last(right, image.shape[1]) + 1):
            x, y = column + 0.5, row + 0.5
            inside = 1.0
            for i in range(count):
                j = (i + 1) % count
                dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                length = math.sqrt(dx * dx + dy * dy)
                if length > 0:
                    away = side * (dx * (y - points[i, 1]) - dy * (x - points[i, 0])) / length
                    inside = min(inside, away + 0.5)
            if inside > 0.0:
                _blend(image[row, column], red, green, blue, inside * opacity)
