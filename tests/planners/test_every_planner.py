"""Every planner answers every valid scene with a plan that the judge confirms, or with counted reasons."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from planners import PLANNERS, NoPlan, certify, plan
from retract_env.scene import Jaws
from tests.planners.retractions import a_scene, box

UNMESHABLE_WHERE_EASED_BEGINS = [
    box(-0.03477, -0.03457, 0.0, 0.0010),
    box(-0.03480, -0.03460, 0.0034, 0.0044),
]
"""Two veins that meet the lower and the upper surface between the jaws."""

SCENES: dict[str, dict[str, Any]] = {
    "unmeshable": {"veins": UNMESHABLE_WHERE_EASED_BEGINS},
    "wide jaws": {"veins": [box(-0.04, -0.004, 1e-3, 2e-3)], "jaws": Jaws(width=7.7e-3)},
    "too soft to rest": {"modulus": 500.0},
}


# `exhaustive` tries what the four before it try, at fifty places
NAMES = [pytest.param(name, marks=[pytest.mark.slow] * (name == "exhaustive")) for name in PLANNERS]


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", NAMES)
def test_it_answers(name: str, kind: str) -> None:
    if name == "elastica" and importlib.util.find_spec("casadi") is None:
        pytest.skip("casadi is not installed")
    scene = a_scene(friction=0.5, **SCENES[kind])
    try:
        found = plan(scene, name, "coarse", workers=1)
    except NoPlan as none:
        reasons = {candidate.reason for candidate in none.candidates}
    else:
        judged = certify(scene, found.grasp, found.path, "coarse")
        assert judged.certified and judged.to_json() == found.certificate.to_json()
        return
    assert reasons and not reasons & {None, "ok"}
