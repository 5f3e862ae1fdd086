"""Contestants and the judge: verdicts are final, and heard; threads end together; work is bounded."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from planners import effort, search
from planners.base import Candidate, Contestant, NoPlan, Proposals, Verdict
from planners.certify import certify
from planners.eased import InTurn
from planners.effort import TooCostly
from planners.paths import ctc
from planners.search import PRUNING, race
from planners.side_by_side import Stop, Stopped, side_by_side
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from tests.planners.retractions import a_grasp, a_scene

SOON = 5.0
"""s, after which a wait has failed"""


class FakeTrial:
    """Ends as was said of its compression: with a reason and a strain."""

    outcomes: ClassVar[dict[float, tuple[str, float]]] = {}

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str):
        self.grasp, self.path = grasp, path
        self.reason: str | None = None
        self.max_strain, self.required_friction, self.clearance = 0.0, 0.1, 0.0
        self.frames = [SimpleNamespace(progress=2.0)]
        self.physics: Any = None

    @property
    def ended(self) -> bool:
        return self.reason is not None

    def squeeze(self, on_increment: Callable[[], None]) -> None:
        self.physics = SimpleNamespace(seconds={}, equilibrium=SimpleNamespace(counts={"iterations": 1}))
        on_increment()

    def move(self, bound: Callable[[], float], on_increment: Callable[[], None]) -> None:
        reason, self.max_strain = self.outcomes[self.grasp.compression]
        on_increment()
        self.reason = "pruned" if self.max_strain > bound() else reason

    def history(self) -> dict[str, list[Any]]:
        return {}

    def certificate(self) -> Any:
        assert self.reason == "ok"
        return SimpleNamespace(frames=tuple(self.frames), strain=self.max_strain)


class Scripted(Contestant):
    """Hands in grasps one after the other and notes the verdicts; `between` is called in between, and it
    withdraws in the end where it is to."""

    def __init__(
        self, *grasps: Grasp, between: Callable[[], None] = lambda: None, withdraws: Verdict | None = None
    ):
        super().__init__(grasps[0], ctc(a_scene(), grasps[0], 4))
        self.grasps, self.between, self.withdraws = grasps, between, withdraws
        self.heard: list[str] = []

    def propose(self, on_increment: Callable[[], None]) -> Proposals:
        for i, grasp in enumerate(self.grasps):
            if i:
                self.between()
            verdict = yield grasp, ctc(a_scene(), grasp, 4)
            self.heard.append(verdict.reason)
        return self.withdraws


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Grasp]:
    """Makes grasps whose retraction comes to a reason and a strain."""
    outcomes: dict[float, tuple[str, float]] = {}
    monkeypatch.setattr(FakeTrial, "outcomes", outcomes)
    monkeypatch.setattr(search, "Trial", FakeTrial)

    def grasp(reason: str, strain: float = 0.3) -> Grasp:
        made = Grasp(-0.03, 1e-4 * (1 + len(outcomes)))
        outcomes[made.compression] = reason, strain
        return made

    return grasp


# --- A verdict is published once


@pytest.mark.parametrize("pruning", PRUNING)
def test_what_is_ok_between_two_attempts_is_not_the_best(fake: Callable[..., Grasp], pruning: str) -> None:
    """A better "ok" that is taken back after another contestant ended leaves that one's certificate whole."""
    other_done = threading.Event()

    def between() -> None:
        assert other_done.wait(SOON)

    wavering = Scripted(fake("ok", 0.1), fake("slip", 0.1), between=between, withdraws=Verdict("slip"))
    steady = Scripted(fake("ok", 0.2))

    def update(candidates: Sequence[Candidate]) -> None:
        if candidates[1].status == "done":
            other_done.set()

    found = race(a_scene(), [wavering, steady], "test", "coarse", 2, update, pruning)
    assert wavering.heard == ["ok", "slip"]
    assert found.grasp == steady.grasps[0]
    certificate: Any = found.certificate
    assert certificate.frames and certificate.strain == 0.2
    assert [c.reason for c in found.candidates] == ["slip", "ok"]


@pytest.mark.parametrize("workers", [1, 2])
def test_slip_throughout_is_no_plan(fake: Callable[..., Grasp], workers: int) -> None:
    contestants = [Scripted(fake("strain"), fake("slip")) for _ in range(3)]
    with pytest.raises(NoPlan, match=r"^3 candidates: 3 slip$"):
        race(a_scene(), contestants, "test", "coarse", workers)


def test_what_was_certified_last_is_what_stands(fake: Callable[..., Grasp]) -> None:
    contestant = Scripted(fake("slip"), fake("ok", 0.2), fake("ok", 0.3), fake("slip", 0.1))
    found = race(a_scene(), [contestant], "test", "coarse", 1)
    assert contestant.heard == ["slip", "ok", "ok", "slip"]
    assert found.grasp == contestant.grasps[2]
    assert [(c.reason, c.max_strain, c.grasp) for c in found.candidates] == [("ok", 0.3, found.grasp)]


def test_who_withdraws_says_why(fake: Callable[..., Grasp]) -> None:
    """Be it from what was certified."""
    contestant = Scripted(fake("ok"), withdraws=Verdict("too near its limit", required_friction=0.49))
    with pytest.raises(NoPlan, match="1 too near its limit"):
        race(a_scene(), [contestant], "test", "coarse", 1)


@pytest.mark.parametrize(
    ("error", "reason"),
    [(MeshError("no"), "unmeshable"), (Diverged("no"), "diverged"), (TooCostly("no"), "too costly")],
)
def test_what_a_contestant_cannot_try_is_its_reason(
    fake: Callable[..., Grasp], error: Exception, reason: str
) -> None:
    class Fails(Scripted):
        def propose(self, on_increment: Callable[[], None]) -> Proposals:
            yield from ()
            raise error

    found = race(a_scene(), [Fails(fake("ok")), Scripted(fake("ok"))], "test", "coarse", 1)
    assert [c.reason for c in found.candidates] == [reason, "ok"]


