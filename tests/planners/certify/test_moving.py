"""Certified motions in time: slow ones are what the certificate says, fast ones need more."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from planners.certify import Certificate, certify
from planners.certify.moving import law, moving
from planners.certify.trial import timed
from tests.planners.retractions import a_grasp, a_scene, poses, retraction


def test_the_law_of_least_jerk_begins_and_ends_at_rest() -> None:
    part = np.linspace(0, 1, 1001)
    made = np.array([law("smooth", p) for p in part])
    assert made[0] == 0 and made[-1] == pytest.approx(1) == law("smooth", 3.0)
    speed = np.gradient(made, part)
    assert speed[0] == pytest.approx(0, abs=1e-4) and speed[-1] == pytest.approx(0, abs=1e-4)
    assert speed.max() == pytest.approx(15 / 8, rel=1e-4)
    assert made + made[::-1] == pytest.approx(1)
    assert [law("sudden", p) for p in (0.0, 0.3, 2.0)] == [0.0, 0.3, 1.0]


def test_the_slower_the_nearer_to_the_certificate() -> None:
    certificate = retraction(a_scene())
    found = [moving(a_scene(), certificate.frames, speed, "coarse") for speed in (0.002, 0.02, 0.05)]
    friction = [m.required_friction - certificate.required_friction for m in found]
    strain = [m.max_strain / certificate.max_strain - 1 for m in found]
    # as well as peaks between increments are known
    assert abs(friction[0]) < 3e-3 and abs(strain[0]) < 5e-3
    assert friction[0] < friction[1] < friction[2] and friction[2] > 0.05
    assert strain[0] < strain[2]
    assert certificate.clearance - 1e-4 < found[0].clearance and found[2].clearance < -1e-3
    assert found[1].duration == pytest.approx(found[0].duration / 10)


def test_damping_calms() -> None:
    frames = retraction(a_scene()).frames
    low, high = (moving(a_scene(), frames, 0.05, "coarse", damping=d).required_friction for d in (0.02, 0.2))
    assert high < low


def test_a_certificate_says_it_and_is_read_again() -> None:
    scene, grasp = a_scene(), a_grasp()
    plain = retraction(scene)
    certificate = timed(plain, scene, 0.05)
    assert replace(certificate, moving=None).to_json() == plain.to_json()
    assert certificate.moving is not None and certificate.moving["speed"] == 0.05
    data = json.loads(json.dumps(certificate.to_json()))
    assert Certificate.from_json(data).to_json() == data
    assert timed(plain, scene, 0.05) == certificate  # the same bits
    still = certify(scene, grasp, poses(grasp), "coarse", speed=0.05)
    assert still.moving is None


@pytest.mark.parametrize("speed", [0.0, -0.1, np.nan, np.inf])
def test_what_is_no_speed_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match=r"speed = .* m/s, allowed above 0"):
        moving(a_scene(), retraction(a_scene()).frames, speed, "coarse")


def test_jaws_that_go_nowhere_are_refused() -> None:
    still = certify(a_scene(), a_grasp(), poses(a_grasp()), "coarse")
    with pytest.raises(ValueError, match="frames: no motion"):
        moving(a_scene(), still.frames, 0.05, "coarse")


@pytest.mark.parametrize("speed", [1e-5, 1e5])
def test_speeds_out_of_all_reason_end(speed: float) -> None:
    """So slow that it is the certificate, and so fast that nothing holds."""
    certificate = retraction(a_scene())
    found = moving(a_scene(), certificate.frames, speed, "coarse")
    if speed < 1:
        assert found.required_friction == pytest.approx(certificate.required_friction, abs=3e-3)
    else:
        assert found.max_strain > 1
