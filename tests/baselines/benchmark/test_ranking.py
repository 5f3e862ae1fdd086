"""What rows say of each method, how methods are ranked, and the report of it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.benchmark.splits import Benchmark, load_benchmark
from baselines.jobs.journal import Row


@pytest.fixture(scope="module")
def benchmark() -> Benchmark:
    return load_benchmark("benchmark").model_copy(update={"bootstrap": 50})


def made_up(method: str, strains: list[float | None], run: int = 0, **changes: Any) -> list[Row]:
    """Rows of one method; None where it slipped."""
    return [
        {
            "method": method,
            "run": run,
            "split": "test",
            "split_version": 1,
            "split_hash": "0123456789abcdef",
            "code": "1.0+abc",
            "number": k,
            "scene_hash": f"scene {k}",
            "certified": strain is not None,
            "reason": "ok" if strain is not None else "slip",
            "detail": "",
            "survival": None,
            "firm_strain": None,
            "closed_loop": None,
            "max_strain": 0.3 if strain is None else strain,
            "required_friction": 0.6 if strain is None else 0.4,
            "clearance": 1e-5,
            "strain_limit": 0.5,
            "friction_limit": 0.5,
            "evaluations": 10,
            "decisions": 0,
            "transfer": None,
            "timing": {"seconds": 1.0, "decision_seconds": 0.0},
        }
        | changes
        for k, strain in enumerate(strains)
    ]


@pytest.fixture
def rows() -> list[Row]:
    return [
        *made_up("ctc", [0.2, 0.2, 0.4, None]),
        *made_up("mine", [0.1, 0.4, None, None], run=0),
        *made_up("mine", [0.1, None, 0.2, None], run=1, transfer="ok", decisions=10),
    ]


def test_scores_compare_with_the_best_known_of_each_scene(rows: list[Row]) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import best_known, scores_by_method, summaries

    best = best_known(rows, {})
    scores = scores_by_method(rows, best)
    assert scores["ctc"] == pytest.approx(np.array([[0.5, 1.0, 0.5, 0.0]]))
    assert scores["mine"] == pytest.approx(np.array([[1.0, 0.5, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0]]))
    first, second = summaries(rows, best, 0, 200)
    assert (first.method, second.method) == ("ctc", "mine")
    assert (first.certified.value, second.certified.value) == (0.75, 0.5)
    # of three scenes that ctc certifies, the runs of the other do two each
    assert second.of_reference == pytest.approx(4 / 6)
    assert second.failures["slip"] == 0.5 and second.runs == 2 and second.scenes == 4
    assert second.excess.value == pytest.approx(0.0)  # 1, 2, 1, 1 times the best
    assert second.friction_margin == pytest.approx(0.2)
    assert second.transfer == 1 and np.isnan(first.transfer)
    for summary in (first, second):
        assert summary.certified.low <= summary.certified.value <= summary.certified.high
        assert summary.score.low <= summary.score.value <= summary.score.high
    assert str(summaries(rows, best, 0, 200)) == str([first, second])


def test_what_was_known_before_counts_too(rows: list[Row]) -> None:
    """A method alone is compared with others' retractions, not with its own."""
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import best_known, scores_by_method, summaries

    known = {f"scene {k}": 0.1 for k in range(4)}
    alone = made_up("ctc", [0.2, 0.2, 0.05, None])
    assert scores_by_method(alone, known)["ctc"] == pytest.approx(np.array([[0.5, 0.5, 2.0, 0.0]]))
    (summary,) = summaries(alone, known, 0, 50)
    assert summary.excess.value == pytest.approx(1.0)
    assert best_known(alone, known) == {**known, "scene 2": 0.05}


def test_without_anything_to_compare_with_there_is_no_score() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.ranking import in_text
    from baselines.benchmark.scores import summaries

    (summary,) = summaries(made_up("ctc", [0.2, None]), None, 0, 50)
    assert summary.certified.value == 0.5
    assert np.isnan(summary.score.value) and np.isnan(summary.excess.value)
    assert "certified" in in_text([summary]) and "score" not in in_text([summary])


