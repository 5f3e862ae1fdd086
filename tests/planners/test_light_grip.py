"""The lightest grip that holds: it meets the friction limit with its margin, and a lighter one does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import pytest

from baselines.verification.flaps import HEIGHT
from planners import plan
from planners.base import NoPlan, Plan, Verdict
from planners.certify import certify
from planners.light_grip import MARGIN, MOST_TRIALS, TOLERANCE, LightGrip, least_compression
from planners.paths import PATHS, circular, ctc
from planners.proposals import along
from planners.search import generate_and_test, race
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from tests.planners.retractions import MOTIONS, a_grasp, a_scene, poses

FRICTION = 0.5
ALLOWED = (1 - MARGIN) * FRICTION
LIGHTER = 1 - 2 * (MARGIN + TOLERANCE)
"""Friction grows at least as fast as compression falls, by more than what margin and tolerance leave."""


# --- The search, on laws


class Law:
    """Friction as a power of compression, m; limits broken by grips firmer than `torn`."""

    def __init__(self, scale: float, power: float, torn: float = math.inf, why: str = "strain"):
        self.scale, self.power, self.torn, self.why = scale, power, torn, why
        self.asked: list[float] = []

    def __call__(self, delta: float) -> Verdict:
        self.asked.append(delta)
        friction = (self.scale / delta) ** self.power
        if delta > self.torn:  # it broke before the friction was at its height
            return Verdict(self.why, required_friction=friction / 2)
        return Verdict("ok", required_friction=friction)


def searched(attempt: Callable[[float], Verdict], start: float, most: float = 4e-3) -> tuple[float, str]:
    """What the search comes to where `attempt` says what becomes of a compression."""
    search = least_compression(start, most, ALLOWED)
    delta = next(search)
    while True:
        try:
            delta = search.send(attempt(delta))
        except StopIteration as end:
            found: tuple[float, str] = end.value
            return found


@pytest.mark.parametrize("power", [0.6, 1.0, 1.4, 2.5])
@pytest.mark.parametrize("scale", [0.1e-3, 0.3e-3, 0.9e-3])
def test_the_search_ends_just_below_what_is_allowed(scale: float, power: float) -> None:
    law = Law(scale, power)
    delta, reason = searched(law, 1.1e-3)
    assert reason == "ok"
    assert law.asked[-1] == delta
    assert len(law.asked) <= MOST_TRIALS
    assert ALLOWED * (1 - TOLERANCE) <= law(delta).required_friction <= ALLOWED


@pytest.mark.parametrize(
    "after",
    [
        Verdict("not_visible", 0.1, 0.3),
        Verdict("contact", 0.1, 0.3),
        Verdict("strain", 0.6, 2 * ALLOWED),
        Verdict("diverged", progress=0.0),
        Verdict("torn", 0.2, 2 * ALLOWED),
    ],
    ids=lambda verdict: verdict.reason,
)
@pytest.mark.parametrize("start", [1.01e-3, 1.03e-3, 1.1e-3, 1.7e-3])
def test_a_grip_that_held_stands_whatever_a_lighter_one_comes_to(after: Verdict, start: float) -> None:
    """To the last bit: else one would be certified that the search has not seen."""
    verdicts = iter([Verdict("ok", 0.1, 0.5 * ALLOWED), after])
    assert searched(lambda _: next(verdicts), start) == (start, "ok")


def test_what_has_the_friction_at_once_is_tried_once() -> None:
    law = Law(ALLOWED * 1.0e-3 * (1 - TOLERANCE / 2), 1.0)
    assert searched(law, 1.0e-3) == (1.0e-3, "ok")
    assert len(law.asked) == 1


@pytest.mark.parametrize("why", ["strain", "torn", "diverged"])
def test_where_every_grip_that_holds_breaks_another_limit_it_says_which(why: str) -> None:
    law = Law(0.6e-3, 1.0, torn=1.0e-3, why=why)  # holds from 1.26 mm on
    assert searched(law, 1.1e-3)[1] == why


def test_a_grip_that_slips_and_tears_ends_the_search() -> None:
    """A lighter one slips more, a firmer one tears sooner."""
    calls = []

    def attempt(delta: float) -> Verdict:
        calls.append(delta)
        return Verdict("strain", required_friction=0.9)

    assert searched(attempt, 1.1e-3) == (1.1e-3, "strain")
    assert len(calls) == 1


@pytest.mark.parametrize("reason", ["not_visible", "pruned", "unmeshable", "too costly"])
def test_what_does_not_depend_on_the_grip_ends_the_search(reason: str) -> None:
    assert searched(lambda _: Verdict(reason, required_friction=0.2), 1e-3) == (1e-3, reason)


@pytest.mark.parametrize("reason", ["diverged", "strain"])
def test_a_flap_that_finds_no_rest_is_tried_once(reason: str) -> None:
    """However far the jaws would have closed: or its own weight tears it."""
    law = Law(0.3e-3, 1.0)

    def attempt(delta: float) -> Verdict:
        law(delta)
        return Verdict(reason, required_friction=0.0, progress=0.0)

    assert searched(attempt, 1.1e-3) == (1.1e-3, reason)
    assert len(law.asked) == 1


def test_jaws_that_pull_are_closed_further() -> None:
    law = Law(0.3e-3, 1.0)

    def attempt(delta: float) -> Verdict:
        return Verdict("release", required_friction=math.inf) if delta < 0.5e-3 else law(delta)

    delta, reason = searched(attempt, 0.2e-3)
    assert reason == "ok"
    assert delta == pytest.approx(0.3e-3 / ALLOWED, rel=TOLERANCE)


# --- On the finite elements


def scene(friction: float = FRICTION) -> Scene:
    return a_scene(friction=friction)


@cache
def lightest(kind: str, x: float = -0.03, part: float = 0.25) -> Plan:
    grasp = a_grasp(x, part)
    contestant = LightGrip(scene(), grasp, PATHS[kind](scene(), grasp))
    return race(scene(), [contestant], "light_grip", "coarse", 1)


every_path = pytest.mark.parametrize("kind", ["ctc", "circular"])


@every_path
def test_it_is_certified_with_its_margin(kind: str) -> None:
    found = lightest(kind)
    certificate = found.certificate
    assert certificate.certified
    assert ALLOWED * (1 - TOLERANCE) <= certificate.required_friction <= ALLOWED
    assert certificate.friction_limit == FRICTION
    assert certificate.scene_hash == scene().hash
    assert certify(scene(), found.grasp, found.path, "coarse").to_json() == certificate.to_json()


@every_path
def test_a_lighter_grip_slips(kind: str) -> None:
    grasp = Grasp(lightest(kind).grasp.x, LIGHTER * lightest(kind).grasp.compression)
    assert certify(scene(), grasp, PATHS[kind](scene(), grasp), "coarse").reason == "slip"


@every_path
def test_a_firmer_grip_strains_more(kind: str) -> None:
    """The paper's compression, Eq. 5, holds as well and costs strain."""
    grasp = a_grasp(lightest(kind).grasp.x)
    paper = certify(scene(), grasp, PATHS[kind](scene(), grasp), "coarse")
    assert paper.certified
    assert paper.required_friction < lightest(kind).certificate.required_friction
    assert paper.max_strain > lightest(kind).certificate.max_strain


