"""The planner `elastica` on finite elements: what it certifies, and what it says where it cannot."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from baselines.verification.flaps import HEIGHT, LENGTH
from planners.base import NoPlan, Plan
from planners.certify import certify
from planners.paths import ctc
from planners.search import race
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from tests.planners.retractions import a_grasp, a_scene, retraction

pytest.importorskip("casadi")
adaptation = pytest.importorskip("planners.elastica.planner")

ROOT = Path(__file__).resolve().parents[3]


def optimum(scene: Scene, grasp: Grasp) -> Plan:
    contestant = adaptation.Elastica(scene, grasp, ctc(scene, grasp))
    return race(scene, [contestant], "elastica", "coarse", 1)


def test_it_strains_a_middling_grasp_less_than_half_as_much_as_the_paper() -> None:
    scene, grasp = a_scene(friction=0.5), a_grasp(-0.7 * LENGTH)
    found = optimum(scene, grasp)
    assert found.certificate.certified
    # the paper's compression alone, a quarter of the height, strains more than that
    assert found.certificate.max_strain < 0.5 * retraction(scene, grasp).max_strain
    assert found.certificate.required_friction <= 0.5
    assert found.path.kind == "elastica" and found.path != ctc(scene, grasp)
    judged = certify(scene, found.grasp, found.path, "coarse")
    assert judged.to_json() == found.certificate.to_json()


def test_it_holds_a_grasp_at_the_free_end_that_slips_on_the_paper_s_path() -> None:
    scene = a_scene(friction=0.5, target=0.15)
    grasp = a_grasp(-LENGTH + 5e-4)
    assert retraction(scene, grasp).reason == "slip"
    found = optimum(scene, grasp)
    assert found.certificate.max_strain < 0.5 * retraction(scene, grasp).max_strain


def test_jaws_that_slip_close_further(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, grasp = a_scene(friction=0.5), a_grasp(-0.7 * LENGTH)
    held, path = adaptation.optimise(scene, grasp)
    light = 0.85 * held.compression
    poses = path.poses.copy()
    poses[1:, 3] = HEIGHT - light
    loose = Grasp(held.x, light), JawPath.from_poses(poses, "elastica")
    monkeypatch.setattr(adaptation, "optimise", lambda *_: loose)
    held = optimum(scene, grasp).grasp
    path = optimum(scene, grasp).path
    assert light < held.compression <= light * adaptation.FIRMER**adaptation.MOST_FIRMER * (1 + 1e-9)
    assert path.poses[1:, 3] == pytest.approx(HEIGHT - held.compression)


def test_a_grip_that_the_coarse_mesh_does_not_close_is_left_to_the_judge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = []
    monkeypatch.setattr(adaptation, "retract", lambda trial, _: tried.append(trial))
    assert optimum(a_scene(friction=0.5), a_grasp(-0.7 * LENGTH)).certificate.certified
    assert len(tried) == 1


def test_the_solver_s_failure_is_the_candidate_s_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise adaptation.Unsolved("infeasible problem detected")

    monkeypatch.setattr(adaptation, "solve", fails)
    scene, grasp = a_scene(), a_grasp()
    with pytest.raises(NoPlan, match=r"1 unsolved \(infeasible problem detected\)") as none:
        optimum(scene, grasp)
    assert none.value.candidates[0].reason == "unsolved (infeasible problem detected)"


def test_without_casadi_the_message_names_the_extra(tmp_path: Path) -> None:
    code = """
import sys
sys.modules["casadi"] = None
import planners
from baselines.cli.app import main
sys.exit(main(["plan", "configs/scenes/homogeneous.yaml", "--planner", "elastica", "--out", sys.argv[1]]))
"""
    ran = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 2
    assert ran.stderr == 'error: planner "elastica" needs casadi: pip install "retract[optimize]"\n'
