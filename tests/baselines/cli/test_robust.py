"""The robust statement in the console: words, worst cases, what is computed again."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

import planners
from baselines.cli import main
from baselines.cli.robust import hurts, told, worst_cases
from baselines.cli.shown import _worst
from baselines.cli.verdict import margins
from baselines.pictures.words import percent
from planners.base import Plan, plan_from_json
from planners.certify import Certificate, Robust
from planners.certify import stated as stated_by
from retract_env.scene import Scene, Uncertainty, load_scene

FEW = Robust(samples=40, seed=3)
COARSE = ("--resolution", "coarse")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("homogeneous")


@pytest.fixture(scope="module")
def plan(scene: Scene) -> Plan:
    """The plan for what the scene says alone: it fails often where that is not quite so."""
    known = scene.model_copy(update={"uncertainty": Uncertainty.none()})
    found = planners.plan(known, resolution="coarse")
    certificate = replace(found.certificate, scene_hash=scene.hash)
    return replace(found, scene=scene, certificate=certificate)


@pytest.fixture(scope="module")
def stated(plan: Plan) -> Certificate:
    return stated_by(plan.certificate, plan.scene, plan.grasp, plan.path, FEW)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """The console asks for a small sample."""
    monkeypatch.setattr(
        sys.modules["planners.certify"], "Robust", lambda *asked: Robust(*asked) if asked else FEW
    )


@pytest.fixture
def folder(tmp_path: Path, plan: Plan, stated: Certificate) -> Path:
    (tmp_path / "plan.json").write_text(json.dumps(plan.to_json()))
    (tmp_path / "certificate.json").write_text(json.dumps(stated.to_json()))
    return tmp_path


def saying(certificate: Certificate, **said: Any) -> Certificate:
    assert certificate.robust is not None
    return replace(certificate, robust={**certificate.robust, **said})


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (0.0, "0 %"),
        (0.008701, "0.88 %"),
        (0.01, "1 %"),
        (0.1630, "17 %"),
        (1.0, "100 %"),
        (2.2e-5, "0.0022 %"),
    ],
)
def test_at_most_is_rounded_up(part: float, text: str) -> None:
    assert percent(part) == text
    assert float(text.split()[0]) / 100 >= part - 1e-12


def test_a_robust_plan_in_words(stated: Certificate) -> None:
    good = saying(
        stated, holds=True, bound=0.0087, samples=1000, beta=1e-3, failures={},
        judged={"rod": 968, "finite_elements": 32, "undecided": 0},
    )  # fmt: skip
    assert told(good)[0] == (
        "robust: fails in at most 0.87 % of flaps as uncertain as this, with confidence 99.9 %: "
        "none of 1,000 did; judged 968 by the rod, 32 by finite elements"
    )
    assert told(replace(stated, robust=None)) == []


def test_what_fails_is_told_by_reason_the_most_frequent_first(stated: Certificate) -> None:
    bad = saying(stated, holds=False, bound=0.41, failures={"release": 2, "slip": 9, "undecided": 1})
    first, second, third = told(bad)
    assert first.startswith(
        "not robust: may fail in up to 41 % of flaps as uncertain as this, more than 1 %, "
    )
    assert ": 12 of 40 did; judged " in first
    assert second == ("  fails by: a jaw slips 9, a jaw lets go 2, not decided, which counts as failing 1")
    assert third.startswith("  what hurts most: ")


def test_what_hurts_is_half_a_range_times_its_slope_over_the_limit(stated: Certificate) -> None:
    none = {"half_range": 0.0, "strain": 9.0, "friction": 9.0, "clearance": 0.0}
    slopes = {
        "weight": none,
        "closing": {"half_range": 1e-4, "strain": 250.0, "friction": -700.0, "clearance": 0.0},
        "modulus": {"half_range": 0.3, "strain": 0.1, "friction": 0.0, "clearance": 0.0},
        "friction": {"half_range": 0.1, "strain": 0.0, "friction": 0.0, "clearance": 0.0},
    }
    certificate = replace(saying(stated, sensitivities=slopes), strain_limit=0.5, friction_limit=0.5)
    assert list(hurts(certificate)) == [
        "closing of the jaws (friction ±0.070)",
        "friction of the jaws (limit of friction ±0.050)",
        "stiffness of the flap (strain ±0.030)",
    ]
    assert list(hurts(saying(stated, sensitivities=None))) == []


def test_the_judges_own_margins_in_one_line(stated: Certificate) -> None:
    line = margins(stated)
    assert line.startswith("the judge may be off by: strain 5.1 % and friction 0.16 for the mesh; strain ")
    assert "\n" not in line
    assert margins(replace(stated, margins=None)) == ""
    assert stated.margins is not None
    assert "not compared" in margins(replace(stated, margins={**stated.margins, "mesh": None}))


def test_worst_cases_are_plans_of_the_flaps_drawn(plan: Plan, stated: Certificate) -> None:
    cases = worst_cases(plan.scene, plan.grasp, plan.path, stated)
    # the jaws miss the thinnest flap altogether, which is no plan
    assert list(cases) == ["worst-1.json", "worst-2.json"]
    rows = _worst(plan.scene, plan.grasp, plan.path, stated, rod=False, on_step=lambda: None).rows
    assert [row.cells[0] for row in rows] == ["\N{EN DASH}", "1", "2"]
    assert [row.scene is None for row in rows] == [True, False, False]
    for case in cases.values():
        there, grasp, path = plan_from_json(json.loads(json.dumps(case)))
        assert there.hash != plan.scene.hash
        assert math.isclose(path.poses[0, 0], grasp.x)
    assert worst_cases(plan.scene, plan.grasp, plan.path, replace(stated, robust=None)) == {}


@pytest.mark.usefixtures("few")
def test_certify_says_it_and_writes_worst_cases_that_it_opens(
    folder: Path, stated: Certificate, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "again.json"
    assert main(["certify", str(folder / "plan.json"), *COARSE, "--robust", "--out", str(out)]) == 1
    said = capsys.readouterr().out
    assert said.endswith("certified as the scene says, but not robust\n")
    assert told(stated)[0] in said
    assert json.loads(out.read_text()) == stated.to_json()
    assert main(["certify", str(folder / "worst-1.json"), *COARSE]) == 1
    assert "not certified: " in capsys.readouterr().out


def test_a_statement_is_computed_again_as_it_was_made(
    folder: Path, stated: Certificate, capsys: pytest.CaptureFixture[str]
) -> None:
    check = ["certify", str(folder / "plan.json"), "--check", str(folder / "certificate.json")]
    assert main(check) == 1  # it says itself that it is not robust
    assert "computed again, all the same" in capsys.readouterr().out
    better = saying(stated, bound=0.001)
    (folder / "certificate.json").write_text(json.dumps(better.to_json()))
    assert main(check) == 1
    assert "not what the plan comes to: robust.bound = 0.001, recomputed 0." in capsys.readouterr().out
    for samples in ("many", 3):
        odd = saying(stated, samples=samples)
        (folder / "certificate.json").write_text(json.dumps(odd.to_json()))
        assert main(check) == 2
        assert "certificate.robust" in capsys.readouterr().err
    assert main([*check, "--robust"]) == 2


@pytest.mark.usefixtures("few")
def test_plan_as_if_all_were_known_is_stated_for_the_scene_as_it_is(
    tmp_path: Path, scene: Scene, stated: Certificate, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["plan", "homogeneous", "--known", *COARSE, "--no-pictures", "--out", str(out)]
    assert main([*command, "--robust"]) == 1
    assert "not robust: " in capsys.readouterr().out
    assert json.loads((out / "certificate.json").read_text()) == stated.to_json()
    assert json.loads((out / "plan.json").read_text())["scene"] == scene.dump()
    assert (out / "worst-2.json").exists()
    assert main(command) == 0
    assert {file.name for file in out.iterdir()} == {"plan.json", "certificate.json"}


def test_a_grip_or_a_time_that_is_not_taken_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["plan", "homogeneous", "--planner", "ctc", "--out", str(tmp_path / "out")]
    assert main([*command, "--grip", "force"]) == 2
    assert capsys.readouterr().err == (
        "error: --grip = 'force', allowed position with planner 'ctc'; any with swift\n"
    )
    assert main([*command, "--time", "3"]) == 2
    assert main(["plan", "homogeneous", "--time", "-1", "--out", str(tmp_path / "out")]) == 2
    assert "error: --time = -1 s, allowed (0, 86400] s" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_of_another_law_nothing_robust_is_stated(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fung = plan.scene.dump() | {"material": {"law": "fung", "stiffening": 4.0}}
    (tmp_path / "fung.yaml").write_text(yaml.safe_dump(fung))
    (tmp_path / "plan.json").write_text(json.dumps(plan.to_json() | {"scene": fung}))
    scene, plan_file = str(tmp_path / "fung.yaml"), str(tmp_path / "plan.json")
    for command in (["plan", scene, "--robust"], ["certify", plan_file, "--robust"], ["compare", scene]):
        assert main(command) == 2
        said = "error: material.law = 'fung', allowed 'neo-hookean' for a robust statement\n"
        assert capsys.readouterr().err == said


@pytest.mark.usefixtures("few")
def test_an_interrupt_ends_the_statement(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("baselines.cli.progress.Under.judged", interrupt)
    assert main(["certify", str(folder / "plan.json"), *COARSE, "--robust"]) == 130
    assert capsys.readouterr().err == "interrupted\n"
