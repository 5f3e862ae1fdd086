"""`retract compare`: what is planned, printed and drawn."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import planners
from baselines.cli import main
from baselines.cli.compare import METHODS
from baselines.pictures.comparison import Compared, comparison, comparison_figure
from baselines.pictures.words import percent
from planners.base import NoPlan, Plan
from planners.certify import Robust, stated
from retract_env.scene import Scene, load_scene

FEW = Robust(samples=700)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("homogeneous")


@pytest.fixture(scope="module")
def compared(scene: Scene) -> list[Compared]:
    out = []
    for _, name, planner, grip in METHODS:
        plan = planners.plan(scene, planner, "coarse", grip=grip)
        certificate = stated(plan.certificate, scene, plan.grasp, plan.path, FEW)
        out.append(Compared(name, replace(plan, certificate=certificate)))
    return out


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, compared: list[Compared]) -> None:
    """The planners answer at once."""
    known = {(planner, grip): one.plan for (*_, planner, grip), one in zip(METHODS, compared, strict=True)}

    def plan(scene: Scene, planner: str, *_: object, grip: str) -> Plan:
        found = known[planner, grip]
        if found is None:
            raise NoPlan([])
        return found

    monkeypatch.setattr(planners, "plan", plan)
    monkeypatch.setattr(sys.modules["planners.certify"], "Robust", lambda *_: FEW)


@pytest.mark.usefixtures("quick")
def test_the_table_the_plans_and_the_pictures(
    tmp_path: Path, compared: list[Compared], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["compare", "homogeneous", "--out", str(out), "--resolution", "coarse"]) == 0
    text = capsys.readouterr().out
    for (folder, name, *_), one in zip(METHODS, compared, strict=True):
        assert one.plan is not None
        row = next(line for line in text.splitlines() if line.startswith(name))
        assert f"{one.plan.certificate.max_strain:.3f}" in row and one.held in row and "0 / 700" in row
        written = json.loads((out / folder / "certificate.json").read_text())
        assert written["robust"]["samples"] == FEW.samples
        assert (out / folder / "worst-1.json").exists()
    assert "allowed" in text
    assert {file.name for file in out.iterdir()} == {
        *(folder for folder, *_ in METHODS), "comparison.png", "view.html",
        "retraction.png", "retraction.gif",
    }  # fmt: skip


@pytest.mark.usefixtures("quick")
def test_plans_of_an_earlier_run_go_where_there_is_none_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["compare", "homogeneous", "--out", str(tmp_path), *["--no-pictures", "--resolution", "coarse"]]
    assert main(command) == 0
    (tmp_path / "ctc" / "mine.txt").write_text("kept")
    for name in ("plan.json", "certificate.json", "worst-1.json"):  # of `retract plan` into the same folder
        (tmp_path / name).write_text("of another scene")
    found = planners.plan

    def plan(scene: Scene, planner: str, *given: object, grip: str) -> Plan:
        if planner == "ctc":
            raise NoPlan([])
        return found(scene, planner, *given, grip=grip)  # type: ignore[arg-type]

    monkeypatch.setattr(planners, "plan", plan)
    assert main(command) == 0
    assert [file.name for file in (tmp_path / "ctc").iterdir()] == ["mine.txt"]
    assert (tmp_path / "swift" / "plan.json").exists()
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == []


def test_swift_spares_the_tissue_and_a_grip_by_force_more(compared: list[Compared]) -> None:
    strains = [one.plan.certificate.max_strain for one in compared if one.plan is not None]
    assert len(strains) == 3
    assert strains[2] < strains[1] < strains[0]


def test_one_panel_a_method_and_three_rows_of_bars(scene: Scene, compared: list[Compared]) -> None:
    some = [Compared(compared[0].name, None, "11 candidates: 11 slip"), *compared[1:]]
    axes: dict[Any, Any] = {a.get_label(): a for a in comparison_figure(scene, some).axes}
    panels = [axes[f"retraction {i}"] for i in range(3)]
    assert [p.get_title(loc="left") or p.get_title() for p in panels] == [one.name for one in some]
    assert len({(p.get_xlim(), p.get_ylim()) for p in panels}) == 1, "all at one scale"
    assert any("11 slip" in text.get_text() for text in panels[0].texts)
    for k in range(3):
        widths = [bar.get_width() for bar in axes[f"bars {k}"].patches]
        assert len(widths) == 3
        assert widths[0] == 0 < min(widths[1:])
    assert comparison(scene, some).startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no method has a plan"):
        comparison(scene, some[:1])


def test_at_most_stays_true_in_the_picture(scene: Scene, compared: list[Compared]) -> None:
    """A bound of 12.341 % is no 12.3."""
    plan = compared[0].plan
    assert plan is not None and plan.certificate.robust is not None
    certificate = replace(plan.certificate, robust=plan.certificate.robust | {"bound": 0.12341})
    one = Compared("one", replace(plan, certificate=certificate))
    axes: dict[Any, Any] = {a.get_label(): a for a in comparison_figure(scene, [one]).axes}
    said = [text.get_text() for text in axes["bars 2"].texts]
    assert said[0] == percent(0.12341).removesuffix(" %") == "13"


def test_nothing_found_by_any_is_exit_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise NoPlan([])

    monkeypatch.setattr(planners, "plan", fail)
    assert main(["compare", "homogeneous", "--out", str(tmp_path / "out"), "--no-pictures"]) == 1
    assert "the method of 2009: no plan certified: 0 candidates" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
