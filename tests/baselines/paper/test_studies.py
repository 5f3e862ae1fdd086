"""Studies: their work, and that what their pages say follows from the data, whichever way they fall."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.jobs.journal import Row, key_of
from baselines.paper.experiments import Experiment
from baselines.paper.studies import STUDIES, fig7, fig8, fig12, light_grip, pruning, study
from baselines.paper.study import Claim, Report, paper_scene, percent, with_line, write
from planners.paths import PATHS
from retract_env.spring import SpringModel

ROOT = Path(__file__).resolve().parents[3]
WORK = {
    "fig7": 2, "fig8": 80, "fig9": 1, "fig11": 44, "fig12": 1250, "pruning": 6, "light_grip": 420,
    "robustness": 1025, "verification": 86,
}  # fmt: skip


def rows_of(experiments: list[Experiment], result: Callable[[Row], Row]) -> list[Row]:
    """Rows as the finite elements might have found them: result of each one's label and arguments."""
    return [{**one.label, **result({**one.arguments, **one.label})} for one in experiments]


def retracted(strain: float, reason: str = "ok", friction: float = 0.2) -> Row:
    return {
        "compression": 1e-3,
        "reason": reason,
        "max_strain": strain,
        "required_friction": friction,
        "clearance": 0.0,
    }


def reported(name: str, rows: list[Row]) -> Report:
    report = study(name).report(rows)
    assert isinstance(report.figure.axes, list)
    assert report.figure.axes
    return report


def agreement(report: Report, words: str) -> Claim:
    (claim,) = (claim for claim in report.claims if words in claim.said)
    return claim


# --- The registry


def test_names_are_listed_without_importing_the_studies() -> None:
    code = (
        "import sys\n"
        "from baselines.cli.app import main\n"
        "main(['reproduce', '--help'])\n"
        "print(sorted({'matplotlib', 'planners', 'baselines.paper.study'} & set(sys.modules)))\n"
    )
    environment = os.environ | {"COLUMNS": "200", "TERM": "dumb"}
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert ", ".join(STUDIES) in " ".join(told.split())
    assert told.splitlines()[-1] == "[]"


@pytest.mark.parametrize("name", list(STUDIES))
def test_a_study_bears_the_name_that_it_goes_by(name: str) -> None:
    assert study(name).name == name


def test_every_file_of_the_folder_is_a_study() -> None:
    folder = ROOT / "baselines" / "paper" / "studies"
    assert {f"baselines.paper.studies.{path.stem}" for path in folder.glob("[!_]*.py")} == set(
        STUDIES.values()
    )


# --- Work


@pytest.mark.parametrize("name", list(STUDIES))
def test_the_work_is_plain_data_and_no_piece_is_done_twice(name: str) -> None:
    works = [experiment.work("fine") for experiment in study(name).experiments()]
    assert len({key_of(work) for work in works}) == len(works) == WORK[name]
    assert json.loads(json.dumps(works, allow_nan=False)) == works


def test_lines_are_counted_from_the_fixed_end() -> None:
    scene = paper_scene("homogeneous")
    lined = with_line(scene, 0.25, math.radians(45))
    assert lined.line_of_sight.target == scene.line_of_sight.target
    assert lined.line_of_sight.slope == pytest.approx(scene.line_of_sight.slope)
    assert lined.tissue == scene.tissue


def test_a_report_is_written_whole(tmp_path: Path) -> None:
    fig8 = study("fig8")
    rows = rows_of(fig8.experiments(), lambda _: retracted(0.3))
    written = write(fig8, rows, tmp_path, "coarse")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig8.csv", "fig8.md", "fig8.png"]
    assert {path.name for path in written} == {"fig8.csv", "fig8.md", "fig8.png"}
    page = (tmp_path / "fig8.md").read_text()
    assert page.startswith("# Fig. 8")
    assert "| said | found | agrees |" in page
    assert "`retract reproduce fig8 --resolution coarse`" in page
    again = [path.read_bytes() for path in sorted(tmp_path.iterdir())]
    write(fig8, rows, tmp_path, "coarse")
    assert [path.read_bytes() for path in sorted(tmp_path.iterdir())] == again


# --- Figs. 8 and 11


def by_path(**strain: float) -> Callable[[Row], Row]:
    return lambda row: retracted(strain[row["path"]])


LOWEST = by_path(ctc=0.28, circular=0.30, linear60=0.4, linear75=0.4)
EQUAL = by_path(ctc=0.300, circular=0.297, linear60=0.4, linear75=0.4)
HIGHEST = by_path(ctc=0.40, circular=0.30, linear60=0.30, linear75=0.30)


