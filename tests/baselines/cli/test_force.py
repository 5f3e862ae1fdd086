"""Grips by force in the console: plans are certified and checked, and what is printed says the force."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from baselines.cli import main
from baselines.cli.candidates import CandidateTable
from planners.base import Candidate
from planners.paths import ctc
from retract_env.grasp import Grasp
from retract_env.scene import load_scene

SCENE, GRASP = load_scene("homogeneous"), Grasp(-0.025, force=0.08)


def test_a_plan_by_force_is_certified_and_its_certificate_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, certificate = tmp_path / "plan.json", tmp_path / "certificate.json"
    path = ctc(SCENE, GRASP).to_json()
    plan.write_text(json.dumps({"scene": SCENE.dump(), "grasp": {"x": -0.025, "force": 0.08}, "path": path}))
    assert main(["certify", str(plan), "--resolution", "coarse", "--out", str(certificate)]) == 0
    assert "force 80.0 mN" in capsys.readouterr().out
    assert json.loads(certificate.read_text())["grasp"] == {"x": -0.025, "force": 0.08}
    assert main(["certify", str(plan), "--check", str(certificate)]) == 0


def test_the_table_says_the_force_and_what_was_chosen() -> None:
    candidate = Candidate(0, GRASP, ctc(SCENE, GRASP), status="done", reason="ok")
    screen = io.StringIO()
    with CandidateTable(Console(file=screen, force_terminal=True, width=80, color_system=None)) as table:
        table.update([candidate])
        table.choose(Grasp(-0.025, force=0.08))
    assert "80.0 mN" in screen.getvalue() and "chosen" in screen.getvalue()
    assert "nan" not in screen.getvalue()
