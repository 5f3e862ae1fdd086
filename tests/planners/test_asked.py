"""What a planner may be asked for: a grip, a time; and what those that do not take it say."""

from __future__ import annotations

from typing import Any

import pytest

import planners
from planners import PLANNERS, plan
from planners.base import PROMISING, Candidate
from planners.swift.planner import Search
from retract_env.scene import Scene, Uncertainty, load_scene
from tests.planners.retractions import a_scene

OTHERS = [name for name in PLANNERS if name != "swift"]


@pytest.fixture(scope="module")
def known() -> Scene:
    return load_scene("homogeneous").model_copy(update={"uncertainty": Uncertainty.none()})


@pytest.mark.parametrize("name", OTHERS)
def test_other_planners_refuse_a_force_and_a_time_in_one_line(name: str) -> None:
    with pytest.raises(ValueError) as refused:
        plan(a_scene(), name, grip="force")
    assert str(refused.value) == f"grip = 'force', allowed position with planner {name!r}; any with swift"
    with pytest.raises(ValueError) as refused:
        plan(a_scene(), name, time=2.5)
    assert str(refused.value) == f"time = 2.5 s, allowed none with planner {name!r}; any with swift"
    assert planners.asked_of(name) == {}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"grip": "suction"}, "grip = 'suction', allowed position, force"),
        ({"time": 0.0}, "time = 0 s, allowed (0, 86400] s"),
        ({"time": float("nan")}, "time = nan s, allowed (0, 86400] s"),
        ({"time": 1e6}, "time = 1e+06 s, allowed (0, 86400] s"),
    ],
)
def test_what_no_planner_takes(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError) as refused:
        plan(a_scene(), **asked)
    assert str(refused.value) == said


def test_swift_is_asked_first_and_for_what_was_said_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def answer(scene: Scene, *, grip: str = "position", time: float | None = None, **rest: Any) -> Any:
        asked.append({"grip": grip, "time": time})

    monkeypatch.setitem(PLANNERS, "swift", answer)
    plan(a_scene())
    plan(a_scene(), grip="force", time=3.0)
    assert asked == [{"grip": "position", "time": None}, {"grip": "force", "time": 3.0}]


def test_with_more_time_it_searches_from_further_places_and_is_not_worse(known: Scene) -> None:
    usual, longer = Search(known), Search(known)
    at_once, later = usual.ranked(), longer.ranked(6.0)
    assert len(at_once) == len(later) == len(usual.starts())
    assert len(longer.tried) > len(usual.tried)
    assert later[0].rank <= at_once[0].rank
    assert [f.rank for f in Search(known).ranked(1e-9)] == [f.rank for f in at_once], "never less than usual"


def test_what_it_tries_is_told(known: Scene) -> None:
    told: list[list[str]] = []

    def hear(candidates: Any) -> None:
        assert all(isinstance(candidate, Candidate) for candidate in candidates)
        told.append([candidate.status for candidate in candidates])

    search = Search(known, on_update=hear)
    search.ranked()
    assert told[0] == ["searching"]
    assert told[-1] == ["done"] * (len(search.starts()) + 1)  # and the best one improved
    assert [c.index for c in search.tried] == list(range(len(search.tried)))
    assert all(c.reason == PROMISING and 0 < c.max_strain < 0.5 for c in search.tried)
