"""Generate candidates, certify them side by side, keep the one with least strain. Sec. IV-A, V-D.

Three ways to go through the candidates give the same winner at different cost:

* "none": every retraction to its end;
* "bound" (the paper's): in order of the stability score; a retraction stops once its strain exceeds that of
  the best certified one;
* "squeeze" (ours): squeeze all candidates first, which costs little and bounds their strain from below, then
  retract best-first under the same bound; what squeezes worse than the best retraction is never moved at all.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from planners.base import Candidate, NoPlan, Plan
from planners.certify import Trial
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

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
    trial: Callable[[Scene, Grasp, JawPath, str], Trial] = Trial,
) -> Plan:
    """Certify proposals, best score first, and return the certified one with least maximum strain.

    The winner does not depend on pruning or workers (default: one a core): only what exceeds the best
    certified strain is dropped, and equal strains go to the earlier candidate. trial: makes the trial of a
    proposal; one that changes the grasp while it tries it has the last word on it. Raises NoPlan where none
    is certified, ValueError for unknown pruning or workers below 1.
    """
    if pruning not in PRUNING:
        raise ValueError(f"pruning = {pruning!r}, allowed {', '.join(PRUNING)}")
    workers = cores() if workers is None else workers
    if workers < 1:
        raise ValueError(f"workers = {workers}, allowed at least 1")
    start = time.perf_counter()
    trials = [trial(scene, grasp, path, resolution) for grasp, path in proposals]
    search = _Search(trials, pruning, workers, on_update)
    with ThreadPoolExecutor(max_workers=min(workers, max(1, len(proposals)))) as pool:
        try:
            if pruning == "squeeze":
                list(pool.map(search.squeeze, range(len(proposals))))
                order = sorted(range(len(proposals)), key=lambda i: (search.trials[i].max_strain, i))
                list(pool.map(search.move, order))
            else:
                list(pool.map(search.both, range(len(proposals))))
        except BaseException:
            search.stop = True  # the other threads end at their next increment
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    best = search.best()
    if best is None:
        raise NoPlan(search.candidates)
    chosen = search.trials[best]
    timings = {**search.seconds, "total": time.perf_counter() - start}
    return Plan(
        scene, planner, chosen.grasp, chosen.path, chosen.certificate(), tuple(search.candidates), timings
    )


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Search:
    """Trials side by side, and the bound that they share."""

    def __init__(
        self,
        trials: Sequence[Trial],
        pruning: str,
        workers: int,
        on_update: OnUpdate | None,
    ):
        self.trials = trials
        self.candidates = [Candidate(i, trial.grasp, trial.path) for i, trial in enumerate(trials)]
        self.prune = pruning != "none"
        self.on_update = on_update
        self.bound = math.inf
        self.stop = False
        self.spare = workers + 1
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()

    def both(self, i: int) -> None:
        self.squeeze(i)
        self.move(i)

    def squeeze(self, i: int) -> None:
        if self.stop:
            return
        trial = self.trials[i]
        self._tell(i, "squeezing")
        start = time.perf_counter()
        try:
            trial.squeeze()
        except MeshError:
            trial.reason = "unmeshable"
        self.candidates[i].seconds += time.perf_counter() - start
        self._tell(i, "done" if trial.ended else "squeezed")
        self._let_go(i)

    def move(self, i: int) -> None:
        trial, candidate = self.trials[i], self.candidates[i]
        if trial.ended or self.stop:
            return
        if trial.max_strain > self.bound:
            trial.reason = "pruned"
        else:
            start, before = time.perf_counter(), candidate.seconds

            def step() -> None:
                candidate.seconds = before + time.perf_counter() - start
                self._tell(i, "moving")

            if trial.physics is None:
                trial.squeeze()
            trial.move(self._limit, step)
            candidate.seconds = before + time.perf_counter() - start
            if trial.reason == "ok" and self.prune:
                with self._lock:
                    self.bound = min(self.bound, trial.max_strain)
        self._tell(i, "done")
        self._let_go(i)

    def best(self) -> int | None:
        certified = [i for i, trial in enumerate(self.trials) if trial.reason == "ok"]
        return min(certified, key=lambda i: (self.trials[i].max_strain, i), default=None)

    def _limit(self) -> float:
        return -math.inf if self.stop else self.bound

    def _let_go(self, i: int) -> None:
        """Account for the work on a trial and free what will hardly be needed: memory holds few factorised
        flaps.

        Trials that ended keep their last frame, the best certified one all of them. Of those that wait
        squeezed only the most promising ones keep their physics; should another's turn come it is squeezed
        again, to the same bits.
        """
        with self._lock:
            trial = self.trials[i]
            if trial.physics is not None:
                for kind, seconds in trial.physics.seconds.items():
                    self.seconds[kind] += seconds
                trial.physics.seconds.clear()
            best = self.best()
            for k, other in enumerate(self.trials):
                if (
                    other.ended
                    and k != best
                    and other.physics is not None
                    and self.candidates[k].status == "done"
                ):
                    other.physics, other.frames = None, other.frames[-1:]
            waiting = [
                k
                for k, c in enumerate(self.candidates)
                if c.status == "squeezed" and self.trials[k].physics is not None
            ]
            for k in sorted(waiting, key=lambda k: (self.trials[k].max_strain, k))[self.spare :]:
                self.trials[k].physics = None

    def _tell(self, i: int, status: str) -> None:
        trial, candidate = self.trials[i], self.candidates[i]
        candidate.grasp, candidate.path = trial.grasp, trial.path
        candidate.status, candidate.reason = status, trial.reason if status == "done" else None
        if trial.frames:
            candidate.max_strain, candidate.clearance = trial.max_strain, trial.clearance
            candidate.required_friction = (
                trial.required_friction if trial.frames[-1].progress >= 1 else math.nan
            )
            candidate.increments = max(candidate.increments, len(trial.frames) - 1)
        if self.on_update is not None:
            with self._lock:
                if self.stop:
                    return
                try:
                    self.on_update(self.candidates)
                except BaseException:
                    self.stop = True  # whoever waits learns of it in turn, the other threads at once
                    raise
