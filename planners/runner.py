"""A contestant under way in the race, what is kept of the best one, and how long each was at work."""

from __future__ import annotations

import math
import time

from planners.base import Candidate, Contestant, Verdict, verdict_of
from planners.certify import Certificate, Trial
from planners.foresight import NOTHING
from planners.side_by_side import Stop


class Winner:
    """The best certified retraction so far."""

    def __init__(self, index: int, trial: Trial):
        self.grasp, self.path = trial.grasp, trial.path
        self.certificate: Certificate = trial.certificate()
        self.rank = trial.max_strain, index


class Runner:
    """A contestant under way, in one thread at a time."""

    def __init__(self, contestant: Contestant, candidate: Candidate, stop: Stop):
        self.contestant, self.candidate = contestant, candidate
        self.proposals = contestant.propose(stop)
        self.trial: Trial | None = None
        """of what it handed in last; None before and once it is done"""
        self.certified: Trial | None = None
        """the last that the judge passed while it went on; None once it is done"""
        self.foreseen = NOTHING

    def hear(self, verdict: Verdict | None) -> None:
        """Keep what the judge passed, should nothing that comes after it hold."""
        if verdict is not None and verdict.reason == "ok":
            self.certified = self.trial

    def standing(self, last: Verdict | None) -> Verdict:
        """The verdict with which it ends: the last, or that on what was certified before it."""
        assert last is not None, "a contestant hands something in or says why not"
        if last.reason == "ok" or self.certified is None:
            return last
        self.trial = self.certified
        return verdict_of(self.trial)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.candidate.status == "done"

    @property
    def least_strain(self) -> float:
        """What its retraction will strain at least."""
        known = max(self.contestant.least_strain, self.foreseen.least_strain)
        return known if self.trial is None else max(known, self.trial.max_strain)

    @property
    def prospect(self) -> tuple[bool, float]:
        """The less, the sooner it is moved: whether the rod finds a limit broken, and the strain as far as
        rod and finite elements know it."""
        by_rod = self.foreseen.strain
        known = self.least_strain
        return not self.foreseen.holds, known if math.isnan(by_rod) else max(by_rod, known)


class Clock:
    """Counts the seconds within it to a candidate."""

    def __init__(self, candidate: Candidate):
        self.candidate = candidate

    def __enter__(self) -> Clock:
        self._start = time.perf_counter() - self.candidate.seconds
        return self

    def lap(self) -> None:
        """Write down the time so far."""
        self.candidate.seconds = time.perf_counter() - self._start

    def __exit__(self, *_: object) -> None:
        self.lap()
