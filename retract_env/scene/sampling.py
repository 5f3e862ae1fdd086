"""Random scenes: the ranges to draw from, and veins that fit into the flap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BeforeValidator

from retract_env.config import Frozen, brief, refusal
from retract_env.errors import ConfigError, SceneError
from retract_env.scene import LineOfSight, Scene, Tissue, Vein
from retract_env.scene.veins import MIN_GAP, Outline

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
    return int(low), int(high)


Ends = Annotated[tuple[float, float], BeforeValidator(_ends)]


class SceneRanges(Frozen):
    """What `sample_scene` draws from: (least, greatest) each, uniform unless said otherwise."""

    error_type: ClassVar[type[ConfigError]] = SceneError

    veins: Annotated[tuple[int, int], BeforeValidator(_counts)] = (0, 20)
    """How many; both ends occur."""
    vein_modulus: Ends = (8e4, 4e5)
    """Pa, log-uniform, for each vein."""
    vein_width: Ends = (0.25, 0.6)
    """Along x, before tilting, as a fraction of the flap's height; shrinks where there is no room."""
    vein_height: Ends = (0.2, 0.55)
    """Along y, likewise."""
    tissue_modulus: Ends = (4e4, 4e4)
    """Pa, log-uniform."""
    length: Ends = (0.05, 0.05)
    """m."""
    height: Ends = (4.4e-3, 4.4e-3)
    """m."""
    depth: Ends = (4.4e-3, 4.4e-3)
    """m."""
    target: Ends = (0.1, 0.4)
    """Distance of B from the fixed end, as a fraction of the length."""
    slope: Ends = (math.radians(30.0), math.radians(70.0))
    """Of the line of sight, rad."""


def sample_scene(rng: np.random.Generator, ranges: SceneRanges | None = None) -> Scene:
    """Random flap with irregular oval veins; the same rng state gives the same scene.

    Raises SceneError if the ranges lead to values that no scene may have, or to veins without room.
    """
    ranges = ranges or SceneRanges()

    def uniform(ends: tuple[float, float]) -> float:
        return float(rng.uniform(*ends))

    def log_uniform(ends: tuple[float, float]) -> float:
        return float(ends[0] * (ends[1] / ends[0]) ** rng.uniform())

    length, height, depth = uniform(ranges.length), uniform(ranges.height), uniform(ranges.depth)
    modulus = log_uniform(ranges.tissue_modulus)
    line = LineOfSight.at(-length * uniform(ranges.target), uniform(ranges.slope))
    count = int(rng.integers(ranges.veins[0], ranges.veins[1], endpoint=True))
    veins = [
        Vein(outline=outline, modulus=log_uniform(ranges.vein_modulus))
        for outline in _scatter(rng, count, length, height, ranges)
    ]
    tissue = Tissue(
        length=length,
        height=height,
        depth=depth,
        density=1000.0,
        modulus=modulus,
        poisson=0.45,
        veins=tuple(veins),
    )
    return Scene(name="sampled", tissue=tissue, line_of_sight=line)


def _scatter(
    rng: np.random.Generator, count: int, length: float, height: float, ranges: SceneRanges
) -> list[Outline]:
    """Ovals at random places, twice the least gap apart from each other and from the flap's outline."""
    import shapely

    gap, tries = 2 * MIN_GAP, 300
    placed: list[Outline] = []
    polygons: list[shapely.Polygon] = []
    for _ in range(count):
        for attempt in range(tries):
            shrink = 0.85 ** (attempt // 20)
            a, b = (shrink * height * rng.uniform(*of) / 2 for of in (ranges.vein_width, ranges.vein_height))
            oval = _oval(rng, a, b)
            (left, right), (low, high) = ((min(v) - gap, max(v) + gap) for v in zip(*oval, strict=True))
            if right - left > length or high - low > height:
                continue
            x, y = rng.uniform(-length - left, -right), rng.uniform(-low, height - high)
            outline = tuple((round(px + x, 6), round(py + y, 6)) for px, py in oval)
            polygon = shapely.polygons(outline)
            if not shapely.dwithin(polygon, polygons, gap).any():
                placed.append(outline)
                polygons.append(polygon)
                break
        else:
            flap = f"a flap of {length:g} x {height:g} m"
            raise SceneError(f"no room for vein {len(placed) + 1} of {count} in {flap}")
    return sorted(placed, key=min)  # numbered from the free end


def _oval(rng: np.random.Generator, a: float, b: float) -> Outline:
    """8 to 10 vertices around the origin, semi-axes about a and b m, dented and tilted a little."""
    corners = int(rng.integers(8, 10, endpoint=True))
    angles = (rng.uniform(-0.25, 0.25, corners) + range(corners)) * (math.tau / corners)
    radii = rng.uniform(0.85, 1.0, corners)
    tilt = rng.uniform(-0.35, 0.35)
    c, s = math.cos(tilt), math.sin(tilt)
    polar = zip(angles.tolist(), radii.tolist(), strict=True)
    ring = [(a * r * math.cos(t), b * r * math.sin(t)) for t, r in polar]
    return tuple((c * x - s * y, s * x + c * y) for x, y in ring)
