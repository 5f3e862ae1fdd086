"""What stands still around the flap: bed, fixed end, line of sight, the wedge that tissue must leave."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.lettering import Lettering
from retract_env.drawing.palette import (
    GREY,
    GROUND,
    HATCH,
    INK,
    LIMIT,
    SIGHT,
    STRAIN,
    WEDGE,
    WHITE,
    Bytes,
    rgb,
)
from retract_env.drawing.raster import Canvas
from retract_env.drawing.shapes import sight_reach

if TYPE_CHECKING:
    from retract_env.scene import Scene

Array = NDArray[np.float64]

LEFT, RIGHT, ABOVE = 1.1, 0.45, 0.85
"""What a picture shows at least before, behind and above the fixed end, over the flap's length."""


@dataclass(frozen=True)
class View:
    """Where metres fall on a picture."""

    left: float
    """m, x of the left border"""
    bed: int
    """px, row of y = 0"""
    scale: float
    """px per m"""

    def __call__(self, points: ArrayLike) -> Array:
        """Pixels (..., 2), x to the right and y down, of points (..., 2) m."""
        scale = self.scale
        placed: Array = np.asarray(points, dtype=np.float64) * (scale, -scale)
        placed += (-self.left * scale, self.bed)
        return placed


def drawn_length(scene: Scene) -> float:
    """m, the flap's length as far as pictures leave room for it: thick flaps need some as well."""
    return max(scene.tissue.length, 3 * scene.tissue.height)


def view_of(scene: Scene, width: int, bed: int, right: float = RIGHT) -> View:
    """The largest view that shows LEFT, `right` and ABOVE on `width` px and `bed` rows above the bed."""
    length = drawn_length(scene)
    scale = min(width / (LEFT + right), bed / ABOVE) / length
    spare = width / scale - (LEFT + right) * length
    return View(left=-LEFT * length - spare / 2, bed=bed, scale=scale)


class Scenery:
    """A picture that states are drawn on: what lies behind the flap is drawn once, what lies over it anew."""

    def __init__(
        self, scene: Scene, view: View, size: tuple[int, int], ground: int, unit: float, hatched: bool = True
    ):
        """size: px; ground: px, how much of the bed is drawn; unit: px, width of a thin line."""
        self.scene, self.view, self.unit, self._ground, self._hatched = scene, view, unit, ground, hatched
        self.canvas = Canvas(np.empty((size[1], size[0], 3), dtype=np.uint8))
        target = np.array(scene.line_of_sight.target)
        climb = np.array(scene.line_of_sight.camera) - target
        self._distance = float(np.hypot(*climb))
        self.away: Array = climb / self._distance * (1, -1)  # from B to A, on the picture
        self._target = view(target)
        inside = 12 * unit
        up = (1, -1)  # pixels go down
        reach = sight_reach(self._target * up, self.away * up, self._distance * view.scale, inside, -inside)
        self.sight_end: Array = self._target + self.away * reach
        self._draw_behind()
        self._still: Bytes = self.canvas.image.copy()

    def keep(self) -> None:
        """What has been drawn by now stays."""
        self._still = self.canvas.image.copy()

    def begin(self) -> None:
        """Wipe off the last state, above the bed; `cover` draws the bed again."""
        np.copyto(self.canvas.image[: self.view.bed], self._still[: self.view.bed])

    def cover(self, seen: Array) -> None:
        """Draw what lies over the flap. seen: (s, 2) m, what the camera sees of the area of interest."""
        canvas, view, unit, sight = self.canvas, self.view, self.unit, rgb(SIGHT)
        canvas.image[view.bed :] = self._still[view.bed :]
        length, target = self.scene.tissue.length, self.scene.line_of_sight.target
        top, bottom = view.bed + unit, view.bed + 5.5 * unit
        parts = [((-length, target[0]), LIMIT), *((span, SIGHT) for span in seen.tolist())]
        for (begin, end), colour in parts:
            left, right = (begin - view.left) * view.scale, (end - view.left) * view.scale
            canvas.box(left, top, right, bottom, rgb(colour))
        canvas.stroke(view([(0.0, 0.0), (0.0, self.scene.tissue.height)]), rgb(INK), 2.5 * unit)
        canvas.stroke([self._target, self.sight_end], sight, 1.8 * unit)
        for colour, radius in ((WHITE, 5.2 * unit), (SIGHT, 4.0 * unit)):
            canvas.stroke([self._target, self._target], rgb(colour), 2 * radius)

    def _draw_behind(self) -> None:
        canvas, view, unit = self.canvas, self.view, self.unit
        height, width = canvas.image.shape[:2]
        canvas.image[:] = 255
        far = 4.0 * max(height, width)
        beyond = self._target + far * self.away
        canvas.polygon([self._target, beyond, (-far, beyond[1]), (-far, self._target[1])], rgb(WEDGE))
        wall = view((0.0, self.scene.tissue.height))
        canvas.image[view.bed :] = 255
        self._hatch(0, view.bed, width, min(view.bed + self._ground, height))
        self._hatch(round(wall[0]), round(wall[1]), width, view.bed)
        canvas.stroke([(0, view.bed), (width, view.bed)], rgb(GREY), unit)
        arrived = np.hypot(*(self.sight_end - self._target)) > self._distance * view.scale - 1
        draw_camera(canvas, self.sight_end, self.away, bool(arrived), unit)

    def _hatch(self, left: int, top: int, right: int, bottom: int) -> None:
        patch = Canvas(np.full((bottom - top, right - left, 3), rgb(GROUND), dtype=np.uint8))
        tall = bottom - top
        step = 7 * self.unit
        # strokes of both boxes lie on the same lines
        start = math.ceil((left + bottom - tall) / step) * step - left - bottom
        for x in np.arange(start, right - left, step) if self._hatched else ():
            patch.stroke([(x, tall), (x + tall, 0)], rgb(HATCH), 0.7 * self.unit)
        self.canvas.image[top:bottom, left:right] = patch.image


