"""What a scene asks beyond today's defaults: a margin of clearance, a tool that does not hide the target."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.verification.flaps import HEIGHT
from planners import plan
from planners.certify import Certificate
from planners.certify.retraction import ON_TIME
from planners.paths import ctc
from retract_env.objectives import clearance
from retract_env.physics.measures import tool_outline
from retract_env.scene import Jaws, Limits, Scene, load_scene
from tests.planners.retractions import a_grasp, a_scene, judged


def certified(scene: Scene) -> Certificate:
    certificate = judged(scene, a_grasp(), ctc(scene, a_grasp()))
    assert certificate.certified
    return certificate


def asking(**limits: float) -> Scene:
    scene = a_scene()
    return scene.model_copy(update={"limits": scene.limits.model_copy(update=limits)})


@pytest.mark.parametrize("margin", [0.0, 5e-4, 2e-3])
def test_the_retraction_goes_on_until_the_margin_is_there(margin: float) -> None:
    certificate = certified(asking(clearance=margin))
    assert certificate.clearance_limit == margin
    assert margin <= certificate.clearance <= margin + ON_TIME


def test_a_margin_out_of_reach_is_not_visible_or_breaks_a_limit() -> None:
    scene = asking(clearance=0.05)
    certificate = judged(scene, a_grasp(), ctc(scene, a_grasp()))
    assert not certificate.certified


def test_a_tool_in_sight_has_to_clear_the_line_too() -> None:
    scene = a_scene()
    tool = scene.model_copy(update={"jaws": Jaws(in_sight=True, thickness=2e-3, stem=4e-3)})
    plain, with_tool = certified(scene), certified(tool)
    line = scene.line_of_sight
    hides = clearance(tool_outline(tool, plain.frames[-1].jaws), line.camera, line.target)
    assert hides < 0, "else this tests nothing"
    assert with_tool.path["end"] > plain.path["end"]
    end = clearance(tool_outline(tool, with_tool.frames[-1].jaws), line.camera, line.target)
    assert 0 <= end <= ON_TIME


def test_the_tool_stands_outside_the_tissue_on_both_sides() -> None:
    jaws = Jaws(width=2e-3, thickness=1e-3, stem=3e-3)
    scene = a_scene().model_copy(update={"jaws": jaws})
    lower, upper = tool_outline(scene, np.array([-0.02, 0.0, -0.02, HEIGHT])).reshape(2, -1, 2)
    assert lower[:, 1].max() == 0.0
    assert lower[:, 1].min() == pytest.approx(-4e-3)
    assert upper[:, 1].min() == HEIGHT
    np.testing.assert_allclose(lower.mean(axis=0)[0], -0.02)
    np.testing.assert_allclose(lower[:, 1], HEIGHT - upper[:, 1])
    np.testing.assert_allclose(np.ptp(lower[:, 0]), 2e-3)


OLD_HASHES = {
    "ten_veins": "99fb5f5d8c3420e74326529f2c4983e2f52eda209e3beede19f2c3f65bc2ce14",
    "homogeneous": "ebe6a552e8b3d067a7f9884070e0ca30d57192ec441a01034c1f5cb37ee6aebc",
}


@pytest.mark.parametrize("name", list(OLD_HASHES))
def test_new_fields_at_their_defaults_leave_the_hash_as_it_was(name: str) -> None:
    scene = load_scene(name)
    assert scene.hash == OLD_HASHES[name]
    assert Scene.from_data(scene.dump()).hash == OLD_HASHES[name]
    for part, change in (
        ("limits", {"clearance": 1e-3}),
        ("jaws", {"in_sight": True}),
        ("jaws", {"stem": 6e-3}),
    ):
        changed = getattr(scene, part).model_copy(update=change)
        assert scene.model_copy(update={part: changed}).hash != scene.hash


def test_bad_margins_are_one_line() -> None:
    with pytest.raises(ValueError, match=r"clearance = -0.001 m, allowed \[0, 0.1\] m"):
        Limits(clearance=-1e-3)
    with pytest.raises(ValueError, match=r"thickness = 0.0 m, allowed \(0, 0.02\] m"):
        Jaws(thickness=0.0)


@pytest.mark.parametrize("planner", ["swift", "ctc", "eased", "fem_gradient", "light_grip", "elastica"])
def test_planners_plan_for_the_clearance_that_is_asked_for(planner: str) -> None:
    """6 % of the length, which no planner's own margin covers."""
    if planner == "elastica":
        pytest.importorskip("casadi")
    asked = 3e-3
    scene = a_scene()
    scene = scene.model_copy(update={"limits": scene.limits.model_copy(update={"clearance": asked})})
    certificate = plan(scene, planner, "coarse", workers=1).certificate
    assert certificate.certified and asked <= certificate.clearance < asked + 0.05 * scene.tissue.length
