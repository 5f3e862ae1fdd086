"""Where words and numbers stand on a picture, so that none lies on another, on a marker or on a curve.

The axes have their final place and limits by then: a figure with a layout is laid out first.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.text import Annotation
from matplotlib.textpath import TextPath
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.palette import INK

Array = NDArray[np.float64]

APART = 1.5
"""Points that are kept free around a number."""
RINGS = (1.0, 1.6, 2.3, 3.1)
"""Distances of a number from its point that are tried, over the least one."""
WAYS = ((0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1), (-1, 0), (1, 0))
"""Directions that are tried, the best first: below, above, then aside."""

LEADER: Any = {"arrowstyle": "-", "linewidth": 0.5, "color": "0.6", "shrinkA": 0, "shrinkB": 2}
"""Line from a number to its place."""


@cache
def text_size(text: str, size: float, weight: str = "normal") -> tuple[float, float]:
    """Width and height in points of a line of text; size in points."""
    drawn = TextPath((0, 0), text, prop=FontProperties(size=size, weight=weight)).get_extents()
    return float(drawn.width), 0.75 * size


def in_points(axes: Axes, places: ArrayLike) -> Array:
    """(n, 2) points, 1/72 inch, from the figure's corner, of places (n, 2) in the axes' units."""
    figure = axes.get_figure()
    assert figure is not None
    return np.asarray(axes.transData.transform(np.asarray(places, np.float64)), np.float64) * 72 / figure.dpi


def sampled(line: Array, step: float = 1.0) -> Array:
    """(k, 2) places along a line (n, 2), no more than `step` apart; gaps at what is not finite."""
    parts = [line[:0]]
    for a, b in pairwise(line):
        if np.isfinite(a).all() and np.isfinite(b).all():
            count = max(int(np.ceil(np.hypot(*(b - a)) / step)), 1)
            parts.append(a + np.linspace(0, 1, count + 1)[:, None] * (b - a))
    return np.concatenate(parts)


def gap(places: Array, centre: ArrayLike, size: tuple[float, float]) -> float:
    """Least distance of places (k, 2) from a box; negative, by how deep, for those inside."""
    off = np.abs(places - np.asarray(centre)) - np.array(size) / 2
    if not len(off):
        return np.inf
    outside = np.hypot(*np.maximum(off, 0.0).T)
    return float(np.where(outside > 0, outside, np.max(off, axis=1)).min())


def overlap(one: Sequence[float], other: Sequence[float]) -> float:
    """Area that two boxes (x, y of the middle, width, height) share."""
    wide, tall = (
        min(one[k] + one[2 + k] / 2, other[k] + other[2 + k] / 2)
        - max(one[k] - one[2 + k] / 2, other[k] - other[2 + k] / 2)
        for k in (0, 1)
    )
    return max(wide, 0.0) * max(tall, 0.0)


class Number(NamedTuple):
    """A number to be written beside its place."""

    place: tuple[float, float]
    """in the axes' units"""
    text: str
    colour: str = INK
    size: float = 8.5
    """points, of the letters"""
    marker: float = 5.0
    """points, of the mark at the place"""
    weight: str = "normal"


def write_numbers(axes: Axes, numbers: Sequence[Number], curve: Array, **look: Any) -> list[Annotation]:
    """Write each number beside its place, the first ones first; those without text are only kept clear of.

    curve: (n, 2), which numbers stay off where they can. One that has to stand farther off has a thin line to
    its place. look: of all.
    """
    middles, line = in_points(axes, [n.place for n in numbers]), sampled(in_points(axes, curve))
    taken = [(x, y, n.marker + APART, n.marker + APART) for (x, y), n in zip(middles, numbers, strict=True)]
    corners = [(axes.get_xlim()[k], axes.get_ylim()[k]) for k in (0, 1)]
    low, high = in_points(axes, corners)
    written = []
    for (x, y), number in zip(middles, numbers, strict=True):
        if not number.text:
            continue
        wide, tall = text_size(number.text, number.size, number.weight)
        reach = number.marker / 2 + 2 * APART
        tried = []
        for ring in RINGS:
            for nth, (across, up) in enumerate(WAYS):
                dx, dy = across * ring * (reach + wide / 2), up * ring * (reach + tall / 2)
                box = (x + dx, y + dy, wide + APART, tall + APART)
                on_others = sum(overlap(box, other) for other in taken)
                on_curve = max(0.0, 1.0 - gap(line, box[:2], (wide, tall)))
                out = not (low[0] <= box[0] <= high[0] and low[1] <= box[1] <= high[1])
                tried.append((100 * out + 50 * on_others + 3 * on_curve + 2 * ring + 0.2 * nth, box, dx, dy))
        _, box, dx, dy = min(tried)
        taken.append(box)
        far = np.hypot(dx, dy) > 2.2 * (number.marker / 2 + tall)
        written.append(
            axes.annotate(
                number.text,
                number.place,
                xytext=(dx, dy),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=number.size,
                weight=number.weight,
                color=number.colour,
                arrowprops=LEADER if far else None,
                **look,
            )
        )
    return written


def name_level(axes: Axes, curve: Array, level: float, text: str, size: float, **look: Any) -> Annotation:
    """Write the name of a horizontal line where the curve (n, 2) stays farthest from it: at its left or right
    end or between, above the line or below."""
    line = sampled(in_points(axes, curve))
    left, right = axes.get_xlim()
    wide, tall = text_size(text, size)
    ends = in_points(axes, [(left, level), (right, level)])
    low, high = in_points(axes, [(left, axes.get_ylim()[0]), (left, axes.get_ylim()[1])])[:, 1]
    tried = []
    for nth, share in enumerate((0.02, 0.98, 0.5, 0.25, 0.75)):
        for side in (1, -1):
            begin = ends[0, 0] + share * (ends[1, 0] - ends[0, 0] - wide)
            middle = begin + wide / 2, ends[0, 1] + side * (tall / 2 + 3)
            out = not low <= middle[1] - tall / 2 <= middle[1] + tall / 2 <= high + 4
            room = min(gap(line, middle, (wide, tall)), 6.0)  # beyond, it makes no difference
            tried.append((-room + 20 * out + 0.3 * nth + 0.1 * (side < 0), middle))
    _, (x, y) = min(tried)
    dx, dy = x - ends[0, 0], y - ends[0, 1]
    return axes.annotate(
        text, (left, level), xytext=(dx, dy), textcoords="offset points", ha="center", va="center",
        fontsize=size, **look,
    )  # fmt: skip
