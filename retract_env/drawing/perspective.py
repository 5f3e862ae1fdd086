"""Where points in space fall on a picture, for an eye that is put so that all of interest is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom, px."""

WIDEST = math.radians(65.0)
"""Half of the widest angle that a picture spans: beyond, flat pictures distort what is at their border."""
NEAREST = 1e-3
"""Of the distance to what is looked at: what is nearer than that, or behind the eye, is not drawn."""


@dataclass(frozen=True, eq=False)
class Pinhole:
    """An eye and the flat picture in front of it. y is up in space, and down on the picture."""

    eye: Array
    """(3,) m"""
    axes: Array
    """(3, 3) unit rows: to the right and down on the picture, and ahead"""
    focal: float
    """px, distance of the picture from the eye"""
    centre: tuple[float, float]
    """px, where the axis ahead meets the picture"""
    near: float = 1e-6
    """m ahead, what is nearer is not drawn"""

    def __call__(self, points: ArrayLike) -> Array:
        """(..., 3) of points (..., 3) m: x and y on the picture, px, and one over the distance ahead, 1/m;
        all nan for what is too near or behind. Straight lines stay straight in all three."""
        seen = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        ahead = seen[..., 2]
        over = 1.0 / np.where(ahead > self.near, ahead, np.nan)
        seen[..., 0] = self.centre[0] + self.focal * seen[..., 0] * over
        seen[..., 1] = self.centre[1] + self.focal * seen[..., 1] * over
        seen[..., 2] = over
        return seen

    def rays(self, pixels: ArrayLike) -> Array:
        """(..., 3) directions, m for a metre ahead, of the pixels (..., 2)."""
        flat = (np.asarray(pixels, dtype=np.float64) - self.centre) / self.focal
        return np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1) @ self.axes


def axes_ahead(azimuth: float, elevation: float) -> Array:
    """Axes of an eye that looks down by `elevation` from the side of the free end.

    rad: azimuth from the z axis towards -x, and elevation above the bed.
    """
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    ahead = np.array([sa * ce, -se, -ca * ce])
    right = np.array([ca, 0.0, sa])
    return np.stack([right, np.cross(ahead, right), ahead])


def from_afar(points: Array, axes: Array, opening: float, box: Box) -> Pinhole:
    """The nearest eye with these axes that sees all points (n, 3) m within a box of the picture.

    opening: rad, the angle that the box spans from top to bottom.
    """
    left, top, right, bottom = box
    focal = (bottom - top) / 2 / math.tan(opening / 2)
    turned = points @ axes.T
    # A point is within the box if |x - ex| <= a (z - ez), which is linear in the eye: two bounds on ex that
    # leave room up to the greatest ez. The same for y.
    eye, reach = np.empty(3), []
    for k, half in ((0, (right - left) / 2), (1, (bottom - top) / 2)):
        a = half / focal
        reach.append(
            (np.min(turned[:, k] + a * turned[:, 2]) - np.max(turned[:, k] - a * turned[:, 2])) / 2 / a
        )
    eye[2] = min(reach)
    for k, half in ((0, (right - left) / 2), (1, (bottom - top) / 2)):
        a = half / focal
        room = a * (turned[:, 2] - eye[2])
        eye[k] = (np.max(turned[:, k] - room) + np.min(turned[:, k] + room)) / 2
    distance = float(turned[:, 2].mean() - eye[2])
    return Pinhole(eye @ axes, axes, focal, ((left + right) / 2, (top + bottom) / 2), NEAREST * distance)


def from_point(eye: Array, points: Array, box: Box) -> Pinhole:
    """An eye that is given, in the plane z = 0, turned in that plane so that all points (n, 3) m are within a
    box of the picture and fill it, as far as `WIDEST` allows."""
    left, top, right, bottom = box
    away = points - eye
    angle = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))  # of each to the next one, so all to the first
    middle = (angle.min() + angle.max()) / 2
    ahead = np.array([math.cos(middle), math.sin(middle), 0.0])
    axes = np.stack([[0.0, 0.0, 1.0], [ahead[1], -ahead[0], 0.0], ahead])
    turned = away @ axes.T
    far = float(np.linalg.norm(away, axis=1).mean())
    half = (right - left) / 2, (bottom - top) / 2
    steep = [
        max(float(np.max(np.abs(turned[:, k]) / np.maximum(turned[:, 2], NEAREST * far))), 1e-9)
        for k in (0, 1)
    ]
    focal = min(half[k] / min(steep[k], math.tan(WIDEST)) for k in (0, 1))
    return Pinhole(
        np.asarray(eye, float), axes, focal, ((left + right) / 2, (top + bottom) / 2), NEAREST * far
    )
