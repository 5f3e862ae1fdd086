"""Pixels of triangles, strokes and polygons against plain geometry."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from retract_env.drawing.raster import Canvas, shrunk
from retract_env.drawing.shapes import Array

BLACK = (0, 0, 0)
RAMP = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)


def white(width: int = 60, height: int = 40) -> Canvas:
    return Canvas(np.full((height, width, 3), 255, dtype=np.uint8))


def ink(canvas: Canvas) -> float:
    """px^2 that black has covered."""
    return float((255.0 - canvas.image[..., 0]).sum() / 255.0)


def turned(points: Array, angle: float, centre: tuple[float, float]) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    found: Array = points @ np.array([[c, s], [-s, c]]) + centre
    return found


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_triangles_cover_every_pixel_centre_inside_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([(5.3, 4.1), (55.7, 7.2), (50.2, 36.6), (8.8, 33.3)])
    a, b = rng.uniform(size=(2, 80, 1))
    inner = (1 - b) * ((1 - a) * corners[0] + a * corners[1]) + b * ((1 - a) * corners[3] + a * corners[2])
    points = np.vstack((corners, inner))
    canvas = white()
    canvas.triangles(points, Delaunay(points).simplices.astype(np.intp), np.zeros(len(points)), RAMP[:1])
    y, x = np.mgrid[:40, :60] + 0.5
    assert np.array_equal(canvas.image[..., 0] == 0, shapely.contains_xy(shapely.Polygon(corners), x, y))


def test_both_orders_of_a_triangle_give_the_same_picture() -> None:
    points = np.array([(3.0, 5.0), (50.0, 8.0), (20.0, 35.0)])
    values = np.array([0.1, 0.5, 0.9])
    pictures = []
    for order in itertools.permutations(range(3)):
        canvas = white()
        canvas.triangles(points, np.array([order], dtype=np.intp), values, RAMP)
        pictures.append(canvas.image.astype(int))
    # rounding may move a value over to the next of 256 colours
    assert all(abs(picture - pictures[0]).max() <= 1 for picture in pictures)


def test_shading_is_linear_in_between_and_stops_at_the_tables_ends() -> None:
    points = np.array([(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0)])
    faces = np.array([(0, 1, 2), (0, 2, 3)], dtype=np.intp)
    low, high = -0.25, 1.25
    canvas = white()
    canvas.triangles(points, faces, np.array([low, high, high, low]), RAMP)
    value = low + (high - low) * (np.arange(60) + 0.5) / 60
    expected = np.clip(value * 256, 0, 255)
    assert np.all(abs(canvas.image[..., 0] - expected) <= 1.0)
    assert canvas.image[0, 0, 0] == 0 and canvas.image[0, -1, 0] == 255


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, 1.2, math.pi / 2])
@pytest.mark.parametrize("width", [0.6, 1.0, 2.5, 6.0])
def test_a_stroke_covers_its_area_however_it_lies(angle: float, width: float) -> None:
    length = 24.0
    covered = []
    for shift in itertools.product(np.arange(8) / 8, repeat=2):  # on average no place on the grid is special
        canvas = white()
        centre = 30.0 + shift[0], 20.0 + shift[1]
        canvas.stroke(turned(np.array([(-length / 2, 0.0), (length / 2, 0.0)]), angle, centre), BLACK, width)
        covered.append(ink(canvas))
    # Coverage falls from the cap to 0 at `reach` by 1 a px: the two half ends make up a truncated cone.
    reach, cap = width / 2 + 0.5, min(width, 1.0)
    ends = math.pi / 3 * (reach**3 - (reach - cap) ** 3)
    assert np.mean(covered) == pytest.approx(length * width + ends, rel=3e-3, abs=0.06)  # levels of 1/255


def test_joints_of_a_stroke_are_not_painted_twice() -> None:
    whole, parts = white(), white()
    ends = np.array([(5.0, 6.0), (52.0, 31.0)])
    whole.stroke(ends, BLACK, 1.5)
    parts.stroke(ends[0] + np.linspace(0.0, 1.0, 200)[:, None] * (ends[1] - ends[0]), BLACK, 1.5)
    assert abs(whole.image.astype(int) - parts.image).max() <= 1


def test_a_stroke_breaks_where_a_point_is_not_finite() -> None:
    broken, two = white(), white()
    a, b = [(5.0, 5.0), (20.0, 9.0)], [(30.0, 30.0), (50.0, 12.0)]
    broken.stroke([*a, (math.nan, math.nan), *b, (math.inf, 0.0)], BLACK, 2.0)
    two.stroke(a, BLACK, 2.0)
    two.stroke(b, BLACK, 2.0)
    assert np.array_equal(broken.image, two.image)


@pytest.mark.parametrize("sides", [3, 4, 7, 30])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_a_polygon_covers_its_area_in_either_order(sides: int, turn: float) -> None:
    angles = turn * np.linspace(0.0, 2 * math.pi, sides, endpoint=False) + 0.4
    points = np.column_stack((30.3 + 15 * np.cos(angles), 20.1 + 15 * np.sin(angles)))
    canvas = white()
    canvas.polygon(np.vstack((points, points[-1:])), BLACK)  # a side without length changes nothing
    area = sides / 2 * 15**2 * math.sin(2 * math.pi / sides)
    assert ink(canvas) == pytest.approx(area, abs=0.25 * sides)  # at most a quarter pixel a corner


def test_a_rectangle_on_whole_pixels_has_sharp_sides() -> None:
    canvas = white()
    canvas.polygon([(10.0, 5.0), (20.0, 5.0), (20.0, 15.0), (10.0, 15.0)], BLACK)
    boxed = white()
    boxed.box(10, 5, 20, 15, BLACK)
    assert np.array_equal(canvas.image, boxed.image)
    assert ink(canvas) == 100


SHAPE = np.array([(-8.0, 3.0), (31.0, -7.0), (70.0, 22.0), (25.0, 55.0)])


@pytest.mark.parametrize("shape", ["triangles", "stroke", "polygon", "region"])
def test_what_lies_outside_is_cut_off(shape: str) -> None:
    def draw(canvas: Canvas, points: Array) -> None:
        if shape == "triangles":
            faces = np.array([(0, 1, 2), (0, 2, 3)], dtype=np.intp)
            canvas.triangles(points, faces, np.zeros(4), RAMP[:1])
        elif shape == "stroke":
            canvas.stroke(points, BLACK, 3.0)
        elif shape == "polygon":
            canvas.polygon(points, BLACK)
        else:
            canvas.region(points, BLACK)

    small, large = white(), white(160, 120)
    draw(small, SHAPE)
    draw(large, SHAPE + np.array([50, 40]))
    difference = abs(small.image.astype(int) - large.image[40:80, 50:110])
    assert difference.max() <= 1  # of 255, from rounding
    assert difference.mean() < 1e-3
    for away in (1e3, 1e7, 1e12, math.nan, math.inf):
        empty = white()
        draw(empty, SHAPE + away)
        assert ink(empty) == 0


def test_shrinking_takes_means() -> None:
    image = np.random.default_rng(1).integers(0, 256, (12, 18, 3), dtype=np.uint8)
    means = image.reshape(4, 3, 6, 3, 3).mean(axis=(1, 3))
    assert np.array_equal(shrunk(image, 3), np.floor(means + 0.5).astype(np.uint8))
