"""An eye in space: where points fall, and that all of interest is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from retract_env.drawing.perspective import Pinhole, axes_ahead, from_afar, from_point

BOX = (20.0, 30.0, 620.0, 430.0)


def corners(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform((-0.05, 0.0, -0.01), (0.01, 0.04, 0.01), (40, 3))


def test_points_fall_where_similar_triangles_say() -> None:
    ahead = np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # to -z, down, along x
    eye = Pinhole(np.array([-2.0, 1.0, 0.0]), ahead, 100.0, (320.0, 240.0))
    assert np.allclose(eye((0.0, 1.0, 0.0)), (320, 240, 1 / 2))
    assert np.allclose(eye((2.0, 2.0, -1.0)), (320 + 100 / 4, 240 - 100 / 4, 1 / 4))
    assert np.isnan(eye((-2.5, 1.0, 0.0))).all()  # behind


def test_rays_lead_back_to_the_points() -> None:
    points = corners(0)
    eye = from_afar(points, axes_ahead(0.4, 0.3), 0.4, BOX)
    seen = eye(points)
    back = eye.eye + eye.rays(seen[:, :2]) / seen[:, 2:]
    assert np.allclose(back, points, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (0.5, 0.3), (-1.0, 1.2)])
def test_the_eye_from_afar_sees_all_and_is_no_farther_than_it_must(
    seed: int, azimuth: float, elevation: float
) -> None:
    points, axes = corners(seed), axes_ahead(azimuth, elevation)
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    eye = from_afar(points, axes, 0.4, BOX)
    x, y, _ = eye(points).T
    left, top, right, bottom = BOX
    room = np.array([x.min() - left, right - x.max(), y.min() - top, bottom - y.max()])
    assert np.all(room > -1e-6)
    tight = abs(room) < 1e-6
    assert tight[:2].all() or tight[2:].all()


def test_an_eye_that_is_given_turns_to_see_all() -> None:
    points = corners(1)
    eye = from_point(np.array([-0.08, 0.07, 0.0]), points, BOX)
    x, y, _ = eye(points).T
    assert BOX[0] - 1e-6 < x.min() and x.max() < BOX[2] + 1e-6
    assert BOX[1] - 1e-6 < y.min() and y.max() < BOX[3] + 1e-6
    upright = eye(np.array([(-0.02, 0.0, 0.0), (-0.02, 0.01, 0.0), (-0.02, 0.0, 0.01)]))
    assert upright[0, 0] == pytest.approx(upright[1, 0]) and upright[1, 1] < upright[0, 1]  # up is up
    assert upright[2, 0] > upright[0, 0]  # and z to the right


def test_an_eye_among_the_points_keeps_a_flat_picture() -> None:
    points = corners(2)
    eye = from_point(points.mean(axis=0) * (1, 1, 0), points, BOX)
    assert eye.focal >= 0.999 * (BOX[3] - BOX[1]) / 2 / math.tan(math.radians(65))
