"""Generate and test: one winner whatever the pruning and the threads, honest pruning, interruption."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from functools import cache
from typing import Any
from weakref import WeakSet

import pytest

import planners
from planners.base import DISMISSED, Candidate, Contestant, NoPlan, Plan
from planners.certify import certify, retraction
from planners.certify.retraction import SQUEEZE_INCREMENTS
from planners.effort import TooCostly
from planners.paths import ctc
from planners.search import PRUNING, generate_and_test, race
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import Resolution, SectionMesh, outlines, section_mesh
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene
from retract_env.spring import SpringModel
from tests.planners.retractions import a_grasp, a_scene, veined

Proposals = Sequence[tuple[Grasp, JawPath]]
PROMPTLY = 5.0
"""s, within which all threads have ended; what they were busy with would take several times as long"""


def proposals(scene: Scene, increments: int = 12) -> Proposals:
    """Light and firm grips near and far, a slipping one, and one twice."""
    places = [(-0.035, 0.20), (-0.030, 0.15), (-0.011, 0.25), (-0.030, 0.15)]
    grasps = [a_grasp(x, part) for x, part in places]
    return [(grasp, ctc(scene, grasp, increments)) for grasp in grasps]


SCENES = {"homogeneous": a_scene(friction=0.45), "veined": veined(friction=0.45)}
every_scene = pytest.mark.parametrize("name", SCENES)


@cache
def planned(name: str, pruning: str = "none", workers: int = 1) -> Plan:
    scene = SCENES[name]
    return generate_and_test(scene, proposals(scene), "test", "coarse", workers, pruning=pruning)


# --- The winner


@pytest.mark.parametrize("pruning", PRUNING)
def test_a_candidate_that_cannot_be_meshed_is_left_out(pruning: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENES["homogeneous"]
    whole = planned("homogeneous")
    unlucky = next(c.grasp.x for c in whole.candidates if c.grasp != whole.grasp)
    mesh = section_mesh

    def failing(scene: Scene, jaw_x: float, resolution: Resolution, smeared: Collection[int]) -> SectionMesh:
        if jaw_x == unlucky:
            raise MeshError("no mesh")
        return mesh(scene, jaw_x, resolution, smeared)

    monkeypatch.setattr(outlines, "section_mesh", failing)
    plan = generate_and_test(scene, proposals(scene), "test", "coarse", pruning=pruning)
    assert plan.grasp == whole.grasp
    left_out = {c.grasp.x for c in plan.candidates if c.reason == "unmeshable"}
    assert left_out == {unlucky}
    with pytest.raises(NoPlan, match="1 candidates: 1 unmeshable"):
        generate_and_test(scene, [p for p in proposals(scene) if p[0].x == unlucky], "test", "coarse")


@every_scene
def test_the_winner_is_the_certified_candidate_of_least_strain(name: str) -> None:
    plan = planned(name)
    scene, reasons = SCENES[name], [candidate.reason for candidate in plan.candidates]
    each = [certify(scene, grasp, path, "coarse") for grasp, path in proposals(scene)]
    assert reasons == [certificate.reason for certificate in each]
    assert {"ok", "slip"} == set(reasons)
    least = min(certificate.max_strain for certificate in each if certificate.certified)
    best = next(c for c in each if c.certified and c.max_strain == least)
    assert plan.certificate.to_json() == best.to_json()
    assert (plan.grasp.x, plan.grasp.compression) == (best.grasp["x"], best.grasp["compression"])
    for candidate, certificate in zip(plan.candidates, each, strict=True):
        assert candidate.status == "done"
        assert candidate.max_strain == certificate.max_strain
        assert candidate.required_friction == certificate.required_friction
        assert candidate.clearance == certificate.clearance
        assert candidate.increments == certificate.increments


@pytest.mark.parametrize("workers", [1, 2, 4])
@pytest.mark.parametrize("pruning", PRUNING)
@every_scene
def test_the_winner_depends_neither_on_pruning_nor_on_threads(name: str, pruning: str, workers: int) -> None:
    plan, reference = planned(name, pruning, workers), planned(name)
    assert plan.certificate.to_json() == reference.certificate.to_json()
    assert (plan.grasp, plan.path) == (reference.grasp, reference.path)
    (chosen,) = (candidate for candidate in plan.candidates if candidate.grasp is plan.grasp)
    assert chosen.index == 1  # of the equal two, the earlier
    assert chosen.reason == "ok"
    # what was dropped could not have won, and the rest ended as without pruning
    for candidate, whole in zip(plan.candidates, reference.candidates, strict=True):
        if candidate.reason == DISMISSED:
            assert pruning == "rod"
            assert whole.reason != "ok" or whole.max_strain > plan.certificate.max_strain
        elif candidate.reason == "pruned":
            assert pruning != "none"
            assert plan.certificate.max_strain < candidate.max_strain <= whole.max_strain
        else:
            assert candidate.reason == whole.reason
            assert candidate.max_strain == whole.max_strain


@pytest.mark.parametrize("pruning", PRUNING)
def test_the_better_of_two_that_are_close_wins(pruning: str) -> None:
    """The lighter grip squeezes to within 1 % of the other's whole strain, and is not dropped for it."""
    scene = SCENES["homogeneous"]
    trials = [(grasp, ctc(scene, grasp, 12)) for grasp in (a_grasp(-0.035, 0.25), a_grasp(-0.035, 0.2495))]
    plan = generate_and_test(scene, trials, "test", "coarse", 1, pruning=pruning)
    assert plan.grasp is trials[1][0]


