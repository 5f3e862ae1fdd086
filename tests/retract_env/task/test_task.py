"""The task's laws: what the layout says holds, rewards add up, limits and success are the certifier's."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.env import TissueRetractEnv
from retract_env.grasp import to_jaws
from retract_env.mesh import RESOLUTIONS, section_mesh
from retract_env.objectives import verdict
from retract_env.scene import LineOfSight, Scene, load_scene, sample_scene
from retract_env.spring import SpringModel
from retract_env.task import (
    HIGH,
    LAYOUT,
    LOW,
    SIZE,
    SLICES,
    Outcome,
    RetractionTask,
    Situation,
    TaskConfig,
    Weights,
    task,
)
from retract_env.task.rest import rest_section, rest_state

SCENES = Path(__file__).resolve().parents[3] / "configs" / "scenes"
few = settings(max_examples=40, deadline=None)


def situation(
    scene: Scene, strain: float, friction: float, clear: float, seen: float, before: Situation | None = None
) -> Situation:
    """A flap at rest whose measures are made up, the jaws closed."""
    rules = RetractionTask(scene)
    section = rest_section(scene)
    state = replace(
        rest_state(scene, section),
        worst_strain=strain,
        required_friction=np.array([friction, 0.0]),
        clearance=clear,
    )
    return replace(rules.hold(before or rules.begin(), section, state), exposure=seen)


measures = st.tuples(
    st.floats(0, 3), st.one_of(st.floats(0, 3), st.just(math.inf)), st.floats(-0.2, 0.2), st.floats(0, 1)
)


# --- Observation


def test_parts_follow_one_another_and_fill_the_vector() -> None:
    ends = [part.stop for part in SLICES.values()]
    assert [part.start for part in SLICES.values()] == [0, *ends[:-1]]
    assert ends[-1] == SIZE == len(LOW) == len(HIGH)
    assert (LOW < HIGH).all()


def test_the_environments_docstring_is_the_layout() -> None:
    documented = [
        line.split("|")[1:-1] for line in (TissueRetractEnv.__doc__ or "").splitlines() if "| `" in line
    ]
    for cells, part in zip(documented, LAYOUT, strict=True):
        span = SLICES[part.name]
        numbers = str(span.start) if part.size == 1 else f"{span.start}-{span.stop - 1}"
        expected = [numbers, f"`{part.name}`", part.meaning, f"{part.low:g}", f"{part.high:g}", part.unit]
        assert [cell.strip() for cell in cells] == expected


def test_the_default_scene_is_the_one_in_configs() -> None:
    assert task.default_scene() == load_scene(SCENES / "homogeneous.yaml")


def test_a_flap_at_rest_as_it_is_observed() -> None:
    scene = load_scene(SCENES / "ten_veins.yaml")
    rules = RetractionTask(scene)
    seen = {name: rules.observation(rules.begin())[part] for name, part in SLICES.items()}
    height = scene.tissue.height / scene.tissue.length
    stations = -1 + np.arange(10) / 10
    assert seen["holding"] == 0 and seen["time_left"] == 1
    assert seen["lower"].reshape(-1, 2) == pytest.approx(np.stack([stations, 0 * stations], axis=1), abs=1e-7)
    assert seen["upper"].reshape(-1, 2)[:, 1] == pytest.approx(np.full(10, height), rel=1e-6)
    assert seen["target"] == pytest.approx(-0.25)
    assert seen["slope"] == pytest.approx(math.pi / 4)
    assert seen["nearness"] == pytest.approx(0.05 / (0.07 * math.sqrt(2)))
    assert seen["angle"].tolist() == [0, 1] and seen["separation"] == pytest.approx(1)
    assert seen["exposure"] == pytest.approx(0, abs=1e-6)
    assert seen["clearance"] == pytest.approx(-0.75 / math.sqrt(2))
    for name in ("strain", "max_strain", "friction", "max_friction"):
        assert (seen[name] == 0).all()


def test_k_eq_is_the_spring_models() -> None:
    scene = load_scene(SCENES / "twenty_veins.yaml")
    rules = RetractionTask(scene)
    x = -0.05 + 0.001 * (np.arange(50) + 0.5)
    in_units = SpringModel(scene.tissue).k_eq(x) * scene.tissue.height / scene.tissue.modulus
    assert rules.observation(rules.begin())[SLICES["k_eq"]] == pytest.approx(in_units, rel=1e-6)


@pytest.mark.parametrize("name", ["ten_veins", "wide"])
def test_keypoints_do_not_depend_on_the_mesh(name: str) -> None:
    """Any displacement that is linear in x and y is seen exactly on any mesh."""
    scene = load_scene(SCENES / f"{name}.yaml")
    rules = RetractionTask(scene)
    seen = []
    for section in (rest_section(scene), section_mesh(scene, -0.02, RESOLUTIONS["coarse"])):
        rest = rest_state(scene, section)
        state = replace(rest, points=rest.points @ np.array([[0.8, -0.5], [0.1, 1.2]]))
        seen.append(rules.observation(rules.hold(rules.begin(), section, state)))
    assert seen[0] == pytest.approx(seen[1], abs=1e-6)


@few
@given(st.integers(0, 1000), measures, st.floats(-10, 10), st.floats(-1, 1))
def test_observations_keep_their_bounds(
    seed: int, made_up: tuple[float, float, float, float], far: float, turn: float
) -> None:
    scene = sample_scene(np.random.default_rng(seed))
    rules = RetractionTask(scene)
    now = situation(scene, *made_up)
    pose = np.array([far, -far, math.pi * turn, scene.tissue.height])
    state = replace(now.state, jaws=to_jaws(pose), points=now.state.points + far)
    seen = rules.observation(replace(now, state=state, steps=64))
    assert seen.dtype == np.float32 and np.isfinite(seen).all()
    assert ((seen >= LOW) & (seen <= HIGH)).all()


# --- Reward


@few
@given(st.lists(measures, min_size=2, max_size=8))
def test_an_episodes_reward_depends_on_where_it_went_and_not_how_long(
    steps: list[tuple[float, float, float, float]],
) -> None:
    """Terms but success and failure add up to those of one step from begin to end, maxima apart."""
    scene = task.default_scene()
    rules = RetractionTask(scene)
    way = [rules.begin()]
    for made_up in steps:
        way.append(situation(scene, *made_up, before=way[-1]))
    terms = [rules.reward_terms(a, b, Outcome()) for a, b in pairwise(way)]
    total = {name: sum(t[name] for t in terms) for name in Weights.model_fields}
    worst = max(s[0] for s in steps), max(s[1] for s in steps)
    last = way[-1]
    assert total["exposure"] == pytest.approx(last.exposure, abs=1e-12)
    outset = way[0].state.clearance
    assert total["clearance"] == pytest.approx(np.clip(1 - last.state.clearance / outset, 0, 1), abs=1e-12)
    assert total["strain"] == pytest.approx(-0.5 * min(worst[0] / 0.5, TaskConfig().cap))
    assert total["friction"] == pytest.approx(-0.25 * min(worst[1] / 0.5, TaskConfig().cap))
    assert total["success"] == total["failure"] == 0


@few
@given(measures, measures)
def test_rewards_keep_their_range(
    one: tuple[float, float, float, float], other: tuple[float, float, float, float]
) -> None:
    scene = task.default_scene()
    rules = RetractionTask(scene)
    before = situation(scene, *one)
    now = situation(scene, *other, before=before)
    terms = rules.reward_terms(before, now, rules.judge(before, now))
    assert set(terms) == set(Weights.model_fields)
    low, high = TaskConfig().reward_range
    assert low <= sum(terms.values()) <= high


def test_success_pays_more_the_less_the_strain() -> None:
    scene = task.default_scene()
    rules = RetractionTask(scene)
    bonus = [
        rules.reward_terms(rules.begin(), situation(scene, strain, 0.1, 0.0, 1.0), Outcome(True, True))[
            "success"
        ]
        for strain in (0.0, 0.25, 0.5)
    ]
    assert bonus == pytest.approx([2.0, 1.5, 1.0])


def test_a_safe_success_pays_more_than_any_failure_and_failure_less_than_staying() -> None:
    scene = task.default_scene()
    rules = RetractionTask(scene)

    def total(strain: float, friction: float, clear: float, seen: float) -> float:
        now = situation(scene, strain, friction, clear, seen)
        return sum(rules.reward_terms(rules.begin(), now, rules.judge(rules.begin(), now)).values())

    worst_success = total(0.5, 0.5, 0.0, 1.0)
    best_failures = [total(0.5 + 1e-9, 0.0, 0.1, 1.0), total(0.0, 0.5 + 1e-9, 0.1, 1.0)]
    assert worst_success > max(best_failures)
    for seen in (0.0, 0.5, 1.0):
        assert total(0.4, 0.6, -0.01, seen) < total(0.4, 0.5, -0.01, seen)


# --- Limits and success


@few
@given(measures)
def test_the_verdict_is_the_certifiers(made_up: tuple[float, float, float, float]) -> None:
    scene = task.default_scene()
    rules = RetractionTask(scene)
    now = situation(scene, *made_up)
    strain, friction, clear, _ = made_up
    expected = verdict(strain, friction, clear, scene.limits.strain, scene.limits.friction)
    outcome = rules.judge(rules.begin(), now)
    assert outcome.over == (expected is not None)
    assert rules.cost(now) == (strain > 0.5) + (friction > 0.5)
    info = rules.info(now, {}, outcome)
    assert info["is_success"] == (expected == "ok")
    assert info["failure"] == ("" if expected in (None, "ok") else expected)


def test_nothing_is_judged_before_the_jaws_close() -> None:
    scene = task.default_scene()
    rules = RetractionTask(scene)
    now = replace(situation(scene, 0.9, math.inf, 0.1, 1.0), holding=False)
    assert rules.judge(now, now) == Outcome()


@pytest.mark.parametrize("field", ["points", "strain", "jaws", "reactions", "worst_strain", "clearance"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_state_that_is_no_number_is_found(field: str, value: float) -> None:
    scene = task.default_scene()
    state = rest_state(scene, rest_section(scene))
    assert task.sound(state)
    assert task.sound(replace(state, required_friction=np.array([math.inf, 0.0])))
    wrong: dict[str, Any] = {field: np.asarray(getattr(state, field)) * 0 + value}
    assert not task.sound(replace(state, **wrong))
    assert not task.sound(replace(state, required_friction=np.array([math.nan, 0.0])))


def test_the_rest_section_is_a_section_mesh() -> None:
    """Two quadratic triangles: areas add up, the boundary goes round once, counter-clockwise."""
    scene = task.default_scene()
    section = rest_section(scene)
    corners = section.corners
    edge = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = (edge[0][:, 0] * edge[1][:, 1] - edge[0][:, 1] * edge[1][:, 0]) / 2
    assert (area > 0).all() and area.sum() == pytest.approx(0.05 * 4.4e-3)
    middle = section.points[section.triangles[:, [0, 1, 2]]] + section.points[section.triangles[:, [1, 2, 0]]]
    assert section.points[section.triangles[:, 3:]] == pytest.approx(middle / 2)
    x, y = section.points[section.boundary].transpose(2, 0, 1)
    assert sorted(section.boundary[:, 0]) == [0, 2, 6, 8]
    assert (x[:, 0] * y[:, 2] - x[:, 2] * y[:, 0]).sum() / 2 == pytest.approx(0.05 * 4.4e-3)
    line = LineOfSight.at(-0.01, 1.0)
    scene = scene.model_copy(update={"line_of_sight": line})
    fine = section_mesh(scene, None, RESOLUTIONS["coarse"])
    assert rest_state(scene, fine).clearance == pytest.approx(rest_state(scene, section).clearance, rel=1e-9)
