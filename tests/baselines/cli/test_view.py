"""`retract view`: what it takes, what it refuses, what it writes."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from baselines.cli import main
from baselines.cli.plan import write_plan
from baselines.cli.progress import Under
from baselines.cli.view import first_pair, plan_files
from planners.base import Candidate, Plan
from planners.certify import Robust
from planners.paths import circular
from tests.baselines.pictures.pages import judged

AT = {"x": -0.02, "compression": 5e-4}


@pytest.fixture(scope="module")
def plan() -> Plan:
    """A plan of the method of 2009 with two candidates, the second in a planner's own words, and a robust
    statement."""
    from planners.certify import stated

    scene, grasp, path, certificate = judged("homogeneous")
    certificate = stated(certificate, scene, grasp, path, Robust(samples=50))
    tried = Candidate(0, grasp, path, "done", "ok", certificate.max_strain, 0.2, 1e-5, 30)
    other = Candidate(1, grasp, circular(scene, grasp), "done", "<i>lost</i>")
    return Plan(scene, "ctc", grasp, path, certificate, (tried, other))


@pytest.fixture
def folder(tmp_path: Path, plan: Plan) -> Path:
    found = tmp_path / "out"
    found.mkdir()
    write_plan(plan, found)
    return found


def data_of(page: Path) -> dict[str, Any]:
    found = re.findall(r'id="data">(.*?)</script>', page.read_text("utf-8"))
    return dict(json.loads(found[0]))


def test_a_folder_becomes_a_page_in_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(folder)]) == 0
    assert f"written: {folder / 'view.html'}" in capsys.readouterr().out
    page = (folder / "view.html").read_text("utf-8")
    (plan,) = data_of(folder / "view.html")["plans"]
    assert plan["name"] == "ctc, the method of 2009" and plan["verdict"] == "certified"
    # both candidates' paths follow from their grasps; so do the worst cases from the plan
    assert set(plan["tried"]) == {"0-0", "0-1", "1-0", "1-1", "1-2"}
    assert "&lt;i&gt;lost&lt;/i&gt;" in page and "<i>lost" not in page
    assert "Worst cases: 3" in page and "thickness of the flap" in page


def test_a_plan_without_certificate_is_certified(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "certificate.json").unlink()
    two = [str(folder / "plan.json"), str(folder / "worst-1.json")]
    out = folder / "both.html"
    assert main(["view", *two, "--out", str(out), "--no-alternatives"]) == 0
    plans = data_of(out)["plans"]
    assert [plan["name"] for plan in plans] == ["ctc, the method of 2009", "worst-1"]
    assert [plan["tried"] for plan in plans] == [{}, {}]
    assert out.read_text("utf-8").count('class="view"') == 2


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grasp": {"x": -0.02, "compression": 5e-4}}, "path.waypoints[0]"),
        ({"candidates": [{"grasp": {"x": 1.0, "compression": 1e-4}}]}, "plan.candidates[0].grasp"),
        ({"candidates": [{"path": "ctc"}]}, "plan.candidates[0].grasp: allowed is an object"),
        (
            {"candidates": [{"grasp": {"x": 10**400, "compression": 1e-4}}]},
            "plan.candidates[0].grasp: int too",
        ),
        ({"candidates": [{"grasp": AT, "max_strain": 10**400}]}, "plan.candidates[0]: int too large"),
        ({"planner": "\ud800"}, r"'\ud800' in a text, allowed whole characters"),
    ],
)
def test_a_plan_that_is_wrong_is_refused(
    folder: Path, change: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "plan.json"
    file.write_text(json.dumps(json.loads(file.read_text("utf-8")) | change), "utf-8")
    assert main(["view", str(folder)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(file) in line and said in line
    assert not (folder / "view.html").exists()


def test_a_planner_may_be_called_as_rich_writes_markup(folder: Path) -> None:
    file = folder / "plan.json"
    file.write_text(json.dumps(json.loads(file.read_text("utf-8")) | {"planner": "a[/b]"}), "utf-8")
    assert main(["view", str(folder), "--no-alternatives"]) == 0
    assert data_of(folder / "view.html")["plans"][0]["name"] == "a[/b]"


def test_a_name_in_brackets_is_shown_in_a_terminal() -> None:
    said = io.StringIO()
    with Under("a[/b]", Console(file=said, force_terminal=True, width=80)) as under:
        under.step()
    assert "a[/b], 1 increments" in said.getvalue()


@pytest.mark.parametrize("name", ["plan.json", "linked.json", "certificate.json"])
def test_a_page_does_not_replace_what_it_shows(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "linked.json").symlink_to(folder / "plan.json")
    before = (folder / name).read_bytes()
    assert main(["view", str(folder), "--out", str(folder / name)]) == 2
    assert "allowed another file: this one is read" in capsys.readouterr().err
    assert (folder / name).read_bytes() == before


def test_a_certificate_of_another_scene_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = folder / "plan.json"
    plan = json.loads(file.read_text("utf-8"))
    plan["scene"]["tissue"]["modulus"] *= 2
    file.write_text(json.dumps(plan), "utf-8")
    assert main(["view", str(folder)]) == 2
    assert "certificate.json: not of plan.json beside it" in capsys.readouterr().err


def test_where_there_is_nothing_to_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path)]) == 2
    assert "no plan.json in it or in its folders" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "missing.json")]) == 2
    assert "missing.json" in capsys.readouterr().err


def test_the_folder_of_a_comparison(tmp_path: Path) -> None:
    for name in ("swift", "ctc", "swift-force"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "plan.json").touch()
    assert [file.parent.name for file in plan_files(tmp_path)] == ["ctc", "swift", "swift-force"]


def test_the_method_of_2009_comes_first_and_the_best_of_the_others_second() -> None:
    certified, failed = (False, False, 0.2), (True, True, 0.1)
    fragile, best = (False, True, 0.05), (False, False, 0.1)
    assert first_pair(["swift"], [best]) == [0]
    assert first_pair(["swift", "ctc", "eased", "x"], [certified, best, fragile, failed]) == [1, 0]
    assert first_pair(["swift", "eased", "ctc"], [certified, best, failed]) == [2, 1]
    assert first_pair(["eased", "x", "swift"], [certified, failed, best]) == [0, 2]


def test_a_page_beside_a_plan_that_is_made(tmp_path: Path) -> None:
    asked = ["--planner", "ctc", "--resolution", "coarse", "--no-pictures", "--out", str(tmp_path / "out")]
    page = tmp_path / "pages" / "lift.html"
    assert main(["plan", "homogeneous", *asked, "--html", str(page)]) == 0
    (plan,) = data_of(page)["plans"]
    assert plan["verdict"] == "certified" and plan["tried"] == {}
    assert "`retract view` on this plan" in page.read_text("utf-8")