@pytest.mark.parametrize(("found", "agrees"), [(LOWEST, "yes"), (EQUAL, "yes"), (HIGHEST, "no")])
def test_fig8_compares_paths(found: Callable[[Row], Row], agrees: str) -> None:
    report = reported("fig8", rows_of(study("fig8").experiments(), found))
    assert agreement(report, "(a)").agrees == agrees
    assert agreement(report, "(b)").agrees == ("yes" if agrees == "no" else "no")


def test_fig8_names_the_exceptions() -> None:
    def found(row: Row) -> Row:
        failed = row["path"] == "ctc" and -0.016 < row["x"] < -0.014
        return retracted(0.31, "slip") if failed else LOWEST(row)

    report = reported("fig8", rows_of(study("fig8").experiments(), found))
    assert agreement(report, "(a)").agrees == "in part"
    assert "-15.0 mm (circular and linear, 60° and linear, 75°)" in agreement(report, "(a)").found
    assert any("CTC: 2 needs too much friction" in note for note in report.notes)


def test_what_fails_is_worse_than_what_does_not() -> None:
    assert fig8.better(0.49, math.nan)
    assert not fig8.better(math.nan, 0.49)
    assert not fig8.better(math.nan, math.nan)
    assert not fig8.better(0.30, 0.303)
    assert fig8.better(0.30, 0.31)


