"""Generate candidates, certify them side by side, keep the one with least strain. Sec. IV-A, V-D.

Four ways to go through the candidates give the same winner at different cost, the last one but for what the
rod's margins do not cover:

* "none": every retraction to its end;
* "bound" (the paper's): in order of the stability score; a retraction stops once its strain exceeds that of
  the best certified one;
* "squeeze" (ours): squeeze all candidates first, which costs little and bounds their strain from below, then
  retract best-first under the same bound; what squeezes worse than the best retraction is never moved at all;
* "rod" (ours): follow all on the rod first (`planners.foresight`) and certify the best by that, so that there
  is a bound before anything else is squeezed; what by the rod, less its margin, strains more than the best
  certified one is dismissed without a mesh, and so is what breaks a limit by more than the margin. Where
  nothing else is certified, one of the latter is tried after all, and the others only if it holds.

Planners that learn from verdicts enter the same race as `Contestant`s: each hands in a grasp and a path, a
plain `Trial` judges them at the scene's own limits, and the contestant hears the verdict.
"""

from __future__ import annotations

import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

from planners.base import DISMISSED, TOO_COSTLY, Candidate, Contestant, NoPlan, Plan, Verdict, verdict_of
from planners.certify import REASONS, Closed, Trial
from planners.effort import TooCostly, within_budget
from planners.foresight import NOTHING, foresee
from planners.runner import Clock, Runner, Winner
from planners.side_by_side import Stop, side_by_side
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS
from retract_env.scene import Scene
from retract_env.threads import cores

PRUNING = ("rod", "squeeze", "bound", "none")
CONFIRMING = frozenset(REASONS) - {"ok", "torn", "diverged"}
"""Reasons that confirm what the rod says of a retraction that fails; others say nothing of the motion."""
Grip = tuple[Grasp, bytes]
"""What the jaws' closing depends on: the grasp and the closed pose."""
OnUpdate = Callable[[Sequence[Candidate]], None]


def generate_and_test(
    scene: Scene,
    proposals: Sequence[tuple[Grasp, JawPath]],
    planner: str,
    resolution: str = "fine",
    workers: int | None = None,
    on_update: OnUpdate | None = None,
    pruning: str = "rod",
) -> Plan:
    """Certify proposals, best score first, and return the certified one with least maximum strain.

    Raises as `race`.
    """
    contestants = [Contestant(grasp, path) for grasp, path in proposals]
    return race(scene, contestants, planner, resolution, workers, on_update, pruning)


def race(
    scene: Scene,
    contestants: Sequence[Contestant],
    planner: str,
    resolution: str = "fine",
    workers: int | None = None,
    on_update: OnUpdate | None = None,
    pruning: str = "rod",
    tried: Sequence[Candidate] = (),
) -> Plan:
    """Judge what contestants hand in and return the certified retraction with least maximum strain.

    The winner does not depend on workers (default: one a core), nor on pruning, but for what the rod's
    margins do not cover: only what exceeds the best certified strain is dropped, and equal strains go to the
    earlier contestant. tried: candidates of an earlier search by the planner, which are listed before. Raises
    NoPlan where none is certified, ValueError for unknown pruning or resolution, workers below 1, or a
    contestant that begins off the flap.
    """
    if pruning not in PRUNING:
        raise ValueError(f"pruning = {pruning!r}, allowed {', '.join(PRUNING)}")
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}, allowed at least 1")
    if resolution not in RESOLUTIONS:
        raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(RESOLUTIONS)}")
    for contestant in contestants:
        Trial(scene, contestant.grasp, contestant.path, resolution)  # refused before any work
    workers = cores() if workers is None else workers
    start = time.perf_counter()
    under_way = _Race(scene, contestants, resolution, pruning, workers, on_update, tried)
    if pruning == "rod":
        under_way.foresee()
        for group in under_way.hopeful_first():
            side_by_side(under_way.lead_or_squeeze, group, workers, under_way.stop)
            side_by_side(under_way.move, under_way.best_first(), workers, under_way.stop)
    elif pruning == "squeeze":
        side_by_side(under_way.squeeze, range(len(contestants)), workers, under_way.stop)
        side_by_side(under_way.move, under_way.best_first(), workers, under_way.stop)
    else:
        side_by_side(under_way.both, range(len(contestants)), workers, under_way.stop)
    candidates = (*tried, *under_way.candidates)
    best = under_way.best
    if best is None:
        raise NoPlan(candidates)
    timings = {**under_way.seconds, "total": time.perf_counter() - start}
    return Plan(scene, planner, best.grasp, best.path, best.certificate, candidates, timings)


def grip_of(trial: Trial) -> Grip:
    """The grip that a trial begins with."""
    return trial.grasp, trial.path.waypoints[1].tobytes()


# --- The race


