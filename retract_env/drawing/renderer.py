"""Fast drawing of the flap's section, for `render_mode="rgb_array"` and "human" and for `obs="pixels"`.

Frames are drawn in memory: no display is needed, and only text goes through pygame.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame prints a line as it is imported

from retract_env.drawing.gauges import Strip
from retract_env.drawing.lettering import Lettering
from retract_env.drawing.palette import HIDDEN, INK, STEEL, STRAIN, VEIN_EDGE, WHITE, Bytes, rgb
from retract_env.drawing.raster import shrunk
from retract_env.drawing.scenery import Scenery, View, draw_words, view_of
from retract_env.drawing.shapes import JawShapes, SectionTopology, hidden_region
from retract_env.drawing.window import Window
from retract_env.objectives import seen_spans

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene

__all__ = ["SectionRenderer", "Window"]

DRAWN_WIDTH = 640
"""px, width of a frame for which the sizes below and in gauges.py and scenery.py are given."""
STRIP, GROUND_ROWS = 92, 28
"""px, heights of the strip and of the bed above it."""
LETTERS = 15.5
"""px, height of a line of text."""
LEAST = 160
"""px, smallest width and height of a frame whose text can be read."""
FINER = 3
"""Each pixel of the small picture is the mean of FINER x FINER drawn ones."""
SMALL_RIGHT, SMALL_BED = 0.2, 0.07
"""What a small picture shows behind the fixed end, over the flap's length; the bed's part of its height."""


def check_size(size: tuple[int, int]) -> None:
    """Raise ValueError for a frame, width and height in px, that is too small to read."""
    if min(size) < LEAST:
        raise ValueError(f"size = {tuple(size)} px, allowed {LEAST} and more either way")


def unit_of(size: tuple[int, int]) -> float:
    """px in the width of a thin line, on a frame of that width and height."""
    return min(size[0] / DRAWN_WIDTH, size[1] / (0.75 * DRAWN_WIDTH))


def laid_out(scene: Scene, size: tuple[int, int]) -> tuple[View, int, int]:
    """Where metres fall on a frame of that width and height, where its strip begins, and how many rows show
    the bed, px."""
    unit = unit_of(size)
    strip_top, ground = size[1] - round(STRIP * unit), round(GROUND_ROWS * unit)
    return view_of(scene, size[0], strip_top - ground), strip_top, ground


def up_to(state: TissueState, history: Sequence[TissueState]) -> Sequence[TissueState]:
    """The states so far with `state` at their end, whether they have it already or not."""
    return history if len(history) > 0 and history[-1] is state else [*history, state]


class SectionRenderer:
    """Draws states of one section of one scene."""

    def __init__(self, scene: Scene, section: SectionMesh, size: tuple[int, int] = (640, 480)):
        """size: width and height of a frame, px. Raises ValueError where that is too small to read."""
        check_size(size)
        self.scene, self.size = scene, size
        self._topology = SectionTopology(section, scene.tissue.veins)
        self._jaws, self._bold_jaws = JawShapes(scene), JawShapes(scene, bold=2.0)
        self._frame: tuple[Scenery, Strip, Lettering] | None = None
        self._small: dict[tuple[int, int], Scenery] = {}

    def draw(self, state: TissueState, history: Sequence[TissueState] = ()) -> Bytes:
        """Frame (h, w, 3) of a state, with the curves of the states so far.

        history: oldest first; whether it ends with `state` itself or just before makes no difference.
        """
        if self._frame is None:
            self._frame = self._new_frame()
        scenery, strip, letters = self._frame
        self._paint(scenery, state, self._jaws)
        strip.draw(scenery.canvas, letters, up_to(state, history))
        return scenery.canvas.image.copy()

    def pixels(self, state: TissueState, size: tuple[int, int] = (96, 96)) -> Bytes:
        """Small picture (h, w, 3) of the section in the camera's plane, without text: an observation."""
        if size not in self._small:
            width, height = size[0] * FINER, size[1] * FINER
            ground = round(SMALL_BED * height)
            view = view_of(self.scene, width, height - ground, SMALL_RIGHT)
            self._small[size] = Scenery(
                self.scene, view, (width, height), ground, unit=0.65 * FINER, hatched=False
            )
        scenery = self._small[size]
        self._paint(scenery, state, self._bold_jaws)
        found: Bytes = shrunk(scenery.canvas.image, FINER)
        return found

    def close(self) -> None:
        """Give back the memory that is drawn on; drawing again takes it anew."""
        self._frame = None
        self._small.clear()

    def _new_frame(self) -> tuple[Scenery, Strip, Lettering]:
        (width, height), unit = self.size, unit_of(self.size)
        view, strip_top, ground = laid_out(self.scene, self.size)
        scenery = Scenery(self.scene, view, self.size, ground, unit)
        letters = Lettering(scenery.canvas.surface, LETTERS * unit)
        strip = Strip(self.scene, (0, strip_top, width, height), unit)
        draw_words(scenery, letters)
        strip.draw_behind(scenery.canvas, letters)
        scenery.keep()
        return scenery, strip, letters

    def _paint(self, scenery: Scenery, state: TissueState, jaws: JawShapes) -> None:
        topology, view, canvas, unit = self._topology, scenery.view, scenery.canvas, scenery.unit
        scenery.begin()
        points = np.asarray(state.points, dtype=np.float64)
        sight = self.scene.line_of_sight
        outline = points[topology.outline]
        dark = view(hidden_region(outline, sight.camera))
        canvas.region(dark, rgb(HIDDEN))
        canvas.stroke(dark[-2:], rgb(HIDDEN), 1.5 * unit)
        pixels = view(points)
        share = topology.smooth(state.strain) / self.scene.limits.strain
        canvas.triangles(pixels[topology.nodes], topology.faces, share, STRAIN)
        canvas.stroke(topology.vein_lines(pixels), rgb(VEIN_EDGE), 1.1 * unit)
        canvas.stroke(pixels[topology.outline], rgb(INK), 1.5 * unit)
        for shapes, colour in zip(jaws.at(state.jaws), (STEEL, INK), strict=True):
            placed = view(shapes)
            for shape in placed:
                canvas.polygon(shape[:-1], rgb(colour))
            if jaws is self._jaws:
                canvas.stroke(placed.reshape(-1, 2), rgb(WHITE), 0.7 * unit)
        scenery.cover(seen_spans(outline, sight.camera, -self.scene.tissue.length, sight.target[0]))