def test_a_method_is_scored_on_the_scenes_that_it_was_judged_on(rows: list[Row]) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.ranking import in_text
    from baselines.benchmark.scores import best_known, summaries

    some = [*rows, *made_up("slow", [0.1, 0.1])]
    found = summaries(some, best_known(some, {}), 0, 50)
    assert {s.method: s.scenes for s in found} == {"ctc": 4, "mine": 4, "slow": 2}
    slow = next(s for s in found if s.method == "slow")
    assert slow.certified.value == 1 and slow.of_reference == 1 and slow.excess.value == pytest.approx(0)
    assert "| slow | 100 % (16 to 100) |" in in_text(found) and "| ctc | 75 % (" in in_text(found)


def test_the_interquartile_mean_is_that_of_the_middle_half() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import interquartile_mean

    assert interquartile_mean(np.array([[0.0, 1.0, 2.0, 100.0]])) == pytest.approx(1.5)


def test_the_report_is_whole(rows: list[Row], benchmark: Benchmark, tmp_path: Path) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.report import write_report

    curves = {"mine": [[{"steps": 10, "success": 0.2}, {"steps": 20, "success": 0.5}]] * 2}
    written = write_report(rows, tmp_path, benchmark, "retract benchmark", curves, {})
    assert sorted(written) == sorted(tmp_path.iterdir())
    with (tmp_path / "benchmark.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(rows) and "timing" not in lines[0]
    text = (tmp_path / "benchmark.md").read_text()
    assert "| mine (2 seeds) | 50 % (" in text and "slip 50 %" in text
    for picture in written:
        if picture.suffix == ".png":
            assert f"({picture.name})" in text and picture.read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "benchmark.html").read_text()
    assert page.count("<img ") == 3 and "src='http" not in page
    assert "<b>certified</b>" in page and "<pre>from retract_env.grasp" in page and "**" not in page
    for told in (text, page):
        assert "version 1, 0123456789abcdef; retract 1.0+abc" in told
        assert "A try on the first 4 of its 100 scenes" in told


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0, "0 %"),
        (1, "100 %"),
        (1 / 300, "0.3 %"),
        (0.005, "0.5 %"),
        (0.995, "99.5 %"),
        (0.9996, "99.96 %"),
        (299 / 300, "99.7 %"),
        (0.124, "12 %"),
        (np.nan, ""),
    ],
)
def test_nearly_all_is_not_all(share: float, text: str) -> None:
    from baselines.benchmark.ranking import _percent

    assert _percent(share) == text