def test_a_grasp_that_slips_by_eq_5_is_gripped_more_firmly() -> None:
    grasp = a_grasp(-0.015)
    assert certify(scene(), grasp, ctc(scene(), grasp), "coarse").reason == "slip"
    found = lightest("ctc", -0.015)
    assert found.certificate.certified
    assert found.grasp.compression > grasp.compression


def test_a_grasp_without_a_grip_says_why() -> None:
    """So near to the fixed end the flap is bent so sharply that, held, it is strained too much."""
    with pytest.raises(NoPlan, match="1 candidates: 1 strain") as none:
        lightest("ctc", -0.008)
    (candidate,) = none.value.candidates
    assert candidate.max_strain > 0 and candidate.required_friction > 0


def test_where_it_is_searched_from_does_not_matter() -> None:
    found = [lightest("ctc", -0.03, part).grasp.compression / HEIGHT for part in (0.05, 0.4)]
    assert found[0] == pytest.approx(found[1], rel=2 * TOLERANCE)


def test_it_knows_only_paths_that_it_can_make_again() -> None:
    grasp = a_grasp()
    path = poses(grasp, (-0.025, 0.01, 0.0, HEIGHT - grasp.compression))
    with pytest.raises(ValueError, match=r"path.kind = 'by hand', allowed ctc"):
        LightGrip(scene(), grasp, path)


def test_paths_of_every_kind_can_be_made_again() -> None:
    grasp = a_grasp()
    for motion in MOTIONS.values():
        path = motion(scene(), grasp)
        assert PATHS[path.kind](scene(), grasp) == path


# --- As a planner


def proposals() -> list[tuple[Grasp, JawPath]]:
    return along(scene(), [a_grasp(x) for x in (-0.02, -0.03, -0.04)], ["ctc"])


@cache
def planned(pruning: str, workers: int) -> Plan:
    contestants = [LightGrip(scene(), *proposal) for proposal in proposals()]
    return race(scene(), contestants, "light_grip", "coarse", workers, pruning=pruning)


@pytest.mark.parametrize(("pruning", "workers"), [("bound", 1), ("squeeze", 1), ("rod", 2)])
def test_the_winner_depends_neither_on_pruning_nor_on_threads(pruning: str, workers: int) -> None:
    assert planned(pruning, workers).certificate.to_json() == planned("none", 1).certificate.to_json()


def test_the_plan_holds_the_grips_that_were_found() -> None:
    found = planned("none", 1)
    assert {c.reason for c in found.candidates} == {"ok"}
    assert all(c.grasp.compression != a_grasp().compression for c in found.candidates)
    (chosen,) = (c for c in found.candidates if c.grasp is found.grasp)
    assert chosen.max_strain == min(c.max_strain for c in found.candidates)
    again = certify(scene(), found.grasp, found.path, "coarse")
    assert again.to_json() == found.certificate.to_json()


def test_it_beats_the_paper_from_the_same_grasps() -> None:
    paper = generate_and_test(scene(), proposals(), "ctc", "coarse", 1)
    assert planned("squeeze", 1).certificate.max_strain < paper.certificate.max_strain


@pytest.mark.slow
def test_it_is_a_planner_by_name() -> None:
    found = plan(scene(), "light_grip", "coarse", workers=1)
    assert found.planner == "light_grip"
    assert found.certificate.max_strain <= planned("none", 1).certificate.max_strain * (1 + TOLERANCE)
    assert circular(scene(), found.grasp) != found.path
