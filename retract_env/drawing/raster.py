"""Compiled drawing on arrays of pixels: shaded triangles, and anti-aliased strokes and convex polygons.

SDL's own drawing has no shaded triangles and no anti-aliased line of a given width. Coordinates are pixels,
x to the right and y down; the pixel in row i and column j covers [j, j + 1] x [i, i + 1]. Whatever lies
outside the image is clipped, and what is not finite is left out.
"""

from __future__ import annotations

import math

import numpy as np
import pygame
from numba import njit
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.palette import Bytes, Colour

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Floats32 = NDArray[np.float32]
Three = tuple[float, float, float]
Corners = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

EDGE = 1e-6
"""px by which triangles overlap, so that rounding leaves no gap between neighbours."""


class Canvas:
    """An image to draw on."""

    def __init__(self, image: Bytes):
        """image: (h, w, 3), contiguous; drawn on in place."""
        self.image = image
        self.surface = pygame.image.frombuffer(image.data, image.shape[1::-1], "RGB")
        """The same pixels for pygame to draw on."""
        self._coverage: Floats32 = np.zeros(image.shape[:2], dtype=np.float32)

    def triangles(self, points: Array, faces: Ints, values: Array, colours: Bytes) -> None:
        """Shade faces (m, 3) of points (v, 2) by values (v,) in [0, 1], linear in between, from a table."""
        fill_triangles(self.image, points, faces, values, colours)

    def stroke(self, points: ArrayLike, colour: Colour, width: float) -> None:
        """Line through points (n, 2), width in px; it breaks at points that are not finite."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        _stroke(self.image, self._coverage, points, width, *colour)

    def polygon(self, points: ArrayLike, colour: Colour) -> None:
        """Convex polygon (n, 2), in either order."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        _convex(self.image, points, *colour)

    def region(self, points: Array, colour: Colour) -> None:
        """Any polygon (n, 2); its border is not smooth."""
        far = 4.0 * max(self.image.shape)  # SDL counts pixels in C's int
        if len(points) > 2 and np.isfinite(points).all():
            pygame.draw.polygon(self.surface, colour, np.clip(points, -far, far).tolist())

    def box(self, left: float, top: float, right: float, bottom: float, colour: Colour) -> None:
        """Upright rectangle, its sides rounded to whole pixels."""
        rows = slice(max(round(top), 0), max(round(bottom), 0))
        self.image[rows, max(round(left), 0) : max(round(right), 0)] = colour


@njit(cache=True, nogil=True, error_model="numpy")
def first_centre(low: float) -> int:
    """First row or column, from 0, whose centre is not before `low`."""
    return math.ceil(min(max(low - 0.5, 0.0), 1e6))


