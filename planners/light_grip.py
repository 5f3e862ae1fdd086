"""The lightest grip that holds: the least compression that the friction limit allows, certified.

Eq. 5 closes the jaws by an energy balance that knows nothing of friction. A firmer grip strains the tissue
more and needs less friction, a lighter one the other way round, both without a turn. So for each grasp and
path there is one least compression that still holds, and it costs the least strain.

It is sought on the rod for places all along the flap. Where that strains least, it is sought by trial: on a
coarse mesh first, which costs little and is within a few per cent, then by handing grips to the judge, until
its verdict is that one needs just the friction allowed. What the grip needs must stay `MARGIN` below the
limit, because the finite elements know jaw forces only to within 3 % and a real grip slips without warning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import replace

from planners.base import Contestant, Proposals, Verdict, verdict_of
from planners.certify import Retraction
from planners.effort import retract
from planners.leads import lightest
from planners.paths import PATHS
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

MARGIN = 0.05
"""Part of the friction limit that the grip leaves unused."""
TOLERANCE = 0.02
"""The search ends once the needed friction is below what is allowed by less than this part of it."""
SEARCHED_ON = "coarse"
DOUBT = 0.1
"""Strain on that mesh, less this part, bounds the certified one from below: it is at most 6 % too high there.
And by what part a grip may strain more than the best certified one before it is dropped: the next one may be
lighter."""
MOST_TRIALS = 10
LIFTED = 5.0
"""Friction limit on that mesh, to see how much is needed; the highest that a scene may have."""
FIRMEST = 0.9
"""Greatest compression, over the flap's height."""
MENDABLE = ("ok", "slip", "release", "strain", "torn", "diverged")
"""Reasons that may change with the compression; others end the search."""
SHUT = 1.05
"""No grip is sought between one that slips and one that breaks another limit, once they are this close."""


PLACES = 2
"""Where it is sought by trial, of those that the rod finds."""

Compressions = Generator[float, Verdict, tuple[float, str]]


def lightest_grips(scene: Scene) -> list[Grasp]:
    """The places where the lightest grip that holds strains least on a CTC path, by the rod."""
    allowed = (1 - MARGIN) * (1 - TOLERANCE / 2) * scene.limits.friction
    return lightest(scene, PATHS["ctc"], allowed, PLACES)


def least_compression(start: float, most: float, allowed: float) -> Compressions:
    """Least compression, m, that needs no more friction than allowed, and "ok"; else the reason why not.

    Yields compressions to try, and is sent what became of each. start, most: m, the first and an upper bound.
    Friction falls with compression about as its inverse, so the search is a secant in logarithms, kept in its
    bracket; the compression returned with "ok" has been tried, and holds even where the search did not close
    in.
    """
    aim = math.log(allowed * (1 - TOLERANCE / 2))
    loose: tuple[float, float] | None = None  # logarithms of compression and friction
    firm: tuple[float, float, float] | None = None  # and the compression itself
    broken, why = math.log(most), "slip"  # the firmest grip, and what a firmer one breaks
    delta = start
    for _ in range(MOST_TRIALS):
        verdict, x = (yield delta), math.log(delta)
        friction = verdict.required_friction
        # a lighter grip slips, a firmer one strains more
        stuck = verdict.reason in ("strain", "torn") and friction > allowed
        # before the jaws have closed at all: whatever they do
        restless = verdict.reason in ("strain", "diverged") and verdict.progress == 0
        if stuck or restless or verdict.reason not in MENDABLE:
            why = verdict.reason
            break
        y = math.log(min(max(friction, 1e-3 * allowed), 1e3 * allowed))
        if friction > allowed:
            loose = x, y
        elif verdict.reason == "ok":
            firm = x, y, delta
            if friction >= allowed * (1 - TOLERANCE):
                return delta, "ok"
        else:
            broken, why = x, verdict.reason
        if loose and firm:
            part = (loose[1] - aim) / (loose[1] - firm[1])
            x = loose[0] + min(0.9, max(0.1, part)) * (firm[0] - loose[0])
        elif firm:
            x = firm[0] + firm[1] - aim
        elif loose:
            if broken - loose[0] < math.log(SHUT):
                break
            x = min(loose[0] + loose[1] - aim, (loose[0] + broken) / 2)
        else:
            x = broken - math.log(2)
        delta = math.exp(x)
    return (firm[2], "ok") if firm else (delta, why)


class LightGrip(Contestant):
    """Hands in the lightest grip that holds at a place; the compression that it begins with is where it
    searches from."""

    doubt = DOUBT

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath):
        """Raises ValueError for a path of a kind that is not in PATHS."""
        super().__init__(grasp, path)
        if path.kind not in PATHS:
            raise ValueError(f"path.kind = {path.kind!r}, allowed {', '.join(PATHS)}")
        self.scene = scene
        self._lifted = scene.limits.model_copy(update={"friction": LIFTED})
        self._allowed = (1 - MARGIN) * scene.limits.friction
        self._most = FIRMEST * scene.tissue.height

    def propose(self, on_increment: Callable[[], None]) -> Proposals:
        """Search on the coarse mesh, then from there with the judge."""
        tried: list[Retraction] = []
        grips = self._grips(self.grasp.compression)
        grasp, path = next(grips)
        while True:
            retraction = Retraction(self.scene, grasp, path, SEARCHED_ON, self._lifted)
            retract(retraction, on_increment)
            retraction.physics, retraction.frames = None, retraction.frames[-1:]
            tried.append(retraction)
            try:
                grasp, path = grips.send(verdict_of(retraction))
            except StopIteration as end:
                delta, reason = end.value
                break
        best = min(tried, key=lambda r: abs(r.grasp.compression - delta))
        if reason != "ok":
            self.grasp, self.path = best.grasp, best.path
            return verdict_of(best, reason)
        self.least_strain = (1 - DOUBT) * best.max_strain
        grips = self._grips(delta)
        grasp, path = next(grips)
        while True:
            verdict = yield grasp, path
            try:
                grasp, path = grips.send(verdict)
            except StopIteration as end:
                delta, reason = end.value
                break
        if reason == "ok" and delta != grasp.compression:
            yield self._closed_by(delta)  # the last proposal is what stands
            return None
        return None if reason == verdict.reason else replace(verdict, reason=reason)

    def _grips(self, start: float) -> Generator[tuple[Grasp, JawPath], Verdict, tuple[float, str]]:
        """`least_compression`, as grasps with their paths."""
        search = least_compression(start, self._most, self._allowed)
        delta = next(search)
        while True:
            verdict = yield self._closed_by(delta)
            try:
                delta = search.send(verdict)
            except StopIteration as end:
                found: tuple[float, str] = end.value
                return found

    def _closed_by(self, delta: float) -> tuple[Grasp, JawPath]:
        grasp = Grasp(self.grasp.x, delta, self.grasp.score)
        return grasp, PATHS[self.path.kind](self.scene, grasp)