@every_scene
def test_one_thread_gives_the_same_file_again(name: str) -> None:
    scene = SCENES[name]
    again = generate_and_test(scene, proposals(scene), "test", "coarse", 1)
    assert again.to_json() == planned(name, "rod").to_json()


@every_scene
def test_pruning_saves_increments_and_squeezing_first_most(name: str) -> None:
    spent = {p: sum(c.increments for c in planned(name, p).candidates) for p in PRUNING}
    assert spent["rod"] <= spent["squeeze"] < spent["bound"] < spent["none"]
    # what squeezes worse than the best retraction is never moved
    plan = planned(name, "squeeze")
    still = [c for c in plan.candidates if c.reason == "pruned" and c.increments == SQUEEZE_INCREMENTS]
    assert len(still) >= 2


def test_without_a_certified_candidate_all_are_counted() -> None:
    scene = a_scene(friction=0.05)
    for pruning in PRUNING:
        counted = "2 slip, 2 dismissed" if pruning == "rod" else "4 slip"
        with pytest.raises(NoPlan, match=f"^4 candidates: {counted}$") as error:
            generate_and_test(scene, proposals(scene), "test", "coarse", 1, pruning=pruning)
        assert {candidate.status for candidate in error.value.candidates} == {"done"}
    strict = a_scene(strain=0.2, friction=0.2)
    with pytest.raises(NoPlan, match=r"^4 candidates: 2 strain, 2 slip$") as error:
        generate_and_test(strict, proposals(strict), "test", "coarse", 1, pruning="squeeze")
    assert [c.reason for c in error.value.candidates] == ["strain", "slip", "strain", "slip"]


class Restless(Contestant):
    """Hands in what holds, and does not leave it at that."""

    def __init__(self, held: Plan, then: tuple[Grasp, JawPath] | Exception):
        super().__init__(held.grasp, held.path)
        self.then = then

    def propose(self, on_increment: Callable[[], None]) -> planners.base.Proposals:
        yield self.grasp, self.path
        if isinstance(self.then, Exception):
            raise self.then
        yield self.then
        return None


@pytest.mark.parametrize(
    "then", [Diverged("staged"), MeshError("staged"), TooCostly("staged"), proposals(a_scene())[2]], ids=repr
)
def test_what_was_certified_stands_whatever_comes_after(then: tuple[Grasp, JawPath] | Exception) -> None:
    held = planned("homogeneous")
    again = race(SCENES["homogeneous"], [Restless(held, then)], "test", "coarse", 1)
    assert again.certificate == held.certificate and again.path == held.path
    assert again.candidates[0].reason == "ok" and again.candidates[0].path == held.path


def test_nothing_to_try_is_no_plan() -> None:
    with pytest.raises(NoPlan, match=r"^0 candidates: nothing to try$"):
        generate_and_test(a_scene(), [], "test", "coarse")


def test_the_planner_by_name_tries_the_spring_models_grasps() -> None:
    scene = SCENES["veined"]
    grasps = SpringModel(scene.tissue).stable_grasps()
    plan = planners.plan(scene, "ctc", "coarse")
    assert plan.planner == "ctc"
    assert [c.grasp for c in plan.candidates] == grasps
    assert all(c.path == ctc(scene, c.grasp) for c in plan.candidates)
    assert plan.certificate.to_json() == certify(scene, plan.grasp, plan.path, "coarse").to_json()
    certified = [c.max_strain for c in plan.candidates if c.reason == "ok"]
    assert plan.certificate.max_strain == min(certified)


# --- Memory