@njit(cache=True, nogil=True, error_model="numpy")
def last_centre(high: float, count: int) -> int:
    """Last row or column of `count` whose centre is not beyond `high`; -1 for none."""
    return math.floor(max(min(high - 0.5, count - 1.0), -1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def lay_edges(at: Array, per_row: Array, rises: Three, runs: Three, starts: Corners) -> None:
    """Where each edge of a triangle crosses y = 0, and how that moves from row to row: into at, per_row (3,).

    rises, runs: how far each edge goes down and to the right; starts: the corners they begin at.
    """
    for edge in range(3):
        if rises[edge] != 0.0:
            per_row[edge] = runs[edge] / rises[edge]
            at[edge] = starts[edge][0] - starts[edge][1] * per_row[edge]


@njit(cache=True, nogil=True, error_model="numpy")
def inner_span(
    low: float, high: float, y: float, area: float, rises: Three, at: Array, per_row: Array
) -> tuple[float, float]:
    """From where to where on the line y a triangle reaches, between low and high."""
    for edge in range(3):
        if rises[edge] * area < 0.0:  # the inner side is to the right
            low = max(low, at[edge] + y * per_row[edge])
        elif rises[edge] != 0.0:
            high = min(high, at[edge] + y * per_row[edge])
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def fill_triangles(image: Bytes, points: Array, faces: Ints, values: Array, colours: Bytes) -> None:
    """See Canvas.triangles. A row's pixels lie where all three edges have it on their inner side."""
    height, width = image.shape[0], image.shape[1]
    size = len(colours)
    at, per_row = np.empty(3), np.empty(3)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by = points[b, 0], points[b, 1]
        cx, cy = points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not 1e-12 < abs(area) < 1e18:  # degenerate or not finite
            continue
        first, last = first_centre(min(ay, by, cy)), last_centre(max(ay, by, cy), height)
        low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
        if first > last or high_x < 0.0 or low_x > width:
            continue
        rises = (by - ay, cy - by, ay - cy)
        lay_edges(at, per_row, rises, (bx - ax, cx - bx, ax - cx), ((ax, ay), (bx, by), (cx, cy)))
        across = ((values[b] - values[a]) * (cy - ay) - (values[c] - values[a]) * (by - ay)) / area * size
        down = ((values[c] - values[a]) * (bx - ax) - (values[b] - values[a]) * (cx - ax)) / area * size
        for row in range(first, last + 1):
            y = row + 0.5
            low, high = inner_span(low_x, high_x, y, area, rises, at, per_row)
            begin = values[a] * size + down * (y - ay) + across * (0.5 - ax)
            for column in range(first_centre(low - EDGE), last_centre(high + EDGE, width) + 1):
                value = begin + across * column
                index = int(min(max(value, 0.0), size - 1.0)) if value == value else 0
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
    image: Bytes, coverage: Floats32, points: Array, width: float, red: int, green: int, blue: int
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
            first, last = first_centre(min(ay, ay + dy) - reach), last_centre(max(ay, ay + dy) + reach, rows)
            for row in range(first, last + 1):
                y = row + 0.5 - ay
                low, high = left, right
                if abs(uy) > 1e-9:
                    middle, half = ax + y * ux / uy, reach / abs(uy)
                    low, high = max(low, middle - half), min(high, middle + half)
                for column in range(first_centre(low), last_centre(high, columns) + 1):
                    x = column + 0.5 - ax
                    if painting:
                        share = coverage[row, column]
                        if share > 0.0:
                            _blend(image[row, column], red, green, blue, share)
                            coverage[row, column] = 0.0
                    else:
                        along = min(max(x * ux + y * uy, 0.0), length)
                        away = math.sqrt((x - along * ux) ** 2 + (y - along * uy) ** 2)
                        share = min(reach - away, 1.0, width)
                        coverage[row, column] = max(coverage[row, column], share)


@njit(cache=True, nogil=True, error_model="numpy")
def _convex(image: Bytes, points: Array, red: int, green: int, blue: int) -> None:
    """See Canvas.polygon. Coverage from the distance to the nearest side, half a pixel on either side."""
    count = len(points)
    sides = np.empty((count, 3))  # distance from a side's line: sides @ (x, y, 1)
    area, found = 0.0, 0
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for i in range(count):
        ax, ay = points[i, 0], points[i, 1]
        bx, by = points[(i + 1) % count, 0], points[(i + 1) % count, 1]
        left, right, top, bottom = min(left, ax), max(right, ax), min(top, ay), max(bottom, ay)
        area += ax * by - bx * ay
        length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        if length > 0.0:
            sides[found, 0] = (ay - by) / length
            sides[found, 1] = (bx - ax) / length
            sides[found, 2] = (ax * by - bx * ay) / length
            found += 1
    if not 1e-12 < abs(area) < 1e18:
        return
    inwards = 1.0 if area > 0.0 else -1.0
    for row in range(first_centre(top - 0.5), last_centre(bottom + 0.5, image.shape[0]) + 1):
        for column in range(first_centre(left - 0.5), last_centre(right + 0.5, image.shape[1]) + 1):
            inside = 1.0
            for i in range(found):
                away = sides[i, 0] * (column + 0.5) + sides[i, 1] * (row + 0.5) + sides[i, 2]
                inside = min(inside, inwards * away + 0.5)
            if inside > 0.0:
                _blend(image[row, column], red, green, blue, inside)


@njit(cache=True, nogil=True, error_model="numpy")
def shrunk(image: Bytes, times: int) -> Bytes:
    """Means over times x times pixels: (times h, times w, 3) to (h, w, 3)."""
    height, width = image.shape[0] // times, image.shape[1] // times
    rows = image.reshape(image.shape[0], -1)
    small = np.empty((height, width, 3), dtype=np.uint8)
    sums = np.empty(rows.shape[1], dtype=np.int32)
    share = 1.0 / (times * times)
    for row in range(height):
        for j in range(len(sums)):
            sums[j] = 0
        for i in range(row * times, (row + 1) * times):
            for j in range(len(sums)):
                sums[j] += rows[i, j]
        for column in range(width):
            for k in range(3):
                total = 0
                for j in range(times):
                    total += sums[(column * times + j) * 3 + k]
                small[row, column, k] = int(total * share + 0.5)
    return small
