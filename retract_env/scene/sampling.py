"""Random scenes: the ranges to draw from, and veins that fit into the flap."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BeforeValidator, model_validator

from retract_env.config import Frozen, Range, brief, refusal
from retract_env.errors import ConfigError, SceneError
from retract_env.scene import Jaws, LineOfSight, Scene, Tissue, Vein
from retract_env.scene.bounds import (
    CAMERA_DISTANCE,
    CAMERA_HEIGHTS,
    DEPTHS,
    HEIGHTS,
    LENGTHS,
    MODULI,
    SLOPES,
)
from retract_env.scene.veins import MOST_VEINS

if TYPE_CHECKING:
    import numpy as np


def _ends(value: Any) -> Any:
    """[least, greatest], from 0 upwards."""
    numbers = isinstance(value, list | tuple) and all(
        isinstance(end, int | float) and not isinstance(end, bool) for end in value
    )
    if not numbers or len(value) != 2 or not 0 <= value[0] <= value[1] < math.inf:
        raise refusal(f" = {brief(value)}, allowed [least, greatest] from 0 upwards")
    return value


def _counts(value: Any) -> Any:
    low, high = _ends(value)
    if low != int(low) or high != int(high):
        raise refusal(f" = {brief(value)}, not whole numbers")
    if high > MOST_VEINS:
        raise refusal(f" = {brief(value)}, allowed up to {MOST_VEINS}")
    return int(low), int(high)


DENSITY, POISSON = 1000.0, 0.45
"""kg/m^3, of the tissue; of the tissue and of the veins: the same in all random scenes"""

Ends = Annotated[tuple[float, float], BeforeValidator(_ends)]


def _within(allowed: Range) -> BeforeValidator:
    """Both ends have to be what a scene may have: batches of environments do not look again at what is
    drawn."""

    def check(value: Any) -> Any:
        for end in _ends(value):
            allowed.check(end)
        return value

    return BeforeValidator(check)


_Fraction = Annotated[tuple[float, float], _within(Range(0.0, 1.0))]
_Slopes = Annotated[tuple[float, float], _within(SLOPES)]
_Moduli = Annotated[tuple[float, float], _within(MODULI)]


class SceneRanges(Frozen):
    """What `sample_scene` draws from: (least, greatest) each, uniform unless said otherwise."""

    error_type: ClassVar[type[ConfigError]] = SceneError

    veins: Annotated[tuple[int, int], BeforeValidator(_counts)] = (0, 20)
    """How many, 500 at most; both ends occur."""
    vein_modulus: _Moduli = (8e4, 4e5)
    """Pa, log-uniform, for each vein."""
    vein_width: Ends = (0.25, 0.6)
    """Along x, before tilting, as a fraction of the flap's height; shrinks where there is no room."""
    vein_height: Ends = (0.2, 0.55)
    """Along y, likewise."""
    tissue_modulus: _Moduli = (4e4, 4e4)
    """Pa, log-uniform."""
    length: Annotated[tuple[float, float], _within(replace(LENGTHS, low=4 * Jaws().width))] = (0.05, 0.05)
    """m; more than four times the jaws' width."""
    height: Annotated[tuple[float, float], _within(HEIGHTS)] = (4.4e-3, 4.4e-3)
    """m."""
    depth: Annotated[tuple[float, float], _within(DEPTHS)] = (4.4e-3, 4.4e-3)
    """m."""
    target: _Fraction = (0.1, 0.4)
    """Distance of B from the fixed end, as a fraction of the length."""
    slope: _Slopes = (math.radians(30.0), math.radians(70.0))
    """Of the line of sight, rad; with a camera that is never inside the flap."""

    @model_validator(mode="after")
    def _lines_may_be_drawn(self) -> SceneRanges:
        if self.target in ((0.0, 0.0), (1.0, 1.0)):
            raise refusal(f".target = {brief(self.target)}, allowed a place between both ends of the flap")
        least, most = self.slope
        if (fault := CAMERA_HEIGHTS.fault(CAMERA_DISTANCE * math.sin(least))) is not None:
            raise refusal(f".slope = {brief(self.slope)}: the height of the camera{fault}")
        # of slopes that bring it over the longest flap the flattest is lowest
        reach = self.length[1] * (1 - self.target[0]) / CAMERA_DISTANCE
        over = max(least, math.acos(min(1.0, reach)))
        if over <= most and CAMERA_DISTANCE * math.sin(over) <= self.height[1]:
            raise refusal(
                f".slope = {brief(self.slope)}: from {over:.3g} rad the camera may be inside a flap that is "
                f"{self.length[1]:g} m long and {self.height[1]:g} m high"
            )
        return self


def sample_scene(rng: np.random.Generator, ranges: SceneRanges | None = None) -> Scene:
    """Random flap with irregular oval veins; the same rng state gives the same scene.

    NumPy's default generators, PCG64, are drawn from; another one seeds a PCG64, which is drawn from. Raises
    SceneError if the ranges lead to values that no scene may have, or to veins without room.
    """
    from retract_env.scene import flaps, pcg64  # compiled: the ranges alone are imported without numba

    ranges = ranges or SceneRanges()
    state, (scalars, vertices, offsets, moduli) = pcg64.state_of(rng), flaps.room(ranges.veins[1])
    count, placed = flaps.draw_flap(state, flaps.table(ranges), scalars, vertices, offsets, moduli)
    pcg64.give_back(rng, state)
    flap = dict(zip(flaps.SCALARS, scalars.tolist(), strict=True))
    line = LineOfSight.at(flap["target_x"], flap["slope"])
    if placed < count:
        size = f"{flap['length']:g} x {flap['height']:g} m"
        raise SceneError(
            f"no room for vein {placed + 1} of {count} in a flap of {size}, or it would be too thin"
        )
    points, ends = [(x, y) for x, y in vertices.tolist()], offsets.tolist()
    tissue = Tissue(
        length=flap["length"],
        height=flap["height"],
        depth=flap["depth"],
        density=DENSITY,
        modulus=flap["modulus"],
        poisson=POISSON,
        veins=tuple(
            Vein(outline=tuple(points[ends[v] : ends[v + 1]]), modulus=modulus, poisson=POISSON)
            for v, modulus in enumerate(moduli[:count].tolist())
        ),
    )
    return Scene(name="sampled", tissue=tissue, line_of_sight=line)
