"""What finite elements felt more than the rod."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planners.certify import Retraction
from planners.certify.robust import corrected_by
from planners.correction import Correction, correction
from planners.paths import ctc
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.rod import RodPhysics
from retract_env.rod.follow import CLEAR, DRAG, NORMAL, STRAIN
from retract_env.scene import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("homogeneous")


@pytest.fixture(scope="module")
def plan(scene: Scene) -> tuple[Grasp, JawPath]:
    grasp = Grasp(-0.03, 0.0007)
    return grasp, ctc(scene, grasp, 8)


def history_of(scene: Scene, grasp: Grasp, path: JawPath) -> dict[str, Any]:
    """The rod's own, as a certificate tells it."""
    physics = RodPhysics(scene, grasp.x)
    states = [physics.reset()] + [physics.move_to(pose, 1.0 + k) for k, pose in enumerate(path.poses[1:])]
    return {
        "progress": [s.progress for s in states],
        "strain": [s.worst_strain for s in states],
        "friction": [s.required_friction.tolist() for s in states],
        "reactions": [s.reactions.tolist() for s in states],
        "jaws": [s.jaws.tolist() for s in states],
        "clearance": [s.clearance for s in states],
    }


def test_the_rod_needs_no_correction_by_itself(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    """Forces, their units and signs come back as they were."""
    grasp, path = plan
    found = corrected_by(scene, grasp, path, history_of(scene, grasp, path))
    assert found is not None
    assert found.normal == pytest.approx(1.0, abs=1e-9)
    assert found.drag == pytest.approx(0.0, abs=1e-9)
    assert found.clearance == pytest.approx(0.0, abs=1e-12)
    assert found.friction == pytest.approx(0.0, abs=1e-9)
    assert found.strain == pytest.approx(1.0, abs=1e-9)


def test_corrected_the_rod_feels_what_finite_elements_felt(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    grasp, path = plan
    retraction = Retraction(scene, grasp, path, "coarse")
    retraction.squeeze()
    retraction.move()
    found = corrected_by(scene, grasp, path, retraction.history())
    assert found is not None
    felt = found.apply(Flaps(scene).follow([grasp.x], path.poses[1:][None]).felt[0])
    for frame in retraction.frames:
        k = frame.progress - 1
        if k < 0 or not float(k).is_integer():
            continue
        there, normals = felt[int(k)], frame.normals
        unit = scene.tissue.modulus * scene.tissue.height * scene.tissue.depth
        pressing = -(frame.reactions * normals).sum(-1) / unit
        assert there[NORMAL] == pytest.approx(pressing, rel=1e-9)
        assert np.abs(there[DRAG]) / there[NORMAL] == pytest.approx(frame.required_friction, abs=1e-9)
        assert there[CLEAR] == pytest.approx(frame.clearance, abs=1e-12)
        # the greatest of what is around it counts
        assert there[STRAIN] >= frame.worst_strain * (1 - 1e-9)
    # and it is as small as the distances that are published for the rod
    assert np.abs(found.normal - 1).max() < 0.15
    assert np.abs(found.drag).max() < 0.004


def test_poses_that_were_not_reached_are_like_the_last_one(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    grasp, path = plan
    history = history_of(scene, grasp, path)
    history = {name: values[:7] for name, values in history.items()}
    history["clearance"] = [c + 1e-3 for c in history["clearance"]]
    found = corrected_by(scene, grasp, path, history)
    assert found is not None
    assert found.clearance == pytest.approx(1e-3)
    assert len(found.strain) == path.last


def test_a_history_without_a_closed_jaw_corrects_nothing(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    grasp, path = plan
    history = {name: values[:1] for name, values in history_of(scene, grasp, path).items()}
    felt = Flaps(scene).follow([grasp.x], path.poses[1:][None]).felt[0]
    assert correction(scene, np.arange(1.0, path.last + 1), felt, history) is None


def test_no_correction_changes_nothing() -> None:
    felt = np.random.default_rng(0).normal(size=(3, 5, 7))
    none = Correction.none(5)
    assert np.array_equal(none.apply(felt), felt)
    felt[..., NORMAL] = [1.0, -1.0]
    assert np.isinf(none.needed_friction(felt)).all()
    assert len(none.padded(2).strain) == 7