def test_few_flaps_are_held_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one at work, the best so far, and two that wait; those let go of come back to the same bits."""
    alive: WeakSet[FemPhysics] = WeakSet()
    most = 0

    class Counted(FemPhysics):
        def __init__(self, *args: Any, **named: Any) -> None:
            super().__init__(*args, **named)
            alive.add(self)

    def count(candidates: Sequence[Candidate]) -> None:
        nonlocal most
        most = max(most, len(alive))

    monkeypatch.setattr(retraction, "FemPhysics", Counted)
    scene = SCENES["homogeneous"]
    # the best candidate squeezes hardest: all others are retracted before it, and slip
    grasps = [a_grasp(x, 0.05) for x in (-0.02, -0.024, -0.028, -0.032)] + [a_grasp(-0.03, 0.2)]
    trials = [(grasp, ctc(scene, grasp, 12)) for grasp in grasps]
    plan = generate_and_test(scene, trials, "test", "coarse", 1, count, "squeeze")
    assert 3 <= most <= 4
    assert [c.reason for c in plan.candidates] == ["slip"] * 4 + ["ok"]
    assert plan.certificate.to_json() == certify(scene, *trials[-1], "coarse").to_json()


# --- Telling how it goes


@pytest.mark.parametrize(
    ("pruning", "workers"),
    [("rod", 1), ("rod", 3), ("squeeze", 1), ("squeeze", 3), ("bound", 2), ("none", 2)],
)
def test_updates_show_every_candidate_going_forward(pruning: str, workers: int) -> None:
    order = ("waiting", "squeezing", "squeezed", "moving", "done")
    scene = SCENES["homogeneous"]
    trials = proposals(scene)
    seen = [["waiting"] for _ in trials]
    increments = [0] * len(trials)
    inside = threading.Lock()

    def watch(candidates: Sequence[Candidate]) -> None:
        assert inside.acquire(blocking=False)  # one call at a time
        try:
            for i, candidate in enumerate(candidates):
                assert candidate.index == i
                assert candidate.grasp == trials[i][0]
                if candidate.status != seen[i][-1]:
                    seen[i].append(candidate.status)
                assert candidate.reason is None or candidate.status == "done"
                assert candidate.increments >= increments[i]
                increments[i] = candidate.increments
        finally:
            inside.release()

    generate_and_test(scene, trials, "test", "coarse", workers, watch, pruning)
    for statuses in seen:
        assert [order.index(s) for s in statuses] == sorted({order.index(s) for s in statuses})
        assert statuses[0] == "waiting"
        assert pruning == "rod" or statuses[1] == "squeezing"
        assert statuses[-1] == "done"


@cache
def endless() -> Proposals:
    """Retractions that take thousands of increments."""
    scene = SCENES["homogeneous"]
    grasps = [a_grasp(-0.03 - 0.001 * i) for i in range(4)]
    return [(grasp, ctc(scene, grasp, 4_000)) for grasp in grasps]


def check_all_ends(interrupt: Callable[[Sequence[Candidate]], None], workers: int, pruning: str) -> None:
    """A KeyboardInterrupt comes out soon, and leaves no thread and no further calls behind."""
    before = set(threading.enumerate())
    called: list[float] = []

    def update(candidates: Sequence[Candidate]) -> None:
        assert not called, "called again after the interruption"
        if sum(c.status == "moving" for c in candidates) >= min(workers, 2):
            called.append(time.perf_counter())
            interrupt(candidates)

    with pytest.raises(KeyboardInterrupt):
        generate_and_test(SCENES["homogeneous"], endless(), "test", "coarse", workers, update, pruning)
    assert time.perf_counter() - called[0] < PROMPTLY
    assert set(threading.enumerate()) == before


def raise_at_once(candidates: Sequence[Candidate]) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("workers", [1, 4])
@pytest.mark.parametrize("pruning", ["rod", "squeeze", "bound"])
def test_an_interrupt_in_an_update_stops_all_threads(pruning: str, workers: int) -> None:
    check_all_ends(raise_at_once, workers, pruning)


@pytest.mark.skipif(sys.platform == "win32", reason="no signal can be sent to one's own process")
def test_ctrl_c_stops_all_threads() -> None:
    """The signal reaches the main thread, which waits for the others."""
    before = set(threading.enumerate())
    sent = math.nan

    def update(candidates: Sequence[Candidate]) -> None:
        nonlocal sent
        if math.isnan(sent) and sum(c.status == "moving" for c in candidates) == 2:
            sent = time.perf_counter()
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        generate_and_test(SCENES["homogeneous"], endless(), "test", "coarse", 2, update)
    assert time.perf_counter() - sent < PROMPTLY
    assert set(threading.enumerate()) == before


# --- What is refused


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pruning": "some"}, "pruning = 'some', allowed rod, squeeze, bound, none"),
        ({"workers": 0}, "workers = 0, allowed at least 1"),
        ({"workers": -2}, "workers = -2, allowed at least 1"),
        ({"resolution": "superb"}, "resolution = 'superb', allowed coarse, medium, fine, finer"),
    ],
)
def test_unknown_options_are_refused_before_any_work(wrong: dict[str, Any], message: str) -> None:
    scene = SCENES["homogeneous"]
    told: list[object] = []
    with pytest.raises(ValueError) as caught:
        generate_and_test(scene, proposals(scene), "test", on_update=told.append, **wrong)
    assert str(caught.value) == message
    assert told == []


def test_a_proposal_off_the_flap_is_refused_before_any_work() -> None:
    scene = SCENES["homogeneous"]
    told: list[object] = []
    wrong = (Grasp(-0.06, 1e-3), proposals(scene)[0][1])
    with pytest.raises(ValueError, match=r"^grasp\.x = -0\.06 m, allowed \[-0\.05, "):
        generate_and_test(scene, [*proposals(scene), wrong], "test", "coarse", on_update=told.append)
    assert told == []
