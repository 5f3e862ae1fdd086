"""Generate candidates, certify them side by side, keep the one with least strain. Sec. IV-A, V-D.

Three ways to go through the candidates give the same winner at different cost:

* "none": every retraction to its end;
* "bound" (the paper's): in order of the stability score; a retraction stops once its strain exceeds that of the best certified one;
* "squeeze" (ours): squeeze all candidates first, which costs little and bounds their strain from below, then retract
  best-first under the same bound; what squeezes worse than the best retraction is never moved at all.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from planners.base import Candidate, NoPlan, Plan
from planners.certify import Trial
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
) -> Plan:
    """Certify proposals, best score first, and return the certified one with least maximum strain.

    The winner does not depend on pruning or workers (default: one a core): only what exceeds the best certified strain is dropped,
    and equal strains go to the earlier candidate.
    Raises NoPlan where none is certified, ValueError for unknown pruning or workers below 1.
    """
    if pruning not in PRUNING:
        raise ValueError(f"pruning = {pruning!r}, allowed {', '.join(PRUNING)}")
    workers = _cores() if workers is None else workers
    if workers < 1:
        raise ValueError(f"workers = {workers}, allowed at least 1")
    start = time.perf_counter()
    search = _Search(scene, proposals, resolution, pruning, on_update)
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
    trial = search.trials[best]
    timings = {**search.seconds, "total": time.perf_counter() - start}
    return Plan(scene, planner, trial.grasp, trial.path, trial.certificate(), tuple(search.candidates), timings)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Search:
    """Trials side by side, and the bound that they share."""

    def __init__(self, scene: Scene, proposals: Sequence[tuple[Grasp, JawPath]], resolution: str, pruning: str, on_update: OnUpdate | None):
        self.trials = [Trial(scene, grasp, path, resolution) for grasp, path in proposals]
        self.candidates = [Candidate(i, grasp, path) for i, (grasp, path) in enumerate(proposals)]
        self.prune = pruning != "none"
        self.on_update = on_update
        self.bound = math.inf
        self.stop = False
        self.seconds: Counter[str] = Counter()
        self._lock = threading.Lock()

    def both(self, i: int) -> None:
        self.squeeze(i)
        self.move(i)

    def squeeze(self, i: int) -> None:
        trial = self.trials[i]
        self._tell(i, "squeezing")
        start = time.perf_counter()
        trial.squeeze()
        self.candidates[i].seconds += time.perf_counter() - start
        self._tell(i, "done" if trial.ended else "squeezed")
        if trial.ended:
            self._drop(i)

    def move(self, i: int) -> None:
        trial, candidate = self.trials[i], self.candidates[i]
        if trial.ended:
            return
        start, before = time.perf_counter(), candidate.seconds

        def step() -> None:
            candidate.seconds = before + time.perf_counter() - start
            self._tell(i, "moving")

        trial.move(self._limit, step)
        candidate.seconds = before + time.perf_counter() - start
        if trial.reason == "ok" and self.prune:
            with self._lock:
                self.bound = min(self.bound, trial.max_strain)
        self._tell(i, "done")
        self._drop(i)

    def best(self) -> int | None:
        certified = [i for i, trial in enumerate(self.trials) if trial.reason == "ok"]
        return min(certified, key=lambda i: (self.trials[i].max_strain, i), default=None)

    def _limit(self) -> float:
        return -math.inf if self.stop else self.bound

    def _drop(self, i: int) -> None:
        """Account for a finished trial and let go of its memory unless it may win."""
        trial = self.trials[i]
        with self._lock:
            if trial.physics is not None:
                self.seconds.update(trial.physics.seconds)
                if trial.reason != "ok":
                    trial.physics = None
                    trial.frames = trial.frames[-1:]

    def _tell(self, i: int, status: str) -> None:
        trial, candidate = self.trials[i], self.candidates[i]
        candidate.status, candidate.reason = status, trial.reason
        if trial.frames:
            candidate.max_strain, candidate.clearance = trial.max_strain, trial.clearance
            candidate.required_friction = trial.required_friction if trial.frames[-1].progress >= 1 else math.nan
            candidate.increments = max(candidate.increments, len(trial.frames) - 1)
        if self.on_update is not None:
            with self._lock:
                self.on_update(self.candidates)
