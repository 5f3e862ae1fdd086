"""The study of what plans survive: its order, its ladder of grips, its words, and its rows without the
console."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from baselines.jobs.journal import Journal, Row, key_of
from baselines.paper import robustness_rows, survival
from baselines.paper.experiments import Experiment
from baselines.paper.robustness_rows import side_by_side
from baselines.paper.studies.robustness import METHODS, STANDARD, STUDY, robustness_experiments
from baselines.paper.study import Claim, paper_scene, write
from baselines.paper.survival import lightest, planned, scaled
from retract_env.scene import UNKNOWNS, Uncertainty


def doubled(resolution: str, n: int) -> Row:
    return {"twice": 2 * n, "on": resolution}


# --- Work


def test_what_is_most_telling_comes_first() -> None:
    experiments = robustness_experiments(STANDARD, 3, 10, 5)
    labels = [(e.label["scene"], e.label["method"], e.label["demand"]) for e in experiments]
    assert len(set(labels)) == len(labels)
    scenes = list(dict.fromkeys(label[0] for label in labels))
    assert scenes == [*STANDARD, "test 0", "test 1", "test 2"]
    assert {method for scene, method, _ in labels if scene == "test 1"} >= set(METHODS)
    first = labels.index(("test 0", "eased", 1.0))
    assert all(labels.index((scene, "elastica", 1.0)) < first for scene in STANDARD)


def test_scenes_have_draws_of_their_own_and_methods_share_them() -> None:
    experiments = robustness_experiments(STANDARD, 3, 10, 5)
    seeds: dict[str, set[int]] = {}
    for one in experiments:
        seeds.setdefault(one.label["scene"], set()).add(one.arguments["seed"])
    assert all(len(mine) == 1 for mine in seeds.values())
    assert len(set().union(*seeds.values())) == len(seeds)
    others = {survival.ROD_SEED, 0, 20_091_011}
    assert not others & set().union(*seeds.values())


@pytest.mark.parametrize("by", [0.25, 1.0, 1.25])
def test_a_scaled_prior_has_ranges_as_many_times_as_wide(by: float) -> None:
    prior = Uncertainty()
    found = scaled(prior, by)
    for name in UNKNOWNS:
        if name != "poisson":
            assert getattr(found, name) == pytest.approx(by * getattr(prior, name))
    assert prior.poisson is not None
    assert found.poisson is not None
    assert sum(found.poisson) / 2 == pytest.approx(sum(prior.poisson) / 2, abs=6e-3)  # cut off at .49
    assert scaled(prior, 0.0) == Uncertainty.none()


@pytest.mark.parametrize("needed", [0.23, 0.5, 0.9])
def test_the_lightest_grip_is_just_above_what_survives(
    needed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = paper_scene("homogeneous")
    grasp = SimpleNamespace(x=-0.03, compression=1e-3)
    monkeypatch.setattr(survival, "PLANNERS", {"ctc": lambda *_, **__: SimpleNamespace(grasp=grasp)})

    def rung(scene: Any, grasp: Any, path: str, part: float) -> Row:
        return {"part": part, "survival": 0.995 if part >= needed else 0.9}

    monkeypatch.setattr(survival, "rung", rung)
    monkeypatch.setattr(survival, "certify", lambda *_: None)
    monkeypatch.setattr(survival, "judged", lambda _, grip, *__: {"compression": grip.compression})
    row = lightest("coarse", scene.dump(), "ctc", 0, 1, 0.0)
    assert needed <= row["part"] <= 1.1 * needed
    assert row["compression"] == pytest.approx(row["part"] * 1e-3)
    parts = [one["part"] for one in row["ladder"]]
    assert parts == sorted(parts, reverse=True)


def test_a_plan_is_judged_on_draws() -> None:
    """An eased plan needs all of its friction: the rod and finite elements both see draws that slip."""
    row = planned("coarse", paper_scene("homogeneous").dump(), "eased", 1.0, 4, 52_100_000, 0.9)
    assert row["reason"] == "ok"
    assert row["draws"] == 4
    assert 0 <= row["survived"] <= 4
    assert row["survived"] == 4 or row["ends"]
    assert 0.2 < row["by_rod"] < 0.98
    assert row["holds"] is False
    assert row["bound"] is None  # hopeless


# --- What is said


def rows_of(strains: dict[str, float], survives: dict[str, float], flaps: int) -> list[Row]:
    rows = []
    for one in robustness_experiments(STANDARD, flaps, 50, 50):
        method, draws = one.label["method"], one.arguments["count"]
        part = survives.get(method, 0.6)
        row: Row = {
            "x": -0.03,
            "compression": 1e-3,
            "force": None,
            "reason": "ok",
            "max_strain": strains.get(method, 0.1),
            "required_friction": 0.4,
            "clearance": 0.0,
            "holds": part == 1.0,
            "bound": 1.008 - part,
            "stated_failures": 0,
            "by_rod": part,
            "draws": draws,
            "survived": math.floor(part * draws),
            "ends": "",
        }
        if method.endswith("lightest"):
            row["part"] = 0.6
            row["ladder"] = [
                {"part": p, "compression": p * 1e-3, "reason": "ok", "max_strain": 0.25 * p, "survival": part}
                for p in (1.0, 0.6)
            ]
        rows.append({**one.label, **row})
    return rows


FIRM = dict.fromkeys(("ctc", "circular", "ctc_lightest", "circular_lightest", "swift", "swift_force"), 1.0)
STRAINS = {"ctc": 0.25, "circular": 0.26, "ctc_lightest": 0.2, "circular_lightest": 0.17, "swift": 0.12}


def claim(rows: list[Row], words: str) -> Claim:
    (found,) = (c for c in STUDY.report(rows).claims if words in c.said)
    return found


def test_paths_are_compared_at_equal_survival() -> None:
    rows = rows_of(STRAINS, FIRM, 2)
    assert claim(rows, "closed by Eq. 5, CTC").agrees == "yes"
    at_equal = claim(rows, "at equal survival")
    assert at_equal.agrees == "no"
    assert at_equal.found.startswith("No: circular beats CTC")
    rows = rows_of({**STRAINS, "circular_lightest": 0.23}, FIRM, 2)
    assert claim(rows, "at equal survival").found.startswith("Yes")


def test_strains_within_two_percent_are_equal_in_word_and_verdict() -> None:
    for circular, agrees, begins in (
        (0.202, "no", "No: they are equal"),
        (0.206, "yes", "Yes"),
        (0.19, "no", "No: c"),
    ):
        found = claim(rows_of({**STRAINS, "circular_lightest": circular}, FIRM, 2), "at equal survival")
        assert found.agrees == agrees and found.found.startswith(begins)
    equal = rows_of({**STRAINS, "circular": 0.252}, FIRM, 3)
    assert claim(equal, "closed by Eq. 5, CTC").agrees == "no"
    next(r for r in equal if (r["scene"], r["method"]) == ("test 1", "circular"))["max_strain"] = 0.3
    assert claim(equal, "closed by Eq. 5, CTC").agrees == "in part"


def test_nothing_is_said_of_plans_that_hold_where_none_does() -> None:
    rows = [row | {"holds": False} for row in rows_of(STRAINS, FIRM, 1)]
    assert not [c for c in STUDY.report(rows).claims if "the robust statement holds" in c.said]


def test_methods_are_compared_where_all_were_tried(tmp_path: Path) -> None:
    """On the third flap `circular` is missing, and CTC fails: that is no difference between the two."""
    rows = [r for r in rows_of(STRAINS, FIRM, 3) if (r["scene"], r["method"]) != ("test 2", "circular")]
    next(r for r in rows if (r["scene"], r["method"]) == ("test 2", "ctc"))["survived"] = 0
    found = claim(rows, "closed by Eq. 5, CTC").found
    assert "of the 2 that both were tried on" in found and found.count("100.00 % of 100 draws") == 2
    legends = [axes.get_legend() for axes in STUDY.report(rows).figure.axes]
    names = [text.get_text() for legend in legends if legend is not None for text in legend.get_texts()]
    assert "CTC, Eq. 5: 3" in names and "circular, Eq. 5: 2" in names


@pytest.mark.parametrize("more", [0, 40])
def test_a_page_of_some_rows_says_so(more: int, tmp_path: Path) -> None:
    rows = rows_of(STRAINS, FIRM, 1)
    page = write(STUDY, rows, tmp_path, "coarse", len(rows) + more)[2].read_text("utf-8")
    assert (f"Unfinished: {len(rows)} of {len(rows) + 40} rows are there" in page) == bool(more)
    assert ("Made by `retract reproduce robustness" in page) == (not more)


def test_eq5_is_wise_where_light_grips_fail_and_it_is_no_firmer_than_needed() -> None:
    words = "Eq. 5 looks wiser"
    assert claim(rows_of(STRAINS, FIRM, 1), words).agrees == "in part"
    assert claim(rows_of({**STRAINS, "ctc_lightest": 0.24}, FIRM, 1), words).agrees == "yes"
    sturdy = dict.fromkeys((*METHODS, *FIRM), 1.0)
    assert claim(rows_of(STRAINS, sturdy, 1), words).agrees == "no"


def test_demands_count_for_the_frontier_alone() -> None:
    rows = rows_of(STRAINS, FIRM, 2)
    for row in rows:
        if row["demand"] not in (0.0, 1.0):
            row["survived"] = 0
    assert claim(rows, "closing by position").agrees == "yes"


@pytest.mark.parametrize("known", [1, 5, 20, 40])
def test_a_report_of_what_is_known_so_far(known: int, tmp_path: Path) -> None:
    rows = rows_of(STRAINS, FIRM, 1)[:known]
    rows[0] |= {"reason": "no plan", "max_strain": None, "x": None, "survived": 0, "draws": 0}
    written = write(STUDY, rows, tmp_path, "coarse")
    assert {path.suffix for path in written} == {".csv", ".png", ".md"}


# --- Rows without the console


def test_rows_are_done_side_by_side() -> None:
    works = [Experiment(doubled, {"n": n}).work("coarse") for n in range(5)]
    found = {number: row for number, row, _ in side_by_side(works, 2, 300.0)}
    assert found == {n: {"twice": 2 * n, "on": "coarse"} for n in range(5)}
    assert list(side_by_side(works, 1, 0.0)) == []


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--methods", "swfit"], "--methods 'swfit', allowed eased, "),
        (["--scenes", "test0"], "--scenes 'test0', allowed homogeneous, "),
        (["--workers", "0"], "--workers 0, allowed from 1 on"),
        (["--seconds", "nan"], "--seconds nan, allowed from 0 on"),
        (["--resolution", "ultra"], "invalid choice: 'ultra'"),
    ],
)
def test_what_the_study_does_not_have_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], asked: list[str], said: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        robustness_rows.main(["--out", str(tmp_path / "here"), *asked])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "here").exists()


def test_what_the_journal_has_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[int] = []

    def here(works: list[Any], *_: object) -> Any:
        for number, _work in enumerate(works):
            done.append(number)
            yield number, {"reason": "ok", "max_strain": 0.1, "by_rod": 1.0, "survived": 2}, 1.0

    monkeypatch.setattr(robustness_rows, "side_by_side", here)
    asked = ["--out", str(tmp_path), "--draws", "2", "--flap-draws", "3"]
    asked += ["--scenes", "ten_veins", "test 0", "--methods", "ctc"]
    robustness_rows.main(asked)
    assert done == [0, 1]
    robustness_rows.main(asked)
    assert done == [0, 1]
    every = {key_of(e.work("fine")) for e in robustness_experiments(STANDARD, 1, 2, 3)}
    assert set(Journal(tmp_path / ".robustness.jsonl").rows) <= every
