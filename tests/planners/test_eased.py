"""Eased retractions: nearly CTC, certified, at far less strain, by little search."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planners import NoPlan, certify, paths, plan
from planners.eased import BOUNDS, STRETCH, TURN, eased, search
from retract_env.grasp import Grasp
from retract_env.scene import LineOfSight, Scene, load_scene
from retract_env.task import default_scene

SCENES = Path(__file__).resolve().parents[2] / "configs" / "scenes"


def test_the_path_is_ctc_but_for_turn_and_stretch() -> None:
    scene = default_scene()
    grasp = Grasp(-0.03, 3e-4)
    ours, theirs = eased(scene, grasp).poses, paths.ctc(scene, grasp).poses
    assert ours[:, 2] == pytest.approx(TURN * theirs[:, 2])
    assert ours[:, 3] == pytest.approx(theirs[:, 3])
    fixed = [0.0, scene.tissue.height / 2]
    reach = np.hypot(*(ours[:, :2] - fixed).T) / np.hypot(*(theirs[:, :2] - fixed).T) - 1
    goal = paths.INCREMENTS + 1  # where an ideal flap clears the line
    assert reach[1] == 0
    assert reach[goal:] == pytest.approx(STRETCH)
    assert (np.diff(reach[1 : goal + 1]) > 0).all()


@pytest.mark.parametrize("name", ["homogeneous", "ten_veins"])
def test_it_certifies_at_less_than_half_the_strain_of_the_papers_planner(name: str) -> None:
    """Squeeze strain goes with the compression, and Eq. 5 closes the jaws several times as far."""
    scene = load_scene(SCENES / f"{name}.yaml")
    ours = plan(scene, "eased", "coarse", workers=1)
    theirs = plan(scene, "ctc", "coarse", workers=1)
    assert ours.certificate.max_strain < theirs.certificate.max_strain / 2
    assert certify(scene, ours.grasp, ours.path, "coarse").to_json() == ours.certificate.to_json()
    assert len(ours.candidates) < 6 and ours.candidates[-1].reason == "ok"


def test_the_search_stays_within_its_bounds_and_leaves_friction_over() -> None:
    scene = default_scene()
    found = search(scene)
    for candidate in found.tried:
        assert BOUNDS[0] <= candidate.grasp.compression / scene.tissue.height <= BOUNDS[1]
    assert found.holds
    for candidate in found.holds:
        assert candidate.required_friction < 0.9 * scene.limits.friction


def test_a_line_that_nothing_clears_has_no_plan() -> None:
    line = LineOfSight.at(-1e-3, np.radians(80)).model_dump(mode="json")
    scene = Scene.from_data(default_scene().dump() | {"line_of_sight": line})
    with pytest.raises(NoPlan, match=r"^\d+ candidates: "):
        plan(scene, "eased", "coarse", workers=1)


def test_every_trial_is_told_as_it_ends() -> None:
    told: list[int] = []
    found = plan(default_scene(), "eased", "coarse", workers=1, on_update=lambda c: told.append(len(c)))
    searched = len(found.candidates) - 1
    assert told[:searched] == list(range(1, searched + 1))
    assert set(told[searched:]) == {searched + 1}