def test_doubt_keeps_what_strains_a_little_more_than_the_best(fake: Callable[..., Grasp]) -> None:
    """Its next proposal may be better."""

    class Doubts(Scripted):
        doubt = 0.1

    best = Scripted(fake("ok", 0.20))
    far, near = Doubts(fake("ok", 0.23)), Doubts(fake("ok", 0.21), fake("ok", 0.19))
    found = race(a_scene(), [best, far, near], "test", "coarse", 1)
    assert found.grasp == near.grasps[1]
    assert far.heard == ["pruned"] and near.heard == ["ok", "ok"]


def test_an_earlier_search_is_listed_first_and_numbered_through(fake: Callable[..., Grasp]) -> None:
    told: list[list[int]] = []
    grasp = fake("ok")
    tried = [Candidate(i, grasp, ctc(a_scene(), grasp, 4), "done", "slip") for i in range(2)]

    def update(candidates: Sequence[Candidate]) -> None:
        told.append([c.index for c in candidates])

    found = race(a_scene(), [Scripted(grasp)], "test", "coarse", 1, update, tried=tried)
    assert [c.index for c in found.candidates] == [0, 1, 2]
    assert told and all(indices == [0, 1, 2] for indices in told)


def test_eased_grasps_are_handed_in_until_one_is_certified() -> None:
    """And the certificate is that of the plain judge."""
    scene = a_scene(friction=0.45)
    grasps = [a_grasp(-0.035, part) for part in (0.02, 0.08, 0.2)]  # the first one slips
    found = race(scene, [InTurn(scene, grasps)], "test", "coarse", 1)
    assert found.grasp == grasps[1]
    assert certify(scene, found.grasp, found.path, "coarse").to_json() == found.certificate.to_json()


# --- Threads


def test_an_interrupt_ends_searches_of_contestants_at_their_next_increment() -> None:
    class Endless(Contestant):
        def propose(self, on_increment: Callable[[], None]) -> Proposals:
            give_up = time.perf_counter() + 2 * SOON
            while time.perf_counter() < give_up:
                on_increment()
                time.sleep(1e-3)
            yield self.grasp, self.path
            return None

    def update(candidates: Sequence[Candidate]) -> None:
        if all(c.status == "squeezing" for c in candidates):
            raise KeyboardInterrupt

    contestants = [Endless(a_grasp(), ctc(a_scene(), a_grasp(), 4)) for _ in range(2)]
    before, start = set(threading.enumerate()), time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        race(a_scene(), contestants, "test", "coarse", 2, update)
    assert time.perf_counter() - start < SOON
    assert set(threading.enumerate()) == before


def test_an_interrupt_ends_a_squeeze_at_its_next_increment(monkeypatch: pytest.MonkeyPatch) -> None:
    squeezing, broken_off = threading.Event(), threading.Event()
    increments: list[int] = []

    class Slow(FakeTrial):
        def squeeze(self, on_increment: Callable[[], None]) -> None:
            squeezing.set()
            assert broken_off.wait(SOON)
            for k in range(10):
                time.sleep(0.02)
                on_increment()
                increments.append(k)

    monkeypatch.setattr(search, "Trial", Slow)

    def update(candidates: Sequence[Candidate]) -> None:
        if candidates[1].status == "squeezing" and candidates[0].status == "squeezing":
            assert squeezing.wait(SOON)
            broken_off.set()
            raise KeyboardInterrupt

    contestants = [Contestant(a_grasp(), ctc(a_scene(), a_grasp(), 4)) for _ in range(2)]
    with pytest.raises(KeyboardInterrupt):
        race(a_scene(), contestants, "test", "coarse", 2, update)
    assert len(increments) < 5


def test_the_first_error_comes_out_and_the_others_stop() -> None:
    stop, begun = Stop(), threading.Event()

    def work(item: int) -> None:
        if item == 1:
            assert begun.wait(SOON)
            raise ZeroDivisionError
        begun.set()
        give_up = time.perf_counter() + 2 * SOON
        while time.perf_counter() < give_up:
            stop()
            time.sleep(1e-3)

    start = time.perf_counter()
    with pytest.raises(ZeroDivisionError):
        side_by_side(work, range(2), 2, stop)
    assert time.perf_counter() - start < SOON
    with pytest.raises(Stopped):
        stop()


def test_an_error_comes_out_though_others_end_before_it() -> None:
    """Who stops because of it may be over first: an update says that all are to stop, then its error goes up
    through its own thread."""
    stop = Stop()

    def work(item: int) -> None:
        if item == 1:
            stop.now = True
            time.sleep(0.05)
            raise ZeroDivisionError
        while True:
            stop()
            time.sleep(1e-3)

    with pytest.raises(ZeroDivisionError):
        side_by_side(work, range(3), 3, stop)


def test_results_come_in_the_order_of_the_items() -> None:
    assert side_by_side(lambda k: k**2, range(5), 3, Stop()) == [0, 1, 4, 9, 16]


# --- Bounded work


def test_a_retraction_that_takes_too_much_work_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, grasp = a_scene(), a_grasp()
    monkeypatch.setattr(effort, "MOST_ITERATIONS", 30)
    with pytest.raises(NoPlan, match="1 candidates: 1 too costly") as none:
        race(scene, [Contestant(grasp, ctc(scene, grasp))], "test", "coarse", 1)
    (candidate,) = none.value.candidates
    assert 4 <= candidate.increments < 20 and not math.isnan(candidate.max_strain)
