"""The strip below a frame: bars and curves stand where the values are."""

from __future__ import annotations

import math

import numpy as np
import pygame
import pytest
from numpy.typing import NDArray

from retract_env.drawing.gauges import ROOM, STEPS, Strip, gauges_of
from retract_env.drawing.lettering import Lettering
from retract_env.drawing.palette import GROUND, INK, LIMIT, SIGHT, VALUE, Bytes, rgb
from retract_env.drawing.raster import Canvas
from retract_env.physics.base import TissueState
from retract_env.scene import Limits, LineOfSight, Scene, Tissue

SCENE = Scene(
    name="plain",
    tissue=Tissue(length=0.05, height=0.0044, depth=0.0044, density=1e3, modulus=4e4, poisson=0.45),
    line_of_sight=LineOfSight.at(-0.0125, math.pi / 4),
    limits=Limits(strain=0.4, friction=0.6),
)
STRAIN_BAR, FRICTION_BAR, CLEARANCE_BAR = range(3)
TALL = 390
"""px, height of the bars: 300 up to the limit"""


def state(
    strain: float = 0.1, friction: float = 0.1, clearance: float = -0.01, progress: float = 2.0
) -> TissueState:
    none = np.zeros((2, 2))
    return TissueState(
        none,
        none[0],
        np.zeros(4),
        none,
        none,
        strain,
        none[0],
        np.array([0.0, friction]),
        clearance,
        progress,
    )


class Drawn:
    """A strip with these states drawn."""

    def __init__(self, *states: TissueState) -> None:
        canvas = Canvas(np.full((TALL + 32, 900, 3), 255, dtype=np.uint8))
        self.strip = Strip(SCENE, (0, 0, 900, TALL + 32), 1.0)
        letters = Lettering(canvas.surface, 15)
        self.strip.draw_behind(canvas, letters)
        self.before: Bytes = canvas.image.copy()
        self.strip.draw(canvas, letters, states)
        self.image = canvas.image

    def bar(self, gauge: int) -> Bytes:
        """(h, 3) colours down the middle of a bar, without the mark of its limit."""
        left, top, right, bottom = (round(v) for v in self.strip.bars[gauge])
        column = self.image[top:bottom, (left + right) // 2].copy()
        mark = np.flatnonzero((column == rgb(INK)).all(axis=1))
        column[mark] = column[mark[-1] + 1] if len(mark) else 0
        return column

    def filled(self, gauge: int, colour: str) -> int:
        """Rows of a bar, from below, of a colour."""
        same = (self.bar(gauge) == rgb(colour)).all(axis=1)[::-1]
        return len(same) if same.all() else int(np.argmin(same))

    def curve(self, gauge: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Columns and rows of the pixels of a curve, over its plot's left and lower side."""
        left, top, right, bottom = (round(v) for v in self.strip.plots[gauge])
        part = self.image[top:bottom, left:right]
        rows, columns = np.nonzero((part == rgb(VALUE)).all(axis=-1))
        return columns, bottom - top - rows


@pytest.mark.parametrize("share", [0.0, 0.15, 0.5, 0.99, 1.01, 1.2, 3.0])
def test_bars_stand_in_proportion_to_the_limit(share: float) -> None:
    drawn = Drawn(state(strain=share * SCENE.limits.strain, friction=share * SCENE.limits.friction))
    colour = VALUE if share <= 1 else LIMIT
    for gauge in (STRAIN_BAR, FRICTION_BAR):
        assert drawn.filled(gauge, colour) == pytest.approx(
            300 * min(share, ROOM), abs=2
        )  # the mark is 2 high


def test_clearance_turns_green_when_the_target_is_in_view() -> None:
    heights = []
    for clearance, colour in ((-0.02, VALUE), (-1e-6, VALUE), (0.0, SIGHT), (0.004, SIGHT)):
        heights.append(Drawn(state(clearance=clearance)).filled(CLEARANCE_BAR, colour))
    assert heights[0] > 0 and heights == sorted(heights)


@pytest.mark.parametrize("asked", [0.0, 0.004, 0.05])
def test_a_clearance_that_is_asked_for_is_where_the_gauge_turns_green(asked: float) -> None:
    rise = gauges_of(SCENE.model_copy(update={"limits": Limits(clearance=asked)}))[CLEARANCE_BAR]
    assert rise.share(asked) == rise.limit_share < 1
    assert [rise.colour(asked + more) for more in (-1e-6, 0.0)] == [VALUE, SIGHT]


def test_friction_without_bound_fills_its_bar() -> None:
    assert Drawn(state(friction=math.inf)).filled(FRICTION_BAR, LIMIT) == TALL


def test_no_friction_is_shown_before_the_squeeze() -> None:
    drawn = Drawn(state(progress=0.0), state(progress=0.5))
    left, right = drawn.strip.plots[FRICTION_BAR][0], drawn.strip.bars[FRICTION_BAR][2]
    assert np.array_equal(
        drawn.image[:, round(left) : round(right)], drawn.before[:, round(left) : round(right)]
    )
    assert drawn.filled(FRICTION_BAR, GROUND) == TALL


def test_curves_go_through_the_values_so_far() -> None:
    steps = 48
    strains = 0.4 * np.linspace(0.2, 0.9, steps + 1)
    columns, heights = Drawn(*(state(strain=s) for s in strains)).curve(STRAIN_BAR)
    left, _, right, _ = Drawn(state()).strip.plots[STRAIN_BAR]
    wide = right - left
    assert columns.max() == pytest.approx(wide * steps / STEPS, abs=4)  # with the dot at its end
    inside = columns < columns.max() - 8
    expected = 300 * (0.2 + 0.7 * (columns[inside] + 0.5) / (wide * steps / STEPS))
    assert abs(heights[inside] - expected).max() < 3


def test_more_steps_than_there_is_room_for_are_squeezed_together() -> None:
    drawn = Drawn(*(state(strain=0.2) for _ in range(3 * STEPS)))
    left, _, right, _ = drawn.strip.plots[STRAIN_BAR]
    assert drawn.curve(STRAIN_BAR)[0].max() == pytest.approx(right - left, abs=2)


def test_written_words_are_forgotten_in_time() -> None:
    letters = Lettering(pygame.Surface((50, 20)), 12)
    for i in range(3 * Lettering.KEPT):
        letters.write(str(i), 0, 10)
    assert len(letters._known) <= Lettering.KEPT