class _Race:
    """Contestants side by side, and the bound that they share.

    Verdicts are published once, in `_finish`: what is under way counts neither as best nor as bound.
    """

    def __init__(
        self,
        scene: Scene,
        contestants: Sequence[Contestant],
        resolution: str,
        pruning: str,
        workers: int,
        on_update: OnUpdate | None,
        tried: Sequence[Candidate],
    ):
        self.scene, self.resolution = scene, resolution
        self.stop = Stop()
        self.tried = tried
        self.candidates = [
            Candidate(len(tried) + i, contestant.grasp, contestant.path)
            for i, contestant in enumerate(contestants)
        ]
        self.runners = [
            Runner(contestant, candidate, self.stop)
            for contestant, candidate in zip(contestants, self.candidates, strict=True)
        ]
        self.prune = pruning != "none"
        self.on_update = on_update
        self.best: Winner | None = None
        self.bound = math.inf
        self.leader: int | None = None
        """who is being moved although others are not squeezed yet"""
        self.closed: dict[Grip, Closed] = {}
        """of those that hand in one thing only: paths that begin with the same grip close the jaws once"""
        self.spare = workers + 1
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()

    def both(self, i: int) -> None:
        self.squeeze(i)
        self.move(i)

    def best_first(self) -> list[int]:
        """Those that are squeezed, the most promising first."""
        waiting = (i for i, candidate in enumerate(self.candidates) if candidate.status == "squeezed")
        return sorted(waiting, key=lambda i: (self.runners[i].prospect, i))

    def foresee(self) -> None:
        """Follow on the rod what those hand in that hand in one thing only."""
        start = time.perf_counter()
        known = [runner for runner in self.runners if runner.contestant.is_content]
        found = foresee(self.scene, [(r.contestant.grasp, r.contestant.path) for r in known])
        for runner, foreseen in zip(known, found, strict=True):
            runner.foreseen = foreseen
        self.seconds["rod"] += time.perf_counter() - start

    def hopeful_first(self) -> Iterator[list[int]]:
        """Those that may hold, the best by the rod first. The others are dismissed; but where none of the
        former is certified, the rod's word is put to the test: that one is tried of which it is least sure.
        Should it hold, the margins do not cover this flap, and all are tried."""

        def rank(i: int) -> tuple[bool, float, int]:
            foreseen = self.runners[i].foreseen
            return not foreseen.holds, 0.0 if math.isnan(foreseen.strain) else foreseen.strain, i

        order = sorted(range(len(self.runners)), key=rank)
        yield [i for i in order if not self.runners[i].foreseen.hopeless]
        hopeless = [i for i in order if self.runners[i].foreseen.hopeless]
        hopeless.sort(key=lambda i: self.runners[i].foreseen.excess)
        while hopeless and self.best is None:
            probe = hopeless.pop(0)
            yield [probe]
            if (said := self.candidates[probe].reason) in CONFIRMING:
                break
            if said == "ok":
                yield hopeless
                return
        for i in hopeless:
            self._dismiss(i)

    def lead_or_squeeze(self, i: int) -> None:
        """Move it to its end at once where that may set the bound; else only squeeze it."""
        if self._dismissed(i):
            return
        with self._lock:
            leads = self.runners[i].foreseen is not NOTHING and self.leader is None and self.best is None
            if leads:
                self.leader = i
        if leads:
            self.both(i)
            self.leader = None
        else:
            self.squeeze(i)

    def _dismissed(self, i: int) -> bool:
        """Whether, by the rod, it strains more than the best certified one, and so was dismissed."""
        if self.runners[i].foreseen.least_strain > self.bound:
            self._dismiss(i)
            return True
        return False

    def _dismiss(self, i: int) -> None:
        foreseen = self.runners[i].foreseen
        self.runners[i].trial = None
        self._finish(i, Verdict(DISMISSED, foreseen.strain, foreseen.friction, foreseen.clearance))

    def squeeze(self, i: int) -> None:
        """Let a contestant hand in what it begins with, and close the jaws on that."""
        self._tell(i, "squeezing")
        with Clock(self.candidates[i]):
            verdict = self._next(i, None)
        if verdict is not None:
            self._finish(i, verdict)
        else:
            self._tell(i, "squeezed")
        self._let_go(i)

    def move(self, i: int) -> None:
        """Retract what a contestant handed in, and what it hands in thereafter."""
        runner = self.runners[i]
        if runner.done or self._dismissed(i):
            return
        with self._lock:  # it no longer waits: its physics is not taken
            self.candidates[i].status = "moving"
        with Clock(self.candidates[i]) as clock:

            def step() -> None:
                self.stop()
                clock.lap()
                self._tell(i, "moving")

            verdict = None
            while verdict is None:
                verdict = self._next(i, self._retracted(runner, step))
        self._finish(i, verdict)
        self._let_go(i)

    def _next(self, i: int, verdict: Verdict | None) -> Verdict | None:
        """Tell a contestant what became of its last proposal, and squeeze the one that it answers with.

        Returns the final verdict where it has no other proposal. One that knows how much it will strain at
        least is squeezed only when its turn to move comes.
        """
        runner = self.runners[i]
        while True:
            self._account(runner)
            runner.hear(verdict)
            start = time.perf_counter()
            try:
                grasp, path = next(runner.proposals) if verdict is None else runner.proposals.send(verdict)
            except StopIteration as end:
                withdrawn: Verdict | None = end.value
                return withdrawn or runner.standing(verdict)
            except MeshError:
                return runner.standing(Verdict("unmeshable"))
            except Diverged:
                return runner.standing(Verdict("diverged"))
            except TooCostly:
                return runner.standing(Verdict(TOO_COSTLY))
            finally:
                with self._lock:
                    self.seconds["proposing"] += time.perf_counter() - start
            trial = Trial(self.scene, grasp, path, self.resolution)
            runner.trial = trial
            if verdict is None and runner.contestant.least_strain > 0:
                return None
            verdict = self._squeezed(runner)
            if verdict is None:
                return None

    def _squeezed(self, runner: Runner) -> Verdict | None:
        """Close the jaws; returns the verdict where the trial ends with that.

        Where that was done already for another path, what was found is taken over, to the same bits.
        """
        trial = runner.trial
        assert trial is not None
        content = runner.contestant.is_content
        if content and (known := self.closed.get(grip_of(trial))):
            trial.close_as(known)
            return None
        try:
            trial.squeeze(within_budget(trial, self.stop))
        except MeshError:
            return Verdict("unmeshable")
        except TooCostly:
            return verdict_of(trial, TOO_COSTLY)
        if trial.ended:
            return verdict_of(trial)
        if content:  # what strains more than the best one will not go on
            self.closed[grip_of(trial)] = trial.closed(lasting=trial.max_strain <= self.bound)
        return None

    def _retracted(self, runner: Runner, step: Callable[[], None]) -> Verdict:
        trial, known, doubt = runner.trial, runner.contestant.least_strain, runner.contestant.doubt
        assert trial is not None

        def limit() -> float:
            return (1 + doubt) * self.bound

        if known > self.bound or trial.max_strain > limit():
            return verdict_of(trial, "pruned")
        if trial.physics is None:
            if runner.contestant.is_content and (known_grip := self.closed.get(grip_of(trial))):
                trial.go_on(known_grip)
            elif (ended := self._squeezed(runner)) is not None:
                return ended
        try:
            trial.move(limit, within_budget(trial, step))
        except TooCostly:
            return verdict_of(trial, TOO_COSTLY)
        return verdict_of(trial)

    def _finish(self, i: int, verdict: Verdict) -> None:
        """Publish a verdict: it is final."""
        runner = self.runners[i]
        if verdict.reason == "ok":
            assert runner.trial is not None and runner.trial.reason == "ok", "only the judge says ok"
            with self._lock:
                if self.best is None or (runner.trial.max_strain, i) < self.best.rank:
                    self.best = Winner(i, runner.trial)
                if self.prune:
                    self.bound = min(self.bound, runner.trial.max_strain)
        runner.proposals.close()
        self._tell(i, "done", verdict)

    def _account(self, runner: Runner) -> None:
        """Count the seconds of work on a trial."""
        if runner.trial is not None and runner.trial.physics is not None:
            with self._lock:
                for kind, seconds in runner.trial.physics.seconds.items():
                    self.seconds[kind] += seconds
                runner.trial.physics.seconds.clear()

    def _let_go(self, i: int) -> None:
        """Free what will hardly be needed: memory holds few factorised flaps.

        Of those that wait squeezed only the most promising ones keep their physics; should another's turn
        come the jaws are closed again, to the same bits.
        """
        self._account(self.runners[i])
        with self._lock:
            if self.runners[i].done:
                self.runners[i].trial = self.runners[i].certified = None
            waiting = [
                k
                for k, runner in enumerate(self.runners)
                if runner.candidate.status == "squeezed"
                and runner.trial is not None
                and runner.trial.physics is not None
            ]
            for k in sorted(waiting, key=lambda k: (self.runners[k].prospect, k))[self.spare :]:
                trial = self.runners[k].trial
                if trial is not None:
                    trial.physics = None

    def _tell(self, i: int, status: str, verdict: Verdict | None = None) -> None:
        """Bring a contestant's row up to date, and show all rows."""
        candidate, trial = self.candidates[i], self.runners[i].trial
        candidate.status = status
        begun = self.runners[i].contestant if trial is None else trial
        candidate.grasp, candidate.path = begun.grasp, begun.path
        if trial is not None and trial.frames:
            closed = trial.frames[-1].progress >= 1
            candidate.max_strain, candidate.clearance = trial.max_strain, trial.clearance
            candidate.required_friction = trial.required_friction if closed else math.nan
            candidate.increments = max(candidate.increments, len(trial.frames) - 1)
        elif verdict is not None:
            candidate.max_strain, candidate.clearance = verdict.max_strain, verdict.clearance
            candidate.required_friction = verdict.required_friction
        if verdict is not None:
            candidate.reason = verdict.reason
        if self.on_update is not None:
            with self._lock:
                self.stop()
                try:
                    self.on_update([*self.tried, *self.candidates])
                except BaseException:
                    self.stop.now = True  # the other threads learn of it at once
                    raise
