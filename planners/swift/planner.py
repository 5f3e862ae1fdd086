"""The rod's optimum made to hold on finite elements and on flaps as they may turn out to be: "swift".

A search on the rod begins at a few places and ends with grasps and paths that hold on a sample of what is not
known (`uncertainty` of the scene). The best one is handed in. What the judge's finite elements felt along it
more than the rod is added to the rod on all flaps, and the optimum is found again (modifier adaptation of
zeroth order, as in `planners.elastica`): until the plan that was judged is the one that the corrected rod
would choose. Where the judge refuses what is best, the runner-up is tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners import eased, paths
from planners.base import PROMISING, Candidate, Contestant, Plan, Proposals
from planners.correction import Correction, correction
from planners.leads import apart
from planners.search import OnUpdate, race
from planners.swift.program import (
    BEYOND,
    COUNT,
    GRIP,
    PART,
    PLACE,
    STRETCH,
    TIMES,
    TURN,
    Program,
    force_of,
    jaw_path,
    motion,
)
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import jaw_range
from retract_env.scenarios import PLANNERS_SEED, draws
from retract_env.scene import Scene, Uncertainty

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KIND = "swift"
SAMPLES, SEED = 1024, PLANNERS_SEED
"""Flaps as they may turn out to be on which a plan is to hold, drawn once and for all, with more of the ends
of each range than the prior has: what holds on all of these fails on few of a far larger sample."""
HARD = 96
"""Of these, so many that are nearest to failing are looked at again and again."""
WORST, NEAR = 4, 0.02
"""How many of those that fail worst join the program at a time, and how near to failing they have to be."""
ASIDE, ASIDE_EXACT = (0.0, -0.1, 0.1), (0.0, -0.05, 0.05, -0.1, 0.1, -0.2)
"""Where the search begins, over the length, from the place that `planners.eased` begins at; the second
where all is known, which takes less time."""
FIRMER = 1.5
"""Compression at first, over the one there."""
FURTHER = (1.0, 2.5)
"""Likewise where a search that has more time begins, and anywhere on the flap."""
ROUNDS, STEPS, FIRST_STEPS = 4, 10, 8
RESERVE, UNJUDGED = 0.03, 0.045
"""Friction that a plan leaves over, also on flaps of the sample: as much as finite elements need more, in one
case of a hundred, than the rod that is corrected by what they felt on the scene's own flap
(`planners.certify.robust`); and as much as they need more than the rod as it is, in one of twenty
(`retract_env.rod.distance`)."""
EXACT = 0.005
"""Likewise where all is known, as the judge has been heard."""
CLEAR = 3.5e-3
"""Clearance asked for at the end, over the flap's length: the margin of one case of a hundred, likewise."""
CLEAR_EXACT = 1e-3
"""Likewise where all is known."""
CORRECTIONS = 3
"""How often a plan is found again with what the judge felt; but for the first time only where it fails."""
UNSURE = "unsure"
"""Reason of a candidate that breaks a limit on the rod, be it on one flap of the sample alone."""
PROMISES = 1.1
"""A first plan from a further start is improved to the end if its strain is less than so many times the best
one's."""
SAME, SAME_EXACT = 0.03, 0.003
"""A plan that holds and would strain less by not more than this part is not judged again; the second where
all is known."""
NEARLY = 0.03
"""Violation that a plan may have once the judge has been heard: some of what RESERVE leaves over."""


@dataclass(frozen=True)
class Found:
    """A plan by the rod."""

    unknowns: Array
    strain: float
    violation: float
    """the greatest on all flaps that were looked at"""

    @property
    def rank(self) -> tuple[bool, float]:
        """The less, the better: whether it fails, then its strain, or by how much it fails."""
        holds = self.violation <= TOLERATED
        return not holds, self.strain if holds else self.violation


TOLERATED = 5e-3
"""Violation that counts as none."""


