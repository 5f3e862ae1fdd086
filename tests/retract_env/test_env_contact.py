"""Contact and margins as the environment knows them: as the certifier does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.paths import ctc
from retract_env.env import TissueRetractEnv
from retract_env.grasp import Grasp
from retract_env.rollout import PathPolicy, rollout
from retract_env.task import RetractionTask, Situation, default_scene
from retract_env.task.config import TaskConfig


def held(task: RetractionTask, **changes: object) -> Situation:
    """The flap at rest, held and lifted out of sight, with changes to its state."""
    start = task.begin()
    state = replace(start.state, required_friction=np.zeros(2), clearance=1e-3, **changes)  # type: ignore[arg-type]
    return task.hold(start, start.section, state)


def test_tissue_that_overlaps_ends_the_episode_as_a_failure() -> None:
    task = RetractionTask(default_scene())
    fine, through = held(task), held(task, overlap=True)
    assert task.judge(task.begin(), fine).success
    outcome = task.judge(task.begin(), through)
    assert (outcome.over, outcome.success, outcome.failure) == (True, False, "contact")


def test_where_limits_only_cost_an_overlap_is_remembered() -> None:
    task = RetractionTask(default_scene(), TaskConfig(limits="cost"))
    through = held(task, overlap=True)
    later = task.hold(through, through.section, replace(through.state, overlap=False))
    outcome = task.judge(through, later)
    assert outcome.in_view and not outcome.success
    assert outcome.failure == "contact"
    assert not outcome.broke, "it broke before"


@pytest.mark.parametrize("margin", [0.0, 2e-3])
def test_an_episode_goes_on_until_the_margin_is_there(margin: float) -> None:
    scene = default_scene()
    limits = scene.limits.model_copy(update={"clearance": margin})
    scene = scene.model_copy(update={"limits": limits})
    grasp = Grasp(-0.03, 0.9e-3)
    env = TissueRetractEnv("fem", scene=scene)
    played = rollout(env, PathPolicy(scene, grasp, ctc(scene, grasp)), seed=0)
    env.close()
    assert played.success
    assert played.infos[-1]["clearance"] >= margin > played.infos[-2]["clearance"]
