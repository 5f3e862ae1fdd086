"""The strip below a drawn frame: strain, friction and clearance so far, each against its limit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.palette import GREY, GROUND, HATCH, INK, LIMIT, SIGHT, VALUE, WHITE, rgb
from retract_env.objectives import clearance

if TYPE_CHECKING:
    from retract_env.drawing.lettering import Lettering
    from retract_env.drawing.raster import Canvas
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene

Array = NDArray[np.float64]

STEPS = 64
"""Steps that a curve has room for; the curve of a longer episode is drawn narrower to fit."""
ROOM = 1.3
"""Value at the top of a gauge, as a multiple of its limit."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, px."""


@dataclass(frozen=True)
class Gauge:
    """One quantity of a state, shown from `low` to `high`, with its limit."""

    title: str
    value: Callable[[TissueState], float]
    """nan where there is nothing to show"""
    text: Callable[[float], str]
    low: float
    high: float
    limit: float
    limit_text: str
    wanted_above: bool = False

    def share(self, value: ArrayLike) -> Array:
        """How high values (...,) stand, 0 to 1."""
        return np.clip((np.asarray(value, dtype=np.float64) - self.low) / (self.high - self.low), 0.0, 1.0)

    @property
    def limit_share(self) -> float:
        """How high the limit stands."""
        return (self.limit - self.low) / (self.high - self.low)

    def colour(self, value: float) -> str:
        """Green where the goal is reached, orange where a limit is broken, blue otherwise."""
        if self.wanted_above:
            return SIGHT if value >= self.limit else VALUE
        return VALUE if value <= self.limit else LIMIT


def needed_friction(state: TissueState) -> float:
    """The greater of the jaws' required friction; nan before the squeeze, when nothing is held yet."""
    return max(np.asarray(state.required_friction).tolist()) if state.progress >= 1 else math.nan


def gauges_of(scene: Scene) -> tuple[Gauge, Gauge, Gauge]:
    """Strain, friction and clearance of a scene."""
    limits, sight = scene.limits, scene.line_of_sight
    lying = clearance((-scene.tissue.length, 0.0), sight.camera, sight.target)  # nearly the least there is

    def in_mm(value: float) -> str:
        return f"{1e3 * value:+.1f} mm".replace("-", "\N{MINUS SIGN}")

    def coefficient(value: float) -> str:
        return f"{value:.2f}" if value < 100 else "lets go"

    strain = Gauge(
        "strain", lambda s: s.worst_strain, lambda v: f"{v:.3f}", 0.0, ROOM * limits.strain, limits.strain,
        f"limit {limits.strain:g}",
    )  # fmt: skip
    friction = Gauge(
        "friction needed", needed_friction, coefficient, 0.0, ROOM * limits.friction, limits.friction,
        f"limit {limits.friction:g}",
    )  # fmt: skip
    highest = max(-0.33 * lying, ROOM * limits.clearance)
    rise = Gauge(
        "clearance", lambda s: s.clearance, in_mm, 1.1 * lying, highest, limits.clearance, "in view", True
    )  # fmt: skip
    return strain, friction, rise


class Strip:
    """Gauges side by side, each with its curve over the steps and a bar for now."""

    def __init__(self, scene: Scene, box: Box, unit: float):
        """box: where on the canvas; unit: px, width of a thin line."""
        self.gauges, self._box, self._unit = gauges_of(scene), box, unit
        left, top, right, bottom = box
        gap, wide = 14 * unit, (right - left) / len(self.gauges)
        self.plots: list[Box] = []
        self.bars: list[Box] = []
        for i in range(len(self.gauges)):
            begin, end = left + i * wide + gap, left + (i + 1) * wide - gap
            self.plots.append((begin, top + 24 * unit, end - 14 * unit, bottom - 8 * unit))
            self.bars.append((end - 10 * unit, top + 24 * unit, end, bottom - 8 * unit))

    def draw_behind(self, canvas: Canvas, letters: Lettering) -> None:
        """What does not change: titles, limits, the bars' ground."""
        unit = self._unit
        canvas.box(*self._box, rgb(WHITE))
        canvas.box(self._box[0], self._box[1], self._box[2], self._box[1] + unit, rgb(HATCH))
        for gauge, plot, bar in zip(self.gauges, self.plots, self.bars, strict=True):
            left, top, right, bottom = plot
            letters.write(gauge.title, left, top - 12 * unit, GREY)
            canvas.box(*bar, rgb(GROUND))
            canvas.box(left, bottom - unit, right, bottom, rgb(HATCH))
            level = bottom - gauge.limit_share * (bottom - top)
            colour = SIGHT if gauge.wanted_above else LIMIT
            for x in np.arange(left, right, 7 * unit):
                canvas.stroke([(x, level), (min(x + 4 * unit, right), level)], rgb(colour), 1.3 * unit)
            letters.write(gauge.limit_text, left, level - 7 * unit, colour)

    def draw(self, canvas: Canvas, letters: Lettering, states: Sequence[TissueState]) -> None:
        """Curves of the states so far, at least one; bar and number of the last."""
        unit = self._unit
        steps = np.arange(len(states) + 1) / max(STEPS, len(states) - 1)
        curves = []
        for gauge, (left, top, right, bottom) in zip(self.gauges, self.plots, strict=True):
            values = [gauge.value(state) for state in states]
            heights = bottom - gauge.share([*values, math.nan]) * (bottom - top)  # a gap after each curve
            curves.append(np.column_stack((left + steps * (right - left), heights)))
        canvas.stroke(np.concatenate(curves), rgb(VALUE), 2.0 * unit)
        for gauge, curve, bar in zip(self.gauges, curves, self.bars, strict=True):
            now = gauge.value(states[-1])
            if math.isnan(now):
                continue
            left, top, right, bottom = bar
            canvas.stroke(curve[[-2, -2]], rgb(gauge.colour(now)), 6.0 * unit)
            canvas.box(left, float(curve[-2, 1]), right, bottom, rgb(gauge.colour(now)))
            level = bottom - gauge.limit_share * (bottom - top)
            canvas.box(left - 2 * unit, level - unit, right + 2 * unit, level + unit, rgb(INK))
            letters.write(gauge.text(now), right, top - 12 * unit, gauge.colour(now), align=1.0)
