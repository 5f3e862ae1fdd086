"""How far the rod is from fine finite elements: margins that the package carries as data.

They are split-conformal quantiles. Motions that the rod was not fitted to, of random flaps, were followed by
the rod and by fine finite elements, and each gave its worst errors, over the states that the rod finds within
the limits of strain and friction. With n errors in order, the one of rank ceil((n + 1) level) is not exceeded
by the error of another motion with a probability of at least `level`, whatever the errors' distribution.

What that holds for: another motion drawn as those were, a flap of `sample_scene` with its ctc, circular,
eased or random path in equal shares. It is an average over such motions and over draws of the calibration
set; a kind of flap or path that is rare among them may fare worse. Other flaps (longer, thicker, deeper),
narrower jaws in depth, and paths that a planner has chosen because the rod likes them are not covered. Four
motions share a flap, so the level is not exact for motions; it is for whole flaps, of which the worst motion
counts: unit "flap". Each margin holds by itself; all three hold at once with at least 1 - 3 (1 - level).

The rod's numbers come from other motions, but its form was chosen with these in sight (docs/rod.md).

`python -m benchmarks.rod_distance` makes distance.json and says what share of other motions the margins
cover.
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

MEASURED = Path(__file__).with_name("distance.json")
QUANTITIES = ("strain", "friction", "clearance")
SIDES = ("upper", "lower", "two-sided")
Unit = Literal["motion", "flap"]


class Margins(NamedTuple):
    """By how much fine finite elements may be worse than the rod, all numbers positive as a rule."""

    strain: float
    """of eps_1%, greatest so far: fine is at most (1 + strain) times the rod's"""
    friction: float
    """of the required friction, greatest so far: fine is at most the rod's + friction"""
    clearance: float
    """over the flap's length: fine is at least the rod's - clearance times the length"""


@lru_cache(maxsize=1)
def measured() -> dict[str, Any]:
    """All of distance.json: `levels`, `sizes`, and for each unit, quantity and side the quantiles at the
    levels, of what fine finite elements have more than the rod."""
    data: dict[str, Any] = json.loads(MEASURED.read_text("utf-8"))
    return data


def margins(level: float, unit: Unit = "motion") -> Margins:
    """Margins that each hold for a share `level` of motions, or of flaps. Raises ValueError for another
    level."""
    data = measured()
    if level not in data["levels"]:
        raise ValueError(f"level = {level:g}, allowed {', '.join(f'{v:g}' for v in data['levels'])}")
    found, at = data["quantiles"][unit], data["levels"].index(level)
    sides = [
        found[name][side][at] for name, side in zip(QUANTITIES, ("upper", "upper", "lower"), strict=True)
    ]
    if None in sides:
        raise ValueError(f"level = {level:g}: too few {unit}s, or too many of them broken, for that level")
    return Margins(sides[0], sides[1], -sides[2])


def quantile(errors: ArrayLike, level: float) -> float:
    """What another error, drawn like these, does not exceed with probability `level`; inf if they are too
    few."""
    ordered = np.sort(np.asarray(errors, float))
    # a level such as .9 is stored a little too large or small, which must not change the rank
    rank = math.ceil((len(ordered) + 1) * level - 1e-9)
    return float(ordered[rank - 1]) if rank <= len(ordered) else math.inf
