"""The planner `elastica` on finite elements: what it certifies, and what it says where it cannot."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from planners.base import NoPlan
from planners.certify import Trial
from planners.paths import ctc
from planners.search import generate_and_test
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from tests.planners.retractions import a_grasp, a_scene, retraction
from tests.retract_env.bodies import HEIGHT, LENGTH

pytest.importorskip("casadi")
adaptation = pytest.importorskip("planners.elastica.planner")

ROOT = Path(__file__).resolve().parents[3]


def optimum(scene: Scene, grasp: Grasp) -> Trial:
    trial: Trial = adaptation.Elastica(scene, grasp, ctc(scene, grasp), "coarse")
    trial.squeeze()
    trial.move()
    return trial


def test_it_strains_a_middling_grasp_less_than_half_as_much_as_the_paper() -> None:
    scene, grasp = a_scene(friction=0.5), a_grasp(-0.7 * LENGTH)
    trial = optimum(scene, grasp)
    assert trial.certificate().certified
    # the paper's compression alone, a quarter of the height, strains more than that
    assert trial.max_strain < 0.5 * retraction(scene, grasp).max_strain
    assert trial.required_friction <= 0.5
    assert trial.path.kind == "elastica" and trial.path != ctc(scene, grasp)


def test_it_holds_a_grasp_at_the_free_end_that_slips_on_the_paper_s_path() -> None:
    scene = a_scene(friction=0.5, target=0.15)
    grasp = a_grasp(-LENGTH + 5e-4)
    assert retraction(scene, grasp).reason == "slip"
    trial = optimum(scene, grasp)
    assert trial.reason == "ok" and trial.max_strain < 0.5 * retraction(scene, grasp).max_strain


def test_jaws_that_slip_close_further(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, grasp = a_scene(friction=0.5), a_grasp(-0.7 * LENGTH)
    held, path = adaptation.optimise(scene, grasp)
    light = 0.85 * held.compression
    poses = path.poses.copy()
    poses[1:, 3] = HEIGHT - light
    loose = Grasp(held.x, light), JawPath.from_poses(poses, "elastica")
    monkeypatch.setattr(adaptation, "optimise", lambda *_: loose)
    trial = optimum(scene, grasp)
    assert trial.reason == "ok"
    assert light < trial.grasp.compression <= light * adaptation.FIRMER**adaptation.MOST_FIRMER * (1 + 1e-9)
    assert trial.path.poses[1:, 3] == pytest.approx(HEIGHT - trial.grasp.compression)


def test_the_solver_s_failure_is_the_candidate_s_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise adaptation.Unsolved("infeasible problem detected")

    monkeypatch.setattr(adaptation, "solve", fails)
    scene, grasp = a_scene(), a_grasp()
    with pytest.raises(NoPlan, match=r"1 unsolved \(infeasible problem detected\)") as none:
        generate_and_test(
            scene, [(grasp, ctc(scene, grasp))], "elastica", "coarse", 1, trial=adaptation.Elastica
        )
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