def test_a_report_that_fails_leaves_the_old_one(
    rows: list[Row], benchmark: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark import report

    def fail(*_: Any) -> str:
        raise OSError("disk full")

    (tmp_path / "benchmark.csv").write_text("old")
    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        report.write_report(rows, tmp_path, benchmark, "", {}, {})
    assert [file.name for file in tmp_path.iterdir()] == ["benchmark.csv"]
    assert (tmp_path / "benchmark.csv").read_text() == "old"


def test_who_crashes_on_hard_scenes_plays_no_better_for_it() -> None:
    """Nothing handed in by what plays elsewhere counts as a failure there; a planner plays nowhere."""
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import summaries

    played: dict[str, Any] = {"closed_loop": 0.8, "transfer": "ok"}
    crashed = made_up("mine:f", [None], reason="raised", max_strain=None)[0] | {"number": 1}
    rows = [*made_up("mine:f", [0.2], **played), crashed, *made_up("ctc", [None], max_strain=None)]
    found = {one.method: one for one in summaries(rows, None, 0, 50)}
    assert (found["mine:f"].closed_loop.value, found["mine:f"].transfer) == pytest.approx((0.4, 0.5))
    assert np.isnan(found["ctc"].closed_loop.value) and np.isnan(found["ctc"].transfer)


def test_methods_are_ranked_by_certified_then_survival_then_excess() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import best_known, summaries

    rows = [
        *made_up("lucky", [0.1, 0.1, None, None], survival=0.5),
        *made_up("firm", [0.3, 0.3, 0.3, 0.3], survival=1.0, firm_strain=0.3),
        *made_up("light", [0.1, 0.1, 0.1, 0.1], survival=0.4, firm_strain=0.2),
        *made_up("heavy", [0.4, 0.4, 0.4, 0.4], survival=1.0, firm_strain=0.4),
    ]
    found = summaries(rows, best_known(rows, {}), 0, 50)
    assert [s.method for s in found] == ["firm", "heavy", "light", "lucky"]
    firm, _, light, lucky = found
    assert (firm.survival.value, light.survival.value) == pytest.approx((1.0, 0.4))
    assert light.firm_excess.value == pytest.approx(1.0) and light.excess.value == pytest.approx(0.0)
    assert (light.firm, lucky.firm) == (1, 0) and np.isnan(lucky.firm_excess.value)


def test_what_is_known_of_some_scenes_has_an_interval_of_its_own() -> None:
    """Be it of one scene in ten, which most samples leave out."""
    pytest.importorskip("rliable")
    from baselines.benchmark.ranking import in_text
    from baselines.benchmark.scores import best_known, summaries

    strains: list[float | None] = [0.2, *[None] * 9]
    (one,) = summaries(made_up("one", strains), {f"scene {k}": 0.1 for k in range(10)}, 0, 200)
    assert (one.excess.low, one.excess.value, one.excess.high) == pytest.approx((1.0, 1.0, 1.0))
    rows = made_up("never", [None] * 10, survival=0.0, timing={"seconds": None, "decision_seconds": 0.0})
    (never,) = summaries(rows, best_known(rows, {f"scene {k}": 0.1 for k in range(10)}), 0, 50)
    assert never.certified.value == 0 and 0.2 < never.certified.high < 0.4
    assert np.isnan(never.excess.value) and np.isnan(never.seconds)
    assert "| never | 0 % (0 to 31) | 0 % (0 to 31) | none |" in in_text([never])


def test_what_differs_from_seed_to_seed_is_not_averaged_out_over_scenes() -> None:
    """Of two seeds, one that certifies everything and one nothing say little, on however many scenes."""
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import summaries

    rows = [*made_up("mine", [0.2] * 100, run=0), *made_up("mine", [None] * 100, run=1)]
    (found,) = summaries(rows, {f"scene {k}": 0.2 for k in range(100)}, 0, 200)
    for share in (found.certified, found.score):
        assert (share.low, share.value, share.high) == pytest.approx((0.0, 0.5, 1.0))


def test_shares_of_draws_that_are_all_alike_have_an_interval_over_scenes() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import summaries

    (found,) = summaries(made_up("mine", [0.2] * 100, survival=1.0, closed_loop=1.0), None, 0, 50)
    assert found.survival == found.closed_loop == found.certified
    assert found.survival.high == 1 and found.survival.low == pytest.approx(0.025 ** (1 / 100))


def test_what_went_wrong_with_a_method_from_elsewhere_is_told(benchmark: Benchmark, tmp_path: Path) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.report import write_report

    ill = made_up("mine:f", [None, None], reason="raised", detail="KeyError: 'x' (mine.py, line 3)")
    write_report([*made_up("ctc", [0.2, 0.2]), *ill], tmp_path, benchmark, "retract", {}, {})
    for name in ("benchmark.md", "benchmark.html"):
        text = (tmp_path / name).read_text().replace("&#x27;", "'")
        assert "mine:f: raised KeyError: 'x' (mine.py, line 3), 2 times" in text
        assert "raised 100 %" in text