def draw_camera(canvas: Canvas, end: Array, away: Array, arrived: bool, unit: float) -> None:
    """A camera at the end of the line of sight, or else an arrow that points to it.

    end: (2,) px; away: (2,) unit on the picture, from B to A; arrived: whether A is there.
    """
    across = np.array([-away[1], away[0]])

    def placed(shape: list[tuple[float, float]]) -> Array:
        found: Array = end + unit * (np.array(shape) @ np.stack((across, away)))
        return found

    arrow = placed([(0.0, 9.0), (5.0, -2.0), (-5.0, -2.0)])
    lens = placed([(-5.0, -3.0), (5.0, -3.0), (2.0, 3.0), (-2.0, 3.0)])
    body = placed([(-6.0, 2.0), (6.0, 2.0), (6.0, 12.0), (-6.0, 12.0)])
    for shape in (lens, body) if arrived else (arrow,):
        canvas.polygon(shape, rgb(SIGHT))


def draw_words(scenery: Scenery, letters: Lettering) -> None:
    """The names of things, and the colours of strain up to its limit."""
    scene, view, unit = scenery.scene, scenery.view, scenery.unit
    length, target = scene.tissue.length, scene.line_of_sight.target
    below = view.bed + 17 * unit
    near, far = view([(-length, 0.0), target])[:, 0]
    letters.write("B", far, below, SIGHT, 0.5, plate=GROUND)
    at = near + 4 * unit if far - near > 215 * unit else far + 20 * unit  # the words take 205
    for word, colour in (("area of interest", GREY), ("in view", SIGHT), ("hidden", LIMIT)):
        at += letters.write(word, at, below, colour, plate=GROUND) + 12 * unit
    wall = view((0.0, scene.tissue.height / 2))
    letters.write("fixed end", wall[0] + 14 * unit, wall[1], GREY, plate=GROUND)
    name_camera(letters, scenery.sight_end, scenery.away, unit)
    draw_scale(scenery.canvas, letters, scene.limits.strain, unit)


def name_camera(letters: Lettering, end: Array, away: Array, unit: float) -> None:
    """The line of sight's name, below its end, where the flap comes from; end and away as `draw_camera`."""
    aside = np.array([away[1], -away[0]])
    x, y = end - 62 * unit * away - 11 * unit * aside
    letters.write("camera A", x, y, SIGHT, 0.5, turn=math.degrees(math.atan2(away[1], -away[0])))


def draw_scale(canvas: Canvas, letters: Lettering, limit: float, unit: float) -> None:
    """The colours of strain, up to its limit, in the upper right corner."""
    right, top = canvas.image.shape[1] - 44 * unit, 34 * unit
    tall = 120 * unit
    for i, colour in enumerate(STRAIN):
        bottom = top + tall * (1 - i / len(STRAIN))
        canvas.box(right - 12 * unit, bottom - tall / len(STRAIN) - 1, right, bottom, tuple(colour))
    letters.write("strain", right - 6 * unit, top - 14 * unit, GREY, 0.5)
    for share in (0.0, 0.5, 1.0):
        letters.write(f"{share * limit:g}", right + 5 * unit, top + tall * (1 - share), GREY)
