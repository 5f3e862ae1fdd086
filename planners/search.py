"""Generate candidates, certify them side by side, keep the one with least strain. Sec. IV-A, V-D.

Three ways to go through the candidates give the same winner at different cost:

* "none": every retraction to its end;
* "bound" (the paper's): in order of the stability score; a retraction stops once its strain exceeds that of
  the best certified one;
* "squeeze" (ours): squeeze all candidates first, which costs little and bounds their strain from below, then
  retract best-first under the same bound; what squeezes worse than the best retraction is never moved at all.

Planners that learn from verdicts enter the same race as `Contestant`s: each hands in a grasp and a path, a
plain `Trial` judges them at the scene's own limits, and the contestant hears the verdict.
"""

from __future__ import annotations

import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence

from planners.base import TOO_COSTLY, Candidate, Contestant, NoPlan, Plan, Verdict, verdict_of
from planners.certify import Certificate, Trial
from planners.effort import TooCostly, within_budget
from planners.side_by_side import Stop, side_by_side
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS
from retract_env.scene import Scene
from retract_env.threads import cores

PRUNING = ("squeeze", "bound", "none")
OnUpdate = Callable[[Sequence[Candidate]], None]


def generate_and_test(
    scene: Scene,
    proposals: Sequence[tuple[Grasp, JawPath]],
    planner: str,
    resolution: str = "fine",
    workers: int | None = None,
    on_update: OnUpdate | None = None,
    pruning: str = "squeeze",
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
    pruning: str = "squeeze",
    tried: Sequence[Candidate] = (),
) -> Plan:
    """Judge what contestants hand in and return the certified retraction with least maximum strain.

    The winner does not depend on pruning or workers (default: one a core): only what exceeds the best
    certified strain is dropped, and equal strains go to the earlier contestant. tried: candidates of an
    earlier search by the planner, which are listed before. Raises NoPlan where none is certified, ValueError
    for unknown pruning or resolution, workers below 1, or a contestant that begins off the flap.
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
    if pruning == "squeeze":
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


# --- The race


class _Winner:
    """The best certified retraction so far."""

    def __init__(self, index: int, trial: Trial):
        self.grasp, self.path = trial.grasp, trial.path
        self.certificate: Certificate = trial.certificate()
        self.rank = trial.max_strain, index


class _Runner:
    """A contestant under way, in one thread at a time."""

    def __init__(self, contestant: Contestant, candidate: Candidate, stop: Stop):
        self.contestant, self.candidate = contestant, candidate
        self.proposals = contestant.propose(stop)
        self.trial: Trial | None = None
        """of what it handed in last; None before and once it is done"""

    @property
    def done(self) -> bool:
        return self.candidate.status == "done"

    @property
    def least_strain(self) -> float:
        """What its retraction will strain at least."""
        known = self.contestant.least_strain
        return known if self.trial is None else max(known, self.trial.max_strain)


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
            _Runner(contestant, candidate, self.stop)
            for contestant, candidate in zip(contestants, self.candidates, strict=True)
        ]
        self.prune = pruning != "none"
        self.on_update = on_update
        self.best: _Winner | None = None
        self.bound = math.inf
        self.spare = workers + 1
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()

    def both(self, i: int) -> None:
        self.squeeze(i)
        self.move(i)

    def best_first(self) -> list[int]:
        return sorted(range(len(self.runners)), key=lambda i: (self.runners[i].least_strain, i))

    def squeeze(self, i: int) -> None:
        """Let a contestant hand in what it begins with, and close the jaws on that."""
        self._tell(i, "squeezing")
        with _Clock(self.candidates[i]):
            verdict = self._next(i, None)
        if verdict is not None:
            self._finish(i, verdict)
        else:
            self._tell(i, "squeezed")
        self._let_go(i)

    def move(self, i: int) -> None:
        """Retract what a contestant handed in, and what it hands in thereafter."""
        runner = self.runners[i]
        if runner.done:
            return
        with _Clock(self.candidates[i]) as clock:

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
            start = time.perf_counter()
            try:
                grasp, path = next(runner.proposals) if verdict is None else runner.proposals.send(verdict)
            except StopIteration as end:
                final = end.value if verdict is None or end.value is not None else verdict
                assert final is not None, "a contestant hands something in or says why not"
                return final
            except MeshError:
                return Verdict("unmeshable")
            except Diverged:
                return Verdict("diverged")
            except TooCostly:
                return Verdict(TOO_COSTLY)
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

    def _squeezed(self, runner: _Runner) -> Verdict | None:
        """Close the jaws; returns the verdict where the trial ends with that."""
        trial = runner.trial
        assert trial is not None
        try:
            trial.squeeze(within_budget(trial, self.stop))
        except MeshError:
            return Verdict("unmeshable")
        except TooCostly:
            return verdict_of(trial, TOO_COSTLY)
        return verdict_of(trial) if trial.ended else None

    def _retracted(self, runner: _Runner, step: Callable[[], None]) -> Verdict:
        trial, known, doubt = runner.trial, runner.contestant.least_strain, runner.contestant.doubt
        assert trial is not None

        def limit() -> float:
            return (1 + doubt) * self.bound

        if known > self.bound or trial.max_strain > limit():
            return verdict_of(trial, "pruned")
        if trial.physics is None:
            ended = self._squeezed(runner)
            if ended is not None:
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
                    self.best = _Winner(i, runner.trial)
                if self.prune:
                    self.bound = min(self.bound, runner.trial.max_strain)
        runner.proposals.close()
        self._tell(i, "done", verdict)

    def _account(self, runner: _Runner) -> None:
        """Count the seconds of work on a trial."""
        if runner.trial is not None and runner.trial.physics is not None:
            with self._lock:
                for kind, seconds in runner.trial.physics.seconds.items():
                    self.seconds[kind] += seconds
                runner.trial.physics.seconds.clear()

    def _let_go(self, i: int) -> None:
        """Free what will hardly be needed: memory holds few factorised flaps.

        Of those that wait squeezed only the most promising ones keep their physics; should another's turn
        come it is squeezed again, to the same bits.
        """
        self._account(self.runners[i])
        with self._lock:
            if self.runners[i].done:
                self.runners[i].trial = None
            waiting = [
                k
                for k, runner in enumerate(self.runners)
                if runner.candidate.status == "squeezed"
                and runner.trial is not None
                and runner.trial.physics is not None
            ]
            for k in sorted(waiting, key=lambda k: (self.runners[k].least_strain, k))[self.spare :]:
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


class _Clock:
    """Counts the seconds within it to a candidate."""

    def __init__(self, candidate: Candidate):
        self.candidate = candidate

    def __enter__(self) -> _Clock:
        self._start = time.perf_counter() - self.candidate.seconds
        return self

    def lap(self) -> None:
        self.candidate.seconds = time.perf_counter() - self._start

    def __exit__(self, *_: object) -> None:
        self.lap()
