"""Certified motions in time: slow ones are what the certificate says, fast ones need more."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.cli import main
from baselines.verification.flaps import HEIGHT
from planners.base import plan_to_json
from planners.certify import Certificate, certify, timed
from planners.certify.moving import law, moving
from planners.paths import ctc
from retract_env.grasp import Grasp
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
    clearance = [m.clearance - certificate.clearance for m in found]
    # as well as peaks between increments are known
    assert abs(friction[0]) < 3e-3 and abs(strain[0]) < 5e-3 and abs(clearance[0]) < 1e-4
    assert friction[0] < friction[1] < friction[2]
    assert strain[0] < strain[1] < strain[2]
    assert clearance[0] > clearance[1] > clearance[2]
    assert found[1].duration == pytest.approx(found[0].duration / 10)
    assert not any(m.overlap for m in found)


def test_sudden_starts_shake() -> None:
    """Where both are slow, a smooth start excites nothing, a sudden one does."""
    frames = retraction(a_scene()).frames
    smooth, sudden = (moving(a_scene(), frames, 0.004, "coarse", start) for start in ("smooth", "sudden"))
    assert sudden.clearance < smooth.clearance and sudden.duration == smooth.duration


def turned_in_place(order: str) -> Certificate:
    """Jaws that rise without turning and turn without rising, in that order or the other, or only turn."""
    grasp = a_grasp(-0.035)
    turns = [(grasp.x, 0.0, -0.04 * k) for k in range(1, 11)]
    rises = [(grasp.x, 4e-4 * k, 0.0) for k in range(1, 11)]
    motion = {
        "rise, turn": rises + [(x, 4e-3, theta) for x, _, theta in turns],
        "turn, rise": turns + [(x, y, -0.4) for x, y, _ in rises],
        "turn": turns,
    }[order]
    gap = HEIGHT - grasp.compression
    path = poses(grasp, *((x, HEIGHT / 2 + y, theta, gap) for x, y, theta in motion))
    return certify(a_scene(strain=0.9), grasp, path, "coarse")


@pytest.mark.parametrize("order", ["rise, turn", "turn, rise", "turn"])
def test_turns_in_place_are_made_in_time_too(order: str) -> None:
    certificate = turned_in_place(order)
    slowly = moving(a_scene(strain=0.9), certificate.frames, 0.002, "coarse")
    assert slowly.required_friction == pytest.approx(certificate.required_friction, abs=0.02)
    assert slowly.max_strain == pytest.approx(certificate.max_strain, rel=0.02)
    assert slowly.clearance == pytest.approx(certificate.clearance, abs=1e-4)


def test_a_grip_by_force_is_made_with_the_separations_that_it_took() -> None:
    scene = a_scene()
    grasp = Grasp(-0.025, force=0.06)
    certificate = certify(scene, grasp, ctc(scene, grasp), "coarse", speed=0.002)
    assert certificate.certified and certificate.moving is not None
    assert certificate.moving["required_friction"] == pytest.approx(certificate.required_friction, abs=0.01)


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


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        *(
            ({"speed": speed}, r"speed = .* m/s, allowed 1e-06 to 1000")
            for speed in (0.0, -0.1, np.nan, np.inf)
        ),
        ({"speed": 0.05, "start": "late"}, "start = 'late', allowed smooth, sudden"),
        ({"speed": 0.05, "damping": 1.0}, r"damping = 1, allowed \[0, 1\)"),
    ],
)
def test_what_is_no_motion_is_refused(asked: dict[str, Any], said: str) -> None:
    plain = retraction(a_scene())
    for refuses in (
        lambda: moving(a_scene(), plain.frames, resolution="coarse", **asked),
        lambda: timed(plain, a_scene(), **asked),
    ):
        with pytest.raises(ValueError, match=said):
            refuses()


def test_tissue_without_mass_does_not_move_in_time() -> None:
    weightless = a_scene().model_copy(update={"tissue": a_scene().tissue.model_copy(update={"density": 0.0})})
    with pytest.raises(ValueError, match=r"tissue\.density = 0"):
        certify(weightless, a_grasp(), ctc(weightless, a_grasp()), "coarse", speed=0.05)


def test_jaws_that_go_nowhere_are_refused() -> None:
    still = certify(a_scene(), a_grasp(), poses(a_grasp()), "coarse")
    with pytest.raises(ValueError, match="frames: no motion"):
        moving(a_scene(), still.frames, 0.05, "coarse")


@pytest.mark.parametrize("speed", [1e-5, 100.0])
def test_speeds_out_of_all_reason_end(speed: float) -> None:
    """So slow that it is the certificate, and so fast that nothing holds, if there is a solution at all."""
    certificate = retraction(a_scene())
    found = moving(a_scene(), certificate.frames, speed, "coarse")
    if speed < 1:
        assert found.required_friction == pytest.approx(certificate.required_friction, abs=3e-3)
    else:
        assert found.max_strain > 2 * certificate.max_strain


def test_the_console_makes_a_plan_in_time_and_checks_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, grasp = a_scene(), a_grasp()
    plan, file = tmp_path / "plan.json", tmp_path / "certificate.json"
    plan.write_text(json.dumps(plan_to_json(scene, "ctc", grasp, ctc(scene, grasp), "coarse")), "utf-8")
    asked = ["certify", str(plan), "--resolution", "coarse", "--speed", "0.02", "--out", str(file)]
    assert main(asked) == 0
    assert "at 20 mm/s, in " in capsys.readouterr().out
    assert main(["certify", str(plan), "--check", str(file)]) == 0
    sudden = timed(retraction(scene), scene, 0.02, "sudden", damping=0.1)
    file.write_text(json.dumps(sudden.to_json()), "utf-8")
    assert main(["certify", str(plan), "--check", str(file)]) == 0
    odd: list[Any] = [[], {}, {"speed": "x", "start": "smooth", "damping": 0.05}, {"speed": -1}]
    for wrong in odd:
        file.write_text(json.dumps(replace(sudden, moving=wrong).to_json()), "utf-8")
        assert main(["certify", str(plan), "--check", str(file)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {file}: certificate.moving: ")
    assert main(["certify", str(plan), "--check", str(file), "--speed", "0"]) == 2
    assert "--check: not with --out, --verify, --robust, --speed" in capsys.readouterr().err
    assert main([*asked[:4], "--speed", "-1"]) == 2
    assert "speed = -1 m/s, allowed 1e-06 to 1000" in capsys.readouterr().err
