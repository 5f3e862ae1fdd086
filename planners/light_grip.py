"""The lightest grip that holds: the least compression that the friction limit allows, certified.

Eq. 5 closes the jaws by an energy balance that knows nothing of friction. A firmer grip strains the tissue
more and needs less friction, a lighter one the other way round, both without a turn. So for each grasp and
path there is one least compression that still holds, and it costs the least strain.

It is sought by trial: on a coarse mesh first, which costs little and is within a few per cent, then on the
mesh that certifies. What the grip needs must stay `MARGIN` below the limit, because the finite elements know
jaw forces only to within 3 % and a real grip slips without warning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from planners.certify import Trial
from planners.paths import PATHS
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Limits, Scene

MARGIN = 0.05
"""Part of the friction limit that the grip leaves unused."""
TOLERANCE = 0.02
"""The search ends once the needed friction is below what is allowed by less than this part of it."""
SEARCHED_ON = "coarse"
DOUBT = 0.1
"""Strain on that mesh, less this part, bounds the certified one from below: it is at most 6 % too high there.
And what a trial exceeds the best certified strain by before it is dropped: the next one may be lighter."""
MOST_TRIALS = 10
LIFTED = 5.0
"""Friction limit of the trials, which are to say how much is needed; the highest that a scene may have."""
FIRMEST = 0.9
"""Greatest compression, over the flap's height."""
SHUT = 1.05
"""No grip is sought between one that slips and one that breaks another limit, once they are this close."""


@dataclass(frozen=True)
class Outcome:
    """What a retraction with some compression came to."""

    friction: float
    """needed, as far as the retraction went"""
    reason: str
    """of REASONS, or "pruned" """


def least_compression(
    attempt: Callable[[float], Outcome], start: float, most: float, allowed: float
) -> tuple[float, str]:
    """Least compression, m, that needs no more friction than allowed, and "ok"; else the reason why not.

    attempt: says what becomes of a compression; start, most: m, the first and an upper bound. Friction falls
    with compression about as its inverse, so the search is a secant in logarithms, kept in its bracket; the
    compression returned with "ok" has been attempted, and holds even where the search did not close in.
    """
    aim = math.log(allowed * (1 - TOLERANCE / 2))
    loose: tuple[float, float] | None = None  # logarithms of compression and friction
    firm: tuple[float, float] | None = None
    broken, why = math.log(most), "slip"  # the firmest grip, and what a firmer one breaks
    delta = start
    for _ in range(MOST_TRIALS):
        outcome, x = attempt(delta), math.log(delta)
        torn = (
            outcome.reason == "strain" and outcome.friction > allowed
        )  # a lighter grip slips, a firmer tears
        if torn or outcome.reason in ("pruned", "not_visible"):
            return delta, outcome.reason
        y = math.log(min(max(outcome.friction, 1e-3 * allowed), 1e3 * allowed))
        if outcome.friction > allowed:
            loose = x, y
        elif outcome.reason == "ok":
            firm = x, y
            if outcome.friction >= allowed * (1 - TOLERANCE):
                return delta, "ok"
        else:
            broken, why = x, outcome.reason
        if loose and firm:
            part = (loose[1] - aim) / (loose[1] - firm[1])
            x = loose[0] + min(0.9, max(0.1, part)) * (firm[0] - loose[0])
        elif firm:
            x = firm[0] + firm[1] - aim
        elif loose:
            if broken - loose[0] < math.log(SHUT):
                return delta, why
            x = min(loose[0] + loose[1] - aim, (loose[0] + broken) / 2)
        else:
            x = broken - math.log(2)
        delta = math.exp(x)
    return (math.exp(firm[0]), "ok") if firm else (delta, why)


class LightGrip(Trial):
    """A retraction whose compression is found while it is tried; the grasp proposed is where the search
    begins.

    `squeeze` searches on the coarse mesh, `move` on the one asked for, to the certificate.
    """

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str = "fine"):
        """Raises ValueError as a Trial, and for a path of a kind that is not in PATHS."""
        super().__init__(scene, grasp, path, resolution)
        if path.kind not in PATHS:
            raise ValueError(f"path.kind = {path.kind!r}, allowed {', '.join(PATHS)}")
        self._asked = scene
        limits = Limits(strain=scene.limits.strain, friction=LIFTED)
        self._lifted = scene.model_copy(update={"limits": limits})
        self._allowed = (1 - MARGIN) * scene.limits.friction
        self._most = FIRMEST * scene.tissue.height
        self._searched = False

    def squeeze(self, on_increment: Callable[[], None] = lambda: None) -> None:
        """Find the compression on the coarse mesh; its strain there bounds from below what can be
        certified."""
        if self._searched:
            return
        trials: list[Trial] = []

        def attempt(delta: float) -> Outcome:
            self._close_by(delta)
            trial = Trial(self._lifted, self.grasp, self.path, SEARCHED_ON)
            trial.squeeze(on_increment)
            trial.move()
            trials.append(trial)
            return Outcome(trial.required_friction, str(trial.reason))

        delta, reason = least_compression(attempt, self.grasp.compression, self._most, self._allowed)
        self._close_by(delta)
        best = min(trials, key=lambda t: abs(t.grasp.compression - delta))
        self.reason = None if reason == "ok" else reason
        self.frames, self.required_friction = best.frames[-1:], best.required_friction
        self.max_strain = (1 - DOUBT) * best.max_strain
        self.physics = best.physics
        for trial in trials:
            if trial is not best and trial.physics is not None and best.physics is not None:
                for kind, seconds in trial.physics.seconds.items():
                    best.physics.seconds[kind] += seconds
        self._searched = True

    def move(
        self, bound: Callable[[], float] = lambda: math.inf, on_increment: Callable[[], None] = lambda: None
    ) -> None:
        """Find it on the mesh asked for, to the certificate; grips that strain well above the bound are
        dropped."""
        if self.ended:
            return

        def attempt(delta: float) -> Outcome:
            self._close_by(delta)
            self.limits = self._lifted.limits
            super(LightGrip, self).squeeze()
            super(LightGrip, self).move(lambda: (1 + DOUBT) * bound(), on_increment)
            return Outcome(self.required_friction, str(self.reason))

        delta, self.reason = least_compression(attempt, self.grasp.compression, self._most, self._allowed)
        if self.reason == "ok" and delta != self.grasp.compression:
            self.reason = attempt(delta).reason
        self.limits = self._asked.limits  # the certificate is to name them

    def _close_by(self, delta: float) -> None:
        self.grasp = Grasp(self.grasp.x, delta, self.grasp.score)
        self.path = PATHS[self.path.kind](self._asked, self.grasp)
