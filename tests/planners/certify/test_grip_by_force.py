"""Certificates of grips by force: what they say, and what of a path is asked."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from planners import Certificate, certify
from planners.base import Candidate, Plan, plan_from_json
from planners.paths import ctc
from retract_env.fem.press import FORCE_TOLERANCE
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import load_scene

SCENE = load_scene("homogeneous")
GRASP = Grasp(-0.025, force=0.08)
PATH = ctc(SCENE, GRASP)


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return certify(SCENE, GRASP, PATH, "coarse")


def test_the_history_shows_the_force_and_how_far_the_jaws_closed(certificate: Certificate) -> None:
    assert certificate.certified and certificate.grasp == {"x": -0.025, "force": 0.08}
    closed = []
    for frame in certificate.frames:
        if frame.progress >= 1:
            assert -(frame.reactions * frame.normals).sum() / 2 == pytest.approx(0.08, rel=5e-3)
            closed.append(SCENE.tissue.height - np.hypot(*(frame.jaws[2:] - frame.jaws[:2])))
    assert min(closed) / SCENE.tissue.height > 0.1 and np.ptp(closed) > 1e-5
    assert certificate.history["jaws"][-1] == certificate.frames[-1].jaws.tolist()
    assert Certificate.from_json(json.loads(json.dumps(certificate.to_json()))).grasp == certificate.grasp


def test_of_a_path_midpoints_and_angles_are_followed(certificate: Certificate) -> None:
    poses = PATH.poses.copy()
    poses[1:, 3] *= 0.9
    other = certify(SCENE, GRASP, JawPath.from_poses(poses, "ctc"), "coarse")
    assert (other.reason, other.increments) == (certificate.reason, certificate.increments)
    # midpoints are rounded otherwise, and the search for the force ends elsewhere within its tolerance
    assert other.max_strain == pytest.approx(certificate.max_strain, rel=FORCE_TOLERANCE)
    poses[1, 0] += 1e-4
    with pytest.raises(ValueError, match=r"path\.waypoints\[1\] = .* allowed the grasp squeezed"):
        certify(SCENE, GRASP, JawPath.from_poses(poses, "ctc"), "coarse")


def test_a_plan_keeps_the_force(certificate: Certificate) -> None:
    candidate = Candidate(0, GRASP, PATH)
    plan = Plan(SCENE, "mine", GRASP, PATH, certificate, (candidate,))
    scene, grasp, path = plan_from_json(json.loads(json.dumps(plan.to_json())))
    assert (scene, grasp, path) == (SCENE, GRASP, PATH)
    assert candidate.to_json()["grasp"] == {"x": -0.025, "force": 0.08, "score": None}


@pytest.mark.parametrize(
    ("grasp", "said"),
    [
        ({"x": -0.025, "force": 0.08, "compression": 1e-3}, "plan.grasp.compression: unknown key"),
        ({"x": -0.025, "force": -1.0}, "grasp.force = -1 N, allowed above 0 N"),
        ({"x": -0.025, "force": True}, "plan.grasp: allowed is"),
        ({"x": -0.025}, "plan.grasp: allowed is"),
        ({"force": 0.08}, "plan.grasp: allowed is"),
    ],
)
def test_a_plan_with_another_grasp_is_refused(grasp: dict[str, Any], said: str) -> None:
    data = {"scene": SCENE.dump(), "grasp": grasp, "path": PATH.to_json()}
    with pytest.raises(ValueError, match=r"allowed|known") as error:
        plan_from_json(data)
    assert str(error.value).startswith(said) and "\n" not in str(error.value)
