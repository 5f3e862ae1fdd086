"""Words and numbers lie on nothing else."""

from __future__ import annotations

import itertools

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from baselines.pictures.drawing import STYLE
from baselines.pictures.labels import (
    Number,
    gap,
    in_points,
    name_level,
    overlap,
    sampled,
    text_size,
    write_numbers,
)


def panel(wide: float = 9.0, tall: float = 1.5) -> Axes:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(wide, tall + 0.6), dpi=160)
        FigureCanvasAgg(figure)
        return figure.add_axes((0.05, 0.2, 0.9, 0.75))


def box(axes: Axes, drawn: Annotation) -> np.ndarray:
    """(2, 2) points, corners of what is drawn."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    drawn.arrow_patch = None  # only the letters
    extent = drawn.get_window_extent()
    return np.array(extent.get_points()) * 72 / figure.dpi


def share(one: np.ndarray, other: np.ndarray) -> float:
    boxes = [(*b.mean(axis=0), *np.ptp(b, axis=0)) for b in (one, other)]
    return float(overlap(*boxes) / min(b[2] * b[3] for b in boxes))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [3, 11, 15])
def test_numbers_overlap_neither_each_other_nor_the_markers(seed: int, count: int) -> None:
    rng, axes = np.random.default_rng(seed), panel()
    x = np.sort(rng.uniform(-49, -1, count))
    x[1] = x[0] + 0.2  # as near as grasps at both sides of a thin vein
    axes.set_xlim(-52, 4)
    axes.set_ylim(5, 20)
    curve = np.column_stack((np.linspace(-50, 0, 200), 9 + 5 * np.sin(np.linspace(0, 40, 200)) ** 8))
    places = [(a, float(np.interp(a, *curve.T))) for a in x.tolist()]
    texts = [str(k + 1) for k in range(len(places))]
    numbers = [Number(place, text) for place, text in zip(places, texts, strict=True)]
    written = write_numbers(axes, numbers, curve)
    assert [w.get_text() for w in written] == texts  # none is left out
    boxes = [box(axes, w) for w in written]
    assert max(share(a, b) for a, b in itertools.combinations(boxes, 2)) < 0.1
    marks = in_points(axes, places)
    dots = [np.array([m - 2.5, m + 2.5]) for m in marks]
    assert max(share(b, dot) for b in boxes for dot in dots) < 0.15
    left, low = in_points(axes, [(-52, 5)])[0]
    assert all(b[0, 0] > left - 6 and b[0, 1] > low - 6 for b in boxes)


def test_a_lonely_number_stands_below_its_place() -> None:
    axes = panel()
    axes.set_xlim(0, 10)
    axes.set_ylim(0, 10)
    (drawn,) = write_numbers(axes, [Number((5, 5), "7")], np.array([(0, 5), (10, 5)]))
    corners, (x, y) = box(axes, drawn), in_points(axes, [(5, 5)])[0]
    assert corners[:, 0].mean() == pytest.approx(x, abs=1) and corners[1, 1] < y


CURVES = {
    "rises late": lambda t: 0.55 * t**6,
    "rises at once": lambda t: 0.55 * (1 - (1 - t) ** 6),
    "crosses": lambda t: 0.2 + 0.6 * t,
    "falls": lambda t: 0.7 - 0.4 * t,
    "stays": lambda t: 0.25 + 0 * t,
    "comes and goes": lambda t: 0.62 * np.sin(np.pi * t) ** 2,
}


@pytest.mark.parametrize("name", CURVES)
def test_no_curve_crosses_the_limits_name(name: str) -> None:
    axes, t = panel(3.0, 1.3), np.linspace(0, 1, 40)
    curve = np.column_stack((30 * t, CURVES[name](t)))
    axes.set_xlim(0, 31)
    axes.set_ylim(0, 0.8)
    drawn = name_level(axes, curve, 0.5, "limit 0.5", 8.5)
    corners = box(axes, drawn)
    line = sampled(in_points(axes, curve))
    inside = np.all((line > corners[0] + 1.5) & (line < corners[1] - 1.5), axis=1)
    assert not inside.any()
    level = in_points(axes, [(0, 0.5)])[0, 1]
    assert abs(corners.mean(axis=0)[1] - level) < 16
    left, right = in_points(axes, [(0, 0.5), (31, 0.5)])[:, 0]
    assert left - 1 < corners[0, 0] and corners[1, 0] < right + 1


def test_sizes_are_those_of_the_letters() -> None:
    axes = panel()
    for text in ("1", "15", "limit 0.5"):
        drawn = axes.annotate(text, (0.5, 0.5), fontsize=8.5)
        wide, tall = text_size(text, 8.5)
        assert np.ptp(box(axes, drawn), axis=0) == pytest.approx((wide, tall), abs=4.5)


def test_gaps_and_overlaps() -> None:
    places = np.array([(3.0, 0.0), (0.5, 0.0)])
    assert gap(places[:1], (0, 0), (2, 2)) == pytest.approx(2)
    assert gap(places, (0, 0), (2, 2)) == pytest.approx(-0.5)
    assert gap(places[:0], (0, 0), (2, 2)) == np.inf
    assert overlap((0, 0, 2, 2), (1, 1, 2, 2)) == pytest.approx(1)
    assert overlap((0, 0, 2, 2), (5, 0, 2, 2)) == 0
    broken = np.array([(0, 0), (3, 0), (np.nan, np.nan), (9, 9), (9, 9)])
    assert np.isfinite(sampled(broken)).all() and len(sampled(broken)) == 6
