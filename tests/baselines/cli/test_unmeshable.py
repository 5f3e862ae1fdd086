"""Flaps that are too large for the mesh that a command asks for: one line, and nothing is lost."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from baselines.cli import main
from retract_env.errors import MeshError


def test_a_flap_that_cannot_be_meshed_has_no_plan_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MeshError("tissue: 168861 unknowns at 'fine', allowed 150000")

    monkeypatch.setattr("planners.plan", fails)
    assert main(["plan", "homogeneous", "--no-pictures", "--out", str(tmp_path / "out")]) == 1
    assert "no plan certified: tissue: 168861 unknowns" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_verified_on_a_finer_mesh_is_kept_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MeshError("tissue: 299061 unknowns at 'finer', allowed 150000")

    monkeypatch.setattr(sys.modules["planners.certify"], "verified", fails)
    out = tmp_path / "out"
    command = ["plan", "homogeneous", "--planner", "eased", "--resolution", "coarse", "--no-pictures"]
    assert main([*command, "--verify", "--out", str(out)]) == 0
    assert "not verified on a finer mesh: tissue: 299061 unknowns" in capsys.readouterr().err
    assert json.loads((out / "certificate.json").read_text())["verification"] is None
    again = ["certify", str(out / "plan.json"), "--resolution", "coarse", "--verify"]
    assert main([*again, "--out", str(tmp_path / "worst-1.json")]) == 2
    assert "allowed another name" in capsys.readouterr().err
    assert main(again) == 0
    assert "not verified on a finer mesh" in capsys.readouterr().err
