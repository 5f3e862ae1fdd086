"""The task as an object: defaults are those of old, what is changed has its effect, nonsense is refused."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.env import TissueRetractEnv
from retract_env.errors import ConfigError
from retract_env.task import LOW, SLICES, RetractionTask, TaskConfig, Weights, actions, default_scene
from retract_env.task.observation import bounds
from tests.retract_env.task.test_task import measures, situation

few = settings(max_examples=40, deadline=None)
weights = st.builds(Weights, **{name: st.floats(-3, 3) for name in Weights.model_fields})


def test_the_defaults_are_those_that_policies_were_trained_with() -> None:
    config = TaskConfig()
    assert config.model_dump() == {
        "weights": {
            "exposure": 1.0,
            "clearance": 1.0,
            "strain": -0.5,
            "friction": -0.25,
            "success": 1.0,
            "failure": -1.0,
        },
        "steps": 64,
        "move": (2e-3, 2e-3, float(np.radians(6.0))),
        "compression": (0.02, 0.5),
        "grip": "compression",
        "force": (0.03, 1.0),
        "cap": 2.0,
        "limits": "end",
    }
    assert config.reward_range == (-4.5, 4.0)
    assert TaskConfig.from_data(config.model_dump(mode="json")) == config


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            {"wieghts": {}},
            r"^task\.wieghts: unknown key, did you mean weights\? known keys: weights, ",
        ),
        ({"weights": {"sucess": 1}}, r"^task\.weights\.sucess: unknown key, did you mean success\?"),
        (
            {"weights": {"strain": "much"}},
            r"^task\.weights\.strain = 'much', not a number; allowed \[-1000",
        ),
        ({"steps": 0}, r"^task\.steps = 0, allowed \[1, 100000\]$"),
        ({"steps": 1.5}, r"^task\.steps = 1\.5, not a whole number$"),
        ({"move": [2e-3, 0, 0.1]}, r"^task\.move\[1\] = 0 m, allowed \(0, 0\.05\] m$"),
        ({"move": 2e-3}, r"^task\.move = 0\.002, not a list$"),
        ({"compression": [0.5, 0.1]}, r"^task\.compression = \[0\.5, 0\.1\], allowed \[least, greatest\]$"),
        ({"cap": math.inf}, r"^task\.cap = inf limit, allowed \(1, 100\] limit$"),
        ({"limits": "never"}, r"^task\.limits = 'never', allowed end, cost$"),
        (3, r"^task = 3, not a mapping"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(data: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        TissueRetractEnv("fem", task=data)
    assert "\n" not in str(caught.value)


ways = st.lists(measures, min_size=1, max_size=6)


@few
@given(weights, st.floats(1.5, 5), st.sampled_from(["end", "cost"]), ways)
def test_no_reward_leaves_the_range_that_follows_from_the_config(
    weights: Weights, cap: float, limits: Any, steps: list[tuple[float, float, float, float]]
) -> None:
    """Of a step and of the whole episode, which ends where the task says so."""
    scene = default_scene()
    config = TaskConfig(weights=weights, cap=cap, limits=limits)
    rules = RetractionTask(scene, config)
    way = [rules.begin()]
    for made_up in steps:
        way.append(situation(scene, *made_up, before=way[-1]))
    low, high = config.reward_range
    rewards: list[float] = []
    for before, now in pairwise(way):
        outcome = rules.judge(before, now)
        rewards.append(sum(rules.reward_terms(before, now, outcome).values()))
        assert rules.info(now, None, outcome)["cost_terms"].keys() == {"strain", "friction"}
        if outcome.over:
            break
    slack = 1e-9
    assert all(low - slack <= r <= high + slack for r in [*rewards, sum(rewards)])


@few
@given(st.tuples(*[st.floats(-1, 1)] * 3).map(np.array))
def test_moves_and_grasps_follow_the_config(action: Any) -> None:
    scene = default_scene()
    config = TaskConfig(move=(1e-3, 3e-3, 0.2), compression=(0.1, 0.3))
    pose = np.array([-0.02, 0.01, 0.3, 3e-3])
    there = actions.moved(action, pose, config)
    assert there - pose == pytest.approx(np.append(action * [1e-3, 3e-3, 0.2], 0.0), abs=1e-15)
    assert actions.move_towards(there, pose, config) == pytest.approx(action, abs=1e-9)
    grasp = actions.to_grasp(action, scene, config)
    assert 0.1 * 4.4e-3 <= grasp.compression <= 0.3 * 4.4e-3
    assert actions.from_grasp(grasp, scene, config)[:2] == pytest.approx(action[:2], abs=1e-9)


# --- Limits that only cost

COSTS = TaskConfig(limits="cost")


@few
@given(ways)
def test_where_limits_cost_only_the_view_ends_an_episode(
    steps: list[tuple[float, float, float, float]],
) -> None:
    """And success is what a certifier would say of the whole way."""
    scene = default_scene()
    rules = RetractionTask(scene, COSTS)
    way = [rules.begin()]
    failed = []
    for strain, friction, clear, seen in steps:
        way.append(situation(scene, strain, friction, clear, seen, before=way[-1]))
        outcome = rules.judge(way[-2], way[-1])
        assert outcome.over == outcome.in_view == (clear >= 0)
        held = all(s <= 0.5 and f <= 0.5 for s, f, *_ in steps[: len(way) - 1])
        assert (outcome.failure == "") == held
        assert outcome.success == (held and clear >= 0)
        failed.append(rules.reward_terms(way[-2], way[-1], outcome)["failure"])
    assert failed.count(-1.0) <= 1 and set(failed) <= {0.0, -1.0}
    assert rules.stop_when is None and RetractionTask(scene).stop_when is not None


def test_the_cost_is_graded_and_finite_where_a_jaw_pulls() -> None:
    scene = default_scene()
    rules = RetractionTask(scene)
    for strain, friction, expected in (
        (0.4, 0.5, {"strain": 0.0, "friction": 0.0}),
        (0.55, 0.6, {"strain": 0.1, "friction": 0.2}),
        (9.0, math.inf, {"strain": 1.0, "friction": 1.0}),
    ):
        now = situation(scene, strain, friction, -0.01, 0.0)
        assert rules.cost_terms(now) == pytest.approx(expected)
        assert rules.cost(now) == sum(term > 0 for term in expected.values())


def test_an_episode_goes_on_after_a_broken_limit(make: Any) -> None:
    """The same actions tear the tissue at once where limits end an episode."""
    firm = np.array([0.0, 1.0, 0.0])
    env = make()
    env.reset(seed=0)
    assert env.step(firm)[2]
    env = make(task={"limits": "cost", "steps": 5, "weights": {"failure": 0}})
    env.reset(seed=0)
    total = []
    for k in range(5):
        _, _, terminated, truncated, info = env.step(firm if k == 0 else np.array([0.0, 0.5, -0.5]))
        assert (terminated, truncated) == (False, k == 4)
        assert info["failure"] == "strain" and info["cost"] >= 1 and not info["is_success"]
        assert 0 < info["cost_terms"]["strain"] <= 1
        total.append(info["reward_terms"]["failure"])
    assert total == [0] * 5


def test_the_cap_bounds_what_is_observed() -> None:
    low, high = bounds(TaskConfig(cap=7.0))
    assert np.array_equal(low, LOW)
    assert high[SLICES["strain"]] == high[SLICES["max_friction"]] == 7
    env = TissueRetractEnv("fem", task={"cap": 7})
    assert np.array_equal(env.observation_space.high, high)  # type: ignore[attr-defined]
