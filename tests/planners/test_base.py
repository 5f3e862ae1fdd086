"""What planners hand in: files that come back, counted reasons, and what is refused in one line."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import pytest

from planners import PLANNERS, plan
from planners.base import Candidate, NoPlan, Plan, plan_from_json
from planners.certify import certify
from planners.paths import ctc
from planners.search import generate_and_test
from retract_env.grasp import Grasp
from tests.planners.retractions import a_grasp, a_scene, veined


@pytest.fixture(scope="module")
def best() -> Plan:
    scene = veined()
    grasps = [Grasp(x, 0.0007, score=2.0) for x in (-0.025, -0.04)]
    proposals = [(grasp, ctc(scene, grasp, 24)) for grasp in grasps]
    return generate_and_test(scene, proposals, "by hand", "coarse", workers=1, pruning="none")


@pytest.fixture
def data(best: Plan) -> Any:
    return json.loads(json.dumps(best.to_json(), allow_nan=False))


# --- Plans


def test_a_plan_read_back_is_certified_to_the_same_hash(best: Plan, data: Any) -> None:
    scene, grasp, path = plan_from_json(data)
    assert (scene, grasp, path) == (best.scene, best.grasp, best.path)
    again = certify(scene, grasp, path, data["resolution"])
    assert again.certified
    assert again.to_json()["hash"] == best.certificate.to_json()["hash"]


def test_a_plan_holds_what_was_tried_and_no_wall_clock(best: Plan, data: Any) -> None:
    assert best.timings["total"] > 0
    assert "timings" not in data
    assert "seconds" not in json.dumps(data)
    assert data["planner"] == "by hand"
    assert [c["grasp"]["x"] for c in data["candidates"]] == [-0.025, -0.04]
    assert [c["grasp"]["score"] for c in data["candidates"]] == [2.0, 2.0]
    winner = min(data["candidates"], key=lambda c: float(c["max_strain"]))
    assert winner["grasp"]["x"] == data["grasp"]["x"] == best.grasp.x
    assert winner["max_strain"] == best.certificate.max_strain


def change(data: Any, place: tuple[Any, ...], value: Any) -> Any:
    data = copy.deepcopy(data)
    spot = data
    for key in place[:-1]:
        spot = spot[key]
    if value is ...:
        del spot[place[-1]]
    else:
        spot[place[-1]] = value
    return data


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("scene",), ..., "plan: allowed is an object with scene, grasp and path"),
        (("path",), ..., "plan: allowed is an object with scene, grasp and path"),
        (("grasp",), 3, "plan.grasp: allowed is"),
        (("grasp", "x"), ..., "plan.grasp: allowed is"),
        (("grasp", "x"), "-0.02", "plan.grasp: allowed is"),
        (("grasp", "compression"), True, "plan.grasp: allowed is"),
        (("grasp", "compression"), None, "plan.grasp: allowed is"),
        (("grasp", "x"), math.nan, "grasp.x = nan m"),
        (("grasp", "x"), -(10**400), "grasp.x = -1000"),
        (("grasp", "x"), 0.02, "grasp.x = 0.02 m, allowed below 0 m"),
        (("path", "kind"), 7, "path.kind = 7"),
        (("path", "waypoints", 3), [0.0, 1.0], "path.waypoints = not numbers in equal rows"),
        (("path", "waypoints", 3, 2), "here", "path.waypoints = not numbers in equal rows"),
        (("path", "waypoints"), [], "path.waypoints has shape"),
        (("scene", "tissue", "height"), -1.0, "tissue.height = -1.0 m, allowed"),
        (("scene", "gravitas"), 9.8, "gravitas: unknown key"),
        (("speed",), 2.0, "plan.speed: unknown key"),
        (("resolutoin",), "fine", "plan.resolutoin: unknown key, did you mean resolution?"),
        (("grasp", "score"), 2.0, "plan.grasp.score: unknown key; known keys: x, compression"),
        (("path", "speed"), 2.0, "path = kind, speed, waypoints, allowed kind and waypoints"),
        (("resolution",), "ultra", "plan.resolution = 'ultra', allowed coarse, medium, fine"),
        (("resolution",), ["fine"], "plan.resolution = ['fine'], allowed coarse, medium, fine"),
        (("planner",), 7, "plan.planner = 7, allowed a text"),
        (("candidates",), "many", "plan.candidates = 'many', allowed a list of objects"),
        (("candidates", 0), 3, "allowed a list of objects"),
    ],
)
def test_what_is_no_plan_is_refused_in_one_line(
    data: Any, place: tuple[Any, ...], value: Any, message: str
) -> None:
    with pytest.raises(ValueError) as caught:
        plan_from_json(change(data, place, value))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("data", [None, 3, "plan", [], [1, 2], {}])
def test_what_is_no_object_is_refused(data: Any) -> None:
    with pytest.raises(ValueError, match="plan: allowed is an object"):
        plan_from_json(data)


# --- Candidates and their reasons


def a_candidate(reason: str | None, **measured: float) -> Candidate:
    grasp = a_grasp()
    return Candidate(0, grasp, ctc(a_scene(), grasp), reason=reason, **measured)  # type: ignore[arg-type]


def test_a_candidate_says_what_it_does_not_know() -> None:
    plain = a_candidate(None).to_json()
    assert plain["grasp"] == {"x": -0.025, "compression": 0.0011, "score": None}
    assert (plain["max_strain"], plain["required_friction"], plain["clearance"]) == (None, None, None)
    pulled = a_candidate("release", max_strain=0.3, required_friction=math.inf, clearance=-0.01).to_json()
    assert (pulled["max_strain"], pulled["required_friction"], pulled["clearance"]) == (0.3, "inf", -0.01)
    json.dumps([plain, pulled], allow_nan=False)


def test_no_plan_counts_the_reasons_most_frequent_first() -> None:
    reasons = ["slip", "strain", "not_visible", "strain", "slip", "strain"]
    error = NoPlan([a_candidate(reason) for reason in reasons])
    assert str(error) == "6 candidates: 3 strain, 2 slip, 1 not_visible"
    assert [c.reason for c in error.candidates] == reasons
    assert str(NoPlan([])) == "0 candidates: nothing to try"
    assert str(NoPlan([a_candidate("slip")], "; grip harder")) == "1 candidates: 1 slip; grip harder"


# --- Planners by name


def test_unknown_planners_are_refused_with_the_nearest_name() -> None:
    for name, ending in (("ctx", "did you mean 'ctc'?"), ("nothing alike", ", ".join(PLANNERS))):
        with pytest.raises(ValueError) as caught:
            plan(a_scene(), planner=name)
        message = str(caught.value)
        assert message.startswith(f"planner = {name!r}, allowed ctc")
        assert message.endswith(ending)
        assert len(message.splitlines()) == 1