class Search:
    """Plans on the rod that hold on the sample."""

    def __init__(self, scene: Scene, by_force: bool = False, on_update: OnUpdate | None = None):
        """on_update: told of all places where the search began, whenever one changes."""
        self.scene, self.by_force, self.on_update = scene, by_force, on_update
        self.on_step: Callable[[], None] = lambda: None
        self.tried: list[Candidate] = []
        self.own = Flaps(scene)
        exact = scene.uncertainty == Uncertainty.none()
        self.sample = None if exact else Flaps(scene, np.sin(np.pi / 2 * draws(SAMPLES, SEED)))
        self.hard = np.zeros(0, np.int64)
        self.correction = Correction.none(len(TIMES))
        self.heard = False
        self.reserve = UNJUDGED

    def starts(self) -> list[Array]:
        """Where the search begins: eased paths from a few places."""
        place, first, (low, high) = self._usual()
        asides = ASIDE_EXACT if self.sample is None else ASIDE
        places = {float(np.clip(place - aside, low, high)) for aside in asides}
        return [self._start(at, FIRMER * first) for at in sorted(places)]

    def further_starts(self) -> Iterator[Array]:
        """Where it begins if it has more time, without end: anywhere on the flap, gripped more or less."""
        _, first, (low, high) = self._usual()
        rng = np.random.default_rng(SEED)
        while True:
            yield self._start(rng.uniform(low, high), rng.uniform(*FURTHER) * first)

    def _usual(self) -> tuple[float, float, tuple[float, float]]:
        """Place and compression that `planners.eased` begins with, and the range of places; over the length
        and the height."""
        tissue = self.scene.tissue
        radius = self._radius() / tissue.length
        place, first = (float(np.interp(radius, eased.RADII, v)) for v in (eased.PLACES, eased.FIRST))
        low, high = jaw_range(tissue.length, self.scene.jaws.width)
        return -place, first, (low / tissue.length, high / tissue.length)

    def _radius(self) -> float:
        line = self.scene.line_of_sight
        return paths.goal_radius(line.camera, line.target)

    def _start(self, at: float, compression: float) -> Array:
        tissue = self.scene.tissue
        u = np.empty(COUNT)
        u[PLACE] = at
        u[TURN] = paths.goal_turn(self.scene, -at * tissue.length)
        u[STRETCH], u[PART] = eased.STRETCH * np.array([1, 2, 3]) / 3, eased.TURN
        u[GRIP] = compression
        u[BEYOND] = 1.0, 0.0
        return u

    def ranked(self, seconds: float = 0.0) -> list[Found]:
        """Plans, as many as there are starts, the best first; that one is improved to the end.

        seconds: for how long to search, from further starts once all of those are done; the search ends
        before that if another start is likely to take longer than what is left.
        """
        begun = perf_counter()
        starts = self.starts()
        self._look_for_hard(starts[len(starts) // 2])
        first = sorted((self._begin(u) for u in starts), key=lambda f: f.rank)
        each = (perf_counter() - begun) / len(starts)
        best, others = [self._finish(first[0])], first[1:]
        further = self.further_starts()
        while perf_counter() - begun + each < seconds:
            found = self._begin(next(further))
            if found.rank < (best[0].rank[0], PROMISES * best[0].rank[1]):
                best = sorted([*best, self._finish(found)], key=lambda f: f.rank)
            else:
                others = sorted([*others, found], key=lambda f: f.rank)
        return [*best, *others][: len(starts)]

    def _begin(self, unknowns: Array) -> Found:
        """A first plan from a start."""
        self._tell("searching", unknowns)
        found = self.improve(unknowns, FIRST_STEPS, 2)
        self._tell("done", found.unknowns, found)
        return found

    def _finish(self, found: Found) -> Found:
        """A plan improved to the end."""
        self._tell("searching", found.unknowns)
        better = self.finished(found)
        self._tell("done", better.unknowns, better)
        return better

    def _tell(self, status: str, unknowns: Array, found: Found | None = None) -> None:
        """Add a candidate, or tell what became of the last one."""
        if found is None:
            self.tried.append(Candidate(len(self.tried), *self.plan_of(unknowns), status))
            self._since = perf_counter()
        else:
            last = self.tried[-1]
            last.status, (last.grasp, last.path) = status, self.plan_of(unknowns)
            last.reason = PROMISING if found.violation <= TOLERATED else UNSURE
            last.max_strain, last.seconds = found.strain, perf_counter() - self._since
        if self.on_update is not None:
            self.on_update(self.tried)

    def finished(self, found: Found) -> Found:
        """A plan improved until it holds on the whole sample; or the best of those on the way."""
        best: Found | None = None
        for _ in range(ROUNDS):
            found = self.improve(found.unknowns, radius=0.5)
            whole = self.whole(found)
            if best is None or whole.rank < best.rank:
                best = whole
            if whole.violation <= TOLERATED or whole.violation <= found.violation:
                break
            self._look_for_hard(found.unknowns)
        assert best is not None
        return best

    def _look_for_hard(self, unknowns: Array) -> None:
        """Add the flaps of the sample that are nearest to failing to those that are looked at."""
        if self.sample is not None:
            nearest = np.argsort(-self._excess(unknowns, self.sample), kind="stable")[:HARD]
            self.hard = np.union1d(self.hard, nearest)

    def _program(self, flaps: Flaps, own: bool = True) -> Program:
        """own: whether the first of the flaps is the scene's own."""
        clear = CLEAR_EXACT if self.sample is None else CLEAR
        clear += self.scene.limits.clearance / self.scene.tissue.length
        return Program(self.scene, flaps, self.reserve, clear, self.correction, own, self.by_force)

    def improve(
        self, unknowns: Array, steps: int = STEPS, rounds: int = ROUNDS, radius: float = 2.0
    ) -> Found:
        """Solve on the scene's own flap and on those hard ones of the sample that fail worst, until none of
        them fails."""
        active = self.own
        chosen: set[int] = set()
        for round_ in range(rounds):
            self.on_step()
            new = [i for i in self._failing(unknowns) if i not in chosen][:WORST]
            if round_ and not new:
                break
            if new:
                chosen.update(new)
                assert self.sample is not None
                active = active.joined(self.sample.chosen(new))
            program = self._program(active)
            unknowns = program.solve(unknowns, steps, radius if round_ == 0 else radius / 2)
        return self.look(unknowns)

    def _failing(self, unknowns: Array) -> list[int]:
        """Those of the hard flaps that fail or nearly do, the worst first."""
        if self.sample is None:
            return []
        excess = self._excess(unknowns, self.sample.chosen(self.hard))
        order = np.argsort(-excess, kind="stable")
        return [int(i) for i in self.hard[order[excess[order] > -NEAR]]]

    def _excess(self, unknowns: Array, flaps: Flaps) -> Array:
        program = self._program(flaps, own=False)
        return program.excess(program.standing(unknowns[None])[0])

    def plan_of(self, unknowns: Array) -> tuple[Grasp, JawPath]:
        """Grasp and path."""
        return jaw_path(self.scene, unknowns, KIND, self.by_force)

    def look(self, unknowns: Array) -> Found:
        """What a plan comes to on the scene's own flap and the hard ones."""
        program = self._program(self.own)
        own = program.standing(unknowns[None])[0]
        excess = float(program.excess(own)[0])
        if self.sample is not None:
            hard = self._excess(unknowns, self.sample.chosen(self.hard))
            excess = max(excess, float(hard.max(initial=-1.0)))
        return Found(unknowns, program.strain(own), max(0.0, excess))

    def whole(self, found: Found) -> Found:
        """The same on the whole sample."""
        if self.sample is None:
            return found
        excess = float(self._excess(found.unknowns, self.sample).max())
        return replace(found, violation=max(found.violation, excess))

    def hear(self, unknowns: Array, history: Mapping[str, Any] | None) -> None:
        """Correct the rod by what finite elements felt along a plan."""
        if history is None:
            return
        length = self.scene.tissue.length
        force = force_of(self.scene, unknowns[None]) if self.by_force else None
        poses = motion(self.scene, unknowns[None])
        rod = self.own.follow(unknowns[None, PLACE] * length, poses, force=force)
        found = correction(self.scene, 1 + paths.INCREMENTS * TIMES, rod.felt[0], history)
        if found is not None and not rod.lost[0]:
            if self.heard:  # or two plans that hide the target in turn would be found in turn
                found = replace(found, clearance=np.minimum(found.clearance, self.correction.clearance))
            self.correction, self.heard = found, self.sample is not None
            self.reserve = EXACT if self.sample is None else RESERVE


def best_grasps(scene: Scene, count: int) -> list[Grasp]:
    """Grasps of the best plans on the rod if all is as the scene says, the best first, at most `count`; they
    close as the jaws do at first."""
    search = Search(scene.model_copy(update={"uncertainty": Uncertainty.none()}))
    length, height = scene.tissue.length, scene.tissue.height
    grasps = [
        Grasp(float(f.unknowns[PLACE]) * length, float(f.unknowns[GRIP.start]) * height)
        for f in search.ranked()
    ]
    return apart(grasps, scene, count)


class Swift(Contestant):
    """Hands in the best plan of a search, and again with what the judge felt."""

    def __init__(self, scene: Scene, search: Search, ranked: list[Found]):
        super().__init__(*search.plan_of(ranked[0].unknowns))
        self.scene, self.search, self.ranked = scene, search, ranked

    def propose(self, on_increment: Callable[[], None]) -> Proposals:
        """The best plan, corrected; then the runner-up, should the judge refuse it."""
        self.search.on_step = on_increment
        same = SAME_EXACT if self.search.sample is None else SAME
        for found in self.ranked:
            current, certified, self.search.heard = found, False, False
            verdict = yield self.search.plan_of(current.unknowns)
            for round_ in range(CORRECTIONS):
                self.search.hear(current.unknowns, verdict.history)
                now = self.search.whole(self.search.look(current.unknowns))
                certified |= verdict.reason == "ok"
                holds = verdict.reason == "ok" and now.violation <= NEARLY
                if round_ and holds and self.search.sample is not None:
                    return None
                better = self.search.finished(now)
                if holds and better.strain > (1 - same) * now.strain:
                    return None
                current = better
                verdict = yield self.search.plan_of(current.unknowns)
            if certified or verdict.reason == "ok":
                return None
        return None


def plan_swift(
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: OnUpdate | None,
    grip: str = "position",
    time: float | None = None,
) -> Plan:
    """Search on the rod, then hand in the best until it is certified and fits. Raises NoPlan.

    grip: "position" or "force"; time: s for which to search, at least, as far as further starts fit into it.
    """
    start = perf_counter()
    search = Search(scene, grip == "force", on_update)
    ranked = search.ranked(time or 0.0)
    found = perf_counter()
    swift = Swift(scene, search, ranked)
    plan = race(scene, [swift], KIND, resolution, workers, on_update, tried=search.tried)
    timings = {**plan.timings, "search": found - start, "total": perf_counter() - start}
    return replace(plan, timings=timings)
