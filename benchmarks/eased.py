"""Fits the table that `eased` begins its search with: python -m benchmarks.eased.

For each goal radius of the table, lines of sight with that radius are drawn on random flaps, by seeds from 0.
On each the eased path is tried on the coarse mesh from grasps along the flap, each closed until it needs the
share of the friction limit that `eased` aims for. Printed are the medians over the flaps of the grasp that
strains the tissue least and of its compression, beside the values in planners/eased.py, and what the tissue
strains more with those than with the best grasp of each flap.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks._report import machine, progress, table
from planners.certify import Trial
from planners.eased import BOUNDS, FIRST, INCREMENTS, PLACES, RADII, SEARCHED_ON, SHARE, eased
from planners.light_grip import Outcome, least_compression
from planners.paths import goal_radius
from retract_env.grasp import Grasp
from retract_env.scene import LineOfSight, Scene, sample_scene
from retract_env.scene.sampling import SceneRanges

NEAREST, FARTHEST = 0.25, 0.85
"""Grasps that are tried, over the length from the fixed end."""
STEP = 0.05
"""From one of them to the next."""


class Held(NamedTuple):
    """A grasp that holds with the friction aimed for."""

    place: float
    """from the fixed end, over the length"""
    compression: float
    """over the height"""
    strain: float


def scene_with(radius: float, seed: int) -> Scene:
    """A random flap and a random line of sight with this goal radius, over the length."""
    rng, ranges = np.random.default_rng(seed), SceneRanges()
    scene = sample_scene(rng, ranges)
    length = scene.tissue.length
    # a circle that touches the bed at the origin and a line of that slope through B: b = R tan(slope / 2)
    least, most = (2 * math.atan(part / radius) for part in ranges.target)
    slope = rng.uniform(max(least, ranges.slope[0]), min(most, ranges.slope[1]))
    line = LineOfSight.at(-length * radius * math.tan(slope / 2), slope)
    assert math.isclose(goal_radius(line.camera, line.target), radius * length, rel_tol=1e-9)
    return scene.model_copy(update={"line_of_sight": line})


def held_at(scene: Scene, place: float, first: float) -> Held | None:
    """The lightest grip that holds at a place, both as in Held; None where there is none."""
    length, height = scene.tissue.length, scene.tissue.height
    strains: dict[float, float] = {}

    def attempt(delta: float) -> Outcome:
        grasp = Grasp(-place * length, delta)
        trial = Trial(scene, grasp, eased(scene, grasp, INCREMENTS), SEARCHED_ON)
        trial.squeeze()
        trial.move()
        strains[delta] = trial.max_strain
        return Outcome(trial.required_friction, str(trial.reason))

    allowed = SHARE * scene.limits.friction
    delta, reason = least_compression(attempt, first * height, BOUNDS[1] * height, allowed)
    return Held(place, delta / height, strains[delta]) if reason == "ok" else None


def all_held(scene: Scene) -> list[Held]:
    """Grips that hold, from the fixed end on; each search begins with what held at the place before."""
    held: list[Held] = []
    for place in np.arange(NEAREST, FARTHEST + STEP / 2, STEP).tolist():
        found = held_at(scene, place, held[-1].compression if held else BOUNDS[1] / 2)
        held += [found] if found else []
    return held


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=12, help="for each radius (default: %(default)s)")
    parser.add_argument("--radii", type=float, nargs="+", default=RADII, help="default: those of the table")
    options = parser.parse_args(arguments)
    rows: list[tuple[object, ...]] = []
    for radius in options.radii:
        best, more = [], []
        place, first = (float(np.interp(radius, RADII, values)) for values in (PLACES, FIRST))
        for seed in range(options.flaps):
            progress(f"radius {radius:g}, flap {seed}")
            scene = scene_with(radius, seed)
            held = all_held(scene)
            if held:
                best.append(min(held, key=lambda h: h.strain))
                present = held_at(scene, place, first)
                more.append(present.strain / best[-1].strain - 1 if present else math.nan)
        if not best:
            rows.append((radius, f"0 of {options.flaps}", "", f"{place:.2f}", "", f"{first:.3f}", ""))
            continue
        where, closed, _ = np.median(best, axis=0)
        fitted = f"{where:.2f}", f"{place:.2f}", f"{closed:.3f}", f"{first:.3f}"
        rows.append((radius, f"{len(best)} of {options.flaps}", *fitted, f"{100 * np.median(more):+.1f}"))
    print(machine())
    heads = (
        "radius",
        "flaps that hold",
        "place",
        "present",
        "compression",
        "present",
        "strain at present, %",
    )
    print(table(heads, rows))


if __name__ == "__main__":
    main()
