"""What the rod says of retractions before any mesh is made: which are hopeless, and which to try first.

All are followed on the rod at once, which takes milliseconds. How far fine finite elements are from the rod
is known (`retract_env.rod.distance`): with the margins of LEVEL, by whole flaps, of which the worst motion
counts, another flap's motions keep within each margin with a probability of at least LEVEL. That holds for
flaps and motions as those were drawn, `sample_scene`'s and the paper's kinds of paths, up to where the rod
finds a limit broken; elsewhere it is a guess. `python -m benchmarks.dismissal` counts how often a search that
relies on it has another winner than one that does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.correction import needed_friction
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.rod.distance import measured
from retract_env.rod.follow import CLEAR, STRAIN, TOUCHES
from retract_env.scene import Limits, Scene

Array = NDArray[np.float64]

LEVEL = 0.99
"""Of the margins; the highest that is measured."""
FIRMEST = 0.39
"""Compression over the height up to which the rod's grip was fitted (docs/rod.md); of firmer ones it says
nothing."""


@dataclass(frozen=True)
class Foreseen:
    """What becomes of a retraction, by the rod."""

    strain: float
    """eps_max, until the target is in view"""
    friction: float
    """that is needed until then"""
    clearance: float
    """m, where it ends"""
    holds: bool
    """whether it meets all objectives"""
    least_strain: float = 0.0
    """eps_max on finite elements is no less, but for one flap in a hundred"""
    excess: float = -math.inf
    """by how much it breaks the limit that it breaks most, as a part of it, even with the margins; negative
    where it may hold, inf where it never shows the target, or a jaw lets go"""

    @property
    def hopeless(self) -> bool:
        """Whether it breaks a limit, or never shows the target, even with the margins."""
        return self.excess > 0


NOTHING = Foreseen(math.nan, math.nan, math.nan, holds=True)
"""Of what the rod cannot follow."""


@dataclass(frozen=True)
class Margins:
    """By how much finite elements may be better than the rod."""

    strain: float
    """eps_1% is at least (1 - strain) times the rod's"""
    friction: float
    """needed friction is at least the rod's, less this"""
    clearance: float
    """over the length: at most the rod's and this"""


def margins() -> Margins:
    """Those of LEVEL, by whole flaps."""
    data = measured()
    at, found = data["levels"].index(LEVEL), data["quantiles"]["flap"]
    return Margins(
        -found["strain"]["lower"][at], -found["friction"]["lower"][at], found["clearance"]["upper"][at]
    )


def foresee(scene: Scene, proposals: Sequence[tuple[Grasp, JawPath]]) -> list[Foreseen]:
    """What the rod says of each; NOTHING of grips firmer than FIRMEST, and of tissue of another law than that
    of which distances were measured."""
    known = [
        i
        for i, (grasp, _) in enumerate(proposals)
        if scene.neo_hookean
        and (grasp.force is not None or grasp.compression <= FIRMEST * scene.tissue.height)
    ]
    out = [NOTHING] * len(proposals)
    if not known:
        return out
    chosen = [proposals[i] for i in known]
    steps = [len(path.poses) - 1 for _, path in chosen]
    poses = np.empty((len(known), max(steps), 4))
    for mine, (_, path) in zip(poses, chosen, strict=True):
        mine[: len(path.poses) - 1] = path.poses[1:]
        mine[len(path.poses) - 1 :] = path.poses[-1]
    x, force = [grasp.x for grasp, _ in chosen], [grasp.force or 0.0 for grasp, _ in chosen]
    done = Flaps(scene).follow(x, poses, scene.limits.clearance, force)
    for row, i in enumerate(known):
        reached = min(int(done.reached[row]), steps[row])
        if reached:
            whole = reached == steps[row]
            felt = done.felt[row, :reached]
            out[i] = foreseen(felt, whole, scene.tissue.length, scene.limits, margins())
    return out


def foreseen(felt: Array, whole: bool, length: float, limits: Limits, margin: Margins) -> Foreseen:
    """What follows from what the rod felt up to where it showed the target or its path ended, (t, FELT).

    whole: whether the path's last pose was reached. What counts against a retraction is felt before the
    target could be in view at the earliest: at the last pose where it is hidden even with the margin.
    Contact has no margin, and dismisses nothing.
    """
    strain, clearance = felt[:, STRAIN], felt[:, CLEAR]
    friction = needed_friction(felt)
    hidden = clearance + margin.clearance * length < limits.clearance
    surely = len(hidden) if hidden.all() else int(np.argmin(hidden))
    least_strain = (1 - margin.strain) * float(strain[:surely].max(initial=0.0))
    least_friction = float(friction[:surely].max(initial=0.0)) - margin.friction
    never = whole and surely == len(hidden)
    excess = max(least_strain / limits.strain, least_friction / limits.friction) - 1
    most, needed = float(strain.max()), float(friction.max())
    sound = needed <= limits.friction and most <= limits.strain and not (felt[:, TOUCHES] > 0).any()
    return Foreseen(
        strain=most,
        friction=needed,
        clearance=float(clearance[-1]),
        holds=bool(sound and clearance[-1] >= limits.clearance),
        least_strain=least_strain,
        excess=math.inf if never else excess,
    )
