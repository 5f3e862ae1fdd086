"""What is nearer hides what is farther, whatever is drawn first."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from retract_env.drawing.palette import Bytes
from retract_env.drawing.zbuffer import (
    FLOOR,
    INNER,
    SHADED,
    SOLID,
    cast_shadow,
    draw_lines,
    fill_faces,
    halved,
)

RED, BLUE = np.array([[200, 0, 0]], np.uint8), np.array([[0, 0, 200]], np.uint8)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


class Picture:
    """White, infinitely far."""

    def __init__(self, size: int = 40):
        self.image: Bytes = np.full((size, size, 3), 255, np.uint8)
        self.depth = np.zeros((size, size), np.float32)
        self.kind: Bytes = np.full((size, size), FLOOR, np.uint8)

    def square(
        self,
        low: float,
        high: float,
        w: tuple[float, float],
        table: Bytes,
        own: int = SOLID,
        through: float = 0.0,
    ) -> None:
        """w: at its left and its right side."""
        points = np.array([(low, low, w[0]), (high, low, w[1]), (high, high, w[1]), (low, high, w[0])])
        nothing, light = np.zeros(4), np.ones(4)
        fill_faces(
            self.image, self.depth, self.kind, points, FACES, nothing, light, table, own, through, 1.0
        )  # fmt: skip


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_faces_that_pierce_each_other_meet_where_they_are_as_far(order: tuple[int, int]) -> None:
    picture = Picture()
    both = ((1.0, 3.0), RED), ((3.0, 1.0), BLUE)
    for k in order:
        picture.square(0.0, 40.0, *both[k])
    assert (picture.image[:, :20] == BLUE[0]).all() and (picture.image[:, 20:] == RED[0]).all()
    columns = (np.arange(40) + 0.5) / 40
    assert np.allclose(picture.depth, np.maximum(1 + 2 * columns, 3 - 2 * columns), rtol=1e-6)


def test_the_order_of_any_faces_makes_no_difference() -> None:
    rng = np.random.default_rng(0)
    squares = [(*np.sort(rng.uniform(0, 40, 2)), rng.uniform(1, 2, 2), k) for k in range(4)]
    pictures = []
    for order in itertools.permutations(squares):
        picture = Picture()
        for low, high, w, k in order:
            picture.square(low, high, tuple(w), np.array([[60 * k, 10, 10]], np.uint8))
        pictures.append(picture.image)
    assert all(np.array_equal(image, pictures[0]) for image in pictures)


def test_what_is_inside_shines_through_less_the_deeper_it_is() -> None:
    reds = []
    for far in (1.01, 1.5, 4.0):  # m ahead, behind a face at 1 m
        picture = Picture()
        picture.square(0.0, 40.0, (1 / far,) * 2, RED, own=INNER)
        picture.square(0.0, 40.0, (1.0, 1.0), BLUE, through=0.5)
        reds.append(int(picture.image[20, 20, 0]))
    assert 90 < reds[0] <= 100 and reds[0] > reds[1] > reds[2] > 0
    opaque = Picture()
    opaque.square(0.0, 40.0, (0.5, 0.5), RED)  # not inside: hidden
    opaque.square(0.0, 40.0, (1.0, 1.0), BLUE, through=0.5)
    assert (opaque.image == BLUE[0]).all()


def test_light_multiplies_and_whitens_beyond_one() -> None:
    found = []
    for light in (0.5, 1.0, 1.25):
        picture = Picture(4)
        points = np.array([(0.0, 0.0, 1.0), (4.0, 0.0, 1.0), (4.0, 4.0, 1.0), (0.0, 4.0, 1.0)])
        lit, drawn_on = np.full(4, light), (picture.image, picture.depth, picture.kind)
        fill_faces(*drawn_on, points, FACES, np.zeros(4), lit, RED, SOLID, 0.0, 1.0)
        found.append(picture.image[2, 2].tolist())
    assert found == [[100, 0, 0], [200, 0, 0], [255, 63, 63]]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_faces_that_are_behind_the_eye_are_left_out(bad: float) -> None:
    picture = Picture()
    picture.square(0.0, bad, (1.0, 1.0), RED)
    assert (picture.image == 255).all()


def test_lines_are_hidden_or_faint_behind_faces_and_hide_nothing() -> None:
    picture = Picture()
    picture.square(0.0, 20.0, (2.0, 2.0), BLUE)
    line = np.array([(0.0, 10.0, 1.0), (40.0, 10.0, 1.0)])
    draw_lines(picture.image, picture.depth, line, 2.0, 0, 0, 0, 1e-3, 0.0)
    assert (picture.image[9:11, :20] == BLUE[0]).all() and (picture.image[9:11, 21:39] == 0).all()
    assert (picture.image[[7, 12]] != 0).any(axis=-1).all()  # no wider than it is
    draw_lines(picture.image, picture.depth, line + np.array([0, 5, 0]), 2.0, 0, 0, 0, 1e-3, 0.5)
    assert (picture.image[14:16, 1:20] == BLUE[0] // 2).all()
    on_it = line + np.array([0, -5, 1])
    draw_lines(picture.image, picture.depth, on_it, 2.0, 0, 0, 0, 1e-3, 0.0)
    assert (picture.image[4:6, 1:20] == 0).all()
    assert picture.depth.max() == 2.0


def test_a_shadow_darkens_the_bed_alone_and_once() -> None:
    picture = Picture()
    picture.square(0.0, 10.0, (1.0, 1.0), RED)
    points = np.array([(0.0, 0.0, 1.0), (30.0, 0.0, 1.0), (30.0, 30.0, 1.0), (0.0, 30.0, 1.0)])
    for _ in range(2):
        cast_shadow(picture.image, picture.kind, points, FACES, 0.5)
    assert (picture.image[:10, :10] == RED[0]).all()
    assert (picture.image[10:30, :30] == 127).all() and (picture.kind[10:30, :30] == SHADED).all()
    assert (picture.image[30:] == 255).all() and (picture.kind[30:] == FLOOR).all()


def test_halving_takes_means() -> None:
    image = np.random.default_rng(1).integers(0, 256, (8, 6, 3), dtype=np.uint8)
    out = np.empty((4, 3, 3), np.uint8)
    halved(image, out)
    means = image.reshape(4, 2, 3, 2, 3).astype(float).mean(axis=(1, 3))
    assert abs(out - means).max() <= 0.5