@pytest.mark.parametrize("name", ["fig8", "fig11"])
def test_a_further_kind_of_path_does_not_enter_the_papers_figures(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = study(name)
    before = [key_of(one.work("coarse")) for one in figure.experiments()]
    monkeypatch.setitem(PATHS, "steep", PATHS["ctc"])
    rows = rows_of(figure.experiments(), LOWEST)
    assert [key_of(one.work("coarse")) for one in figure.experiments()] == before
    assert len(write(figure, rows, tmp_path, "coarse")) == 3


@pytest.mark.parametrize(("veins", "agrees"), [(3, "yes"), (6, "in part")])
def test_fig11_finds_the_best_grasp(veins: int, agrees: str) -> None:
    def found(row: Row) -> Row:
        return retracted(LOWEST(row)["max_strain"] - 0.05 * (row["veins_beyond"] == veins))

    report = reported("fig11", rows_of(study("fig11").experiments(), found))
    assert agreement(report, "usually").agrees == "yes"
    assert agreement(report, "same best grasp").agrees == agrees
    assert {row["veins_beyond"] for row in report.table} == set(range(11))


# --- Fig. 12


def best_at(place: Callable[[float, float], float], friction: float = 0.0) -> list[Row]:
    """Rows whose strain is least where `place` of (position, slope) says, as a part from the open end."""
    return rows_of(
        fig12.line_experiments(fig12.POSITIONS, fig12.SLOPES, 50),
        lambda row: retracted(
            0.25 + abs(1 + row["x"] / 0.05 - place(row["position"], row["slope"])), friction=friction
        ),
    )


def test_fig12_agrees_with_what_the_paper_saw() -> None:
    report = reported("fig12", best_at(lambda position, slope: 0.1 + 0.4 * position + 0.0015 * (90 - slope)))
    assert [claim.agrees for claim in report.claims] == ["yes", "yes", "yes"]


def test_fig12_disagrees_with_the_opposite() -> None:
    report = reported(
        "fig12", best_at(lambda position, slope: 0.9 - 0.4 * position + 0.0015 * slope, friction=0.3)
    )
    assert [claim.agrees for claim in report.claims] == ["no", "no", "in part"]  # the same without any limit


def test_fig12_leaves_out_what_the_friction_limit_forbids() -> None:
    def found(row: Row) -> Row:
        far = row["x"] < -0.03
        return retracted(0.2 if far else 0.3, friction=0.9 if far else 0.1)

    rows = rows_of(fig12.line_experiments((0.25,), (45,), 10), found)
    assert {row["x"] > -0.031 for row in fig12.best_of(rows, 0.5).values()} == {True}
    assert {row["x"] < -0.031 for row in fig12.best_of(rows, math.inf).values()} == {True}
    assert fig12.best_of(rows, 0.05) == {}


# --- Fig. 7


def springs(name: str, factor: Callable[[Any], Any]) -> Row:
    """A row in which brute force finds the spring model's stiffness times a factor of x."""
    scene = paper_scene(name)
    x = np.linspace(-0.0495, -0.0006, 640)
    k = SpringModel(scene.tissue).k_eq(x)
    return {
        "scene": name,
        "x": x.tolist(),
        "k_fem": (k * factor(x)).tolist(),
        "strain_fem": np.full(len(x), 1 / scene.tissue.height).tolist(),
        "k_spring": k.tolist(),
        "nodes": 10_000,
        "fem_seconds": 2.0,
        "fem_cpu_seconds": 2.0,
        "spring_seconds": 0.002,
        "spring_cpu_seconds": 0.002,
    }


def test_fig7_agrees_where_both_are_the_same() -> None:
    report = reported("fig7", [springs(name, np.ones_like) for name in fig7.SCENES])
    assert {claim.agrees for claim in report.claims} == {"yes"}
    assert "1000 times less" in report.claims[1].found
    assert "correlate with 1.00" in report.notes[0]


def test_fig7_disagrees_where_brute_force_sees_other_minima() -> None:
    def upside_down(x: Any) -> Any:
        return SpringModel(paper_scene("ten_veins").tissue).k_eq(x) ** -2 * 1e14

    report = reported("fig7", [springs("ten_veins", upside_down)])
    assert report.claims[0].agrees == "no"
    assert "correlate with -" in report.notes[0]


# --- Pruning, the lightest grip


def searches(cpu: dict[str, float], strain: float = 0.26) -> list[Row]:
    def found(row: Row) -> Row:
        return {
            "x": -0.03,
            "max_strain": strain if row["pruning"] == "bound" else 0.26,
            "candidates": 11,
            "pruned": 0,
            "increments": int(100 * cpu[row["pruning"]]),
            "cpu_seconds": cpu[row["pruning"]],
            "wall_seconds": cpu[row["pruning"]],
        }

    return rows_of(pruning.pruning_experiments(["ten_veins"]), found)


@pytest.mark.parametrize(
    ("bound", "strain", "agrees"),
    [(2.5, 0.26, "yes"), (7.0, 0.26, "in part"), (11.0, 0.26, "no"), (2.5, 0.3, "no")],
)
def test_pruning_is_judged_by_what_it_saves_and_finds(bound: float, strain: float, agrees: str) -> None:
    report = reported("pruning", searches({"none": 10.0, "bound": bound, "squeeze": 1.0}, strain))
    assert [claim.agrees for claim in report.claims] == [agrees]


def test_grips_are_compared_on_the_same_grasps() -> None:
    def found(row: Row) -> Row:
        strain = {("eq5", "ctc"): 0.28, ("eq5", "circular"): 0.28, ("light", "ctc"): 0.11}.get(
            (row["grip"], row["path"]), 0.18
        )
        return retracted(strain, "slip" if row["x"] > -0.012 else "ok")

    experiments = light_grip.grip_experiments(["homogeneous"], (0.35, 0.25))
    rows = rows_of(experiments, found)
    report = reported("light_grip", rows)
    assert [claim.agrees for claim in report.claims] == ["yes", "yes"]
    assert "35 %: 0.280 to 0.110" in report.claims[0].found
    strain = light_grip.strain_table(rows, "homogeneous", "ctc", "light")
    assert strain.shape == (2, 10)
    assert np.isnan(strain[:, -2:]).all()
    assert not np.isnan(strain[:, :-2]).any()


@pytest.mark.parametrize(("light", "agrees"), [(0.279, ["no", "no"]), (0.27, ["yes", "yes"])])
def test_grips_within_two_percent_are_equal(light: float, agrees: list[str]) -> None:
    experiments = light_grip.grip_experiments(["homogeneous"], (0.35,))
    rows = rows_of(
        experiments, lambda row: retracted(light if (row["grip"], row["path"]) == ("light", "ctc") else 0.28)
    )
    assert [claim.agrees for claim in reported("light_grip", rows).claims] == agrees


def test_of_grips_that_hold_nowhere_nothing_is_said() -> None:
    experiments = light_grip.grip_experiments(["homogeneous"], (0.35, 0.25))
    rows = rows_of(experiments, lambda row: retracted(0.28, "slip" if row["position"] == 0.25 else "ok"))
    assert all("25 %" not in claim.found for claim in reported("light_grip", rows).claims)
    rows = rows_of(experiments, lambda _: retracted(0.28, "slip"))
    assert reported("light_grip", rows).claims == []


def test_percent() -> None:
    assert percent(0.25) == "25 %"
