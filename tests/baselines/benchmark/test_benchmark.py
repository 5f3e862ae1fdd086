"""The benchmark: frozen scenes, one judge for all, the same numbers again and for any number of workers."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.benchmark.methods import Method, compete, led_out
from baselines.benchmark.splits import Benchmark, BenchmarkError, load_benchmark
from baselines.benchmark.tasks import chosen, methods_of, numbers, tasks_of
from baselines.jobs.journal import Row, run_tasks
from baselines.learning.policies import PolicyError, save_policy
from planners import certify, plan
from planners.paths import ctc
from retract_env.config import read_yaml
from retract_env.grasp import Grasp
from retract_env.scene import Scene
from retract_env.scene.sampling import SceneRanges
from retract_env.task import default_scene
from tests.baselines.trained import easy_scene, policy

CONFIG = Path(__file__).resolve().parents[3] / "configs" / "benchmark.yaml"


@pytest.fixture(scope="module")
def benchmark() -> Benchmark:
    return load_benchmark(CONFIG)


def coarse(method: Method, scene: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A task that is judged on the coarse mesh."""
    return {
        "method": asdict(method),
        "split": "test",
        "number": 0,
        "scene": scene,
        "resolution": "coarse",
        "policy_physics": "fem",
        "policy_resolution": "coarse",
        "lead_out": 3,
        "seed": 0,
        "transfer": False,
    } | changes


# --- Splits


def test_the_frozen_scenes_are_those_that_they_were(benchmark: Benchmark) -> None:
    sizes = {name: len(split.scenes()) for name, split in benchmark.splits.items()}
    assert sizes == {"validation": 32, "test": 100, "shifted": 50}


def test_no_scene_is_in_two_splits(benchmark: Benchmark) -> None:
    hashes = [scene.hash for split in benchmark.splits.values() for scene in split.scenes()]
    assert len(set(hashes)) == len(hashes)


def test_shifted_scenes_lie_outside_what_is_trained_on(benchmark: Benchmark) -> None:
    trained = SceneRanges()
    for scene in benchmark.splits["shifted"].scenes():
        assert len(scene.tissue.veins) >= trained.veins[1]
        assert min(vein.modulus for vein in scene.tissue.veins) >= trained.vein_modulus[1]
        assert scene.tissue.height > trained.height[1]
        assert scene.line_of_sight.slope > trained.slope[1]


def test_a_change_of_the_scenes_is_noticed() -> None:
    data = read_yaml(CONFIG)
    data["splits"]["validation"]["seed"] = 20
    changed = Benchmark.from_data(data)
    with pytest.raises(BenchmarkError, match=r"^hash = '[0-9a-f]{16}', but these scenes have '[0-9a-f]{16}'"):
        changed.splits["validation"].scenes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ranges": {"colour": [0, 1]}}, "splits.test.ranges.colour: unknown key"),
        ({"ranges": {"veins": 3}}, "splits.test.ranges.veins = 3, allowed [least, greatest]"),
        ({"ranges": {"slope": [2, 1]}}, "splits.test.ranges.slope = [2, 1], allowed [least, greatest]"),
        ({"seed": 1}, "splits.test.seed = 1, allowed [2, 2.14748e+09]"),
        ({"hash": "abc"}, "splits.test.hash"),
    ],
)
def test_what_is_wrong_is_said(change: dict[str, Any], message: str) -> None:
    data = read_yaml(CONFIG)
    data["splits"]["test"] |= change
    with pytest.raises(BenchmarkError) as caught:
        Benchmark.from_data(data)
    assert message in str(caught.value)


# --- Methods


def test_a_planner_hands_in_what_it_planned() -> None:
    scene = Scene.from_data(easy_scene())
    row = compete(coarse(Method("planner", "ctc"), scene.dump()))
    best = plan(scene, "ctc", "coarse", workers=1).certificate
    assert row["certified"] and row["reason"] == "ok"
    assert row["max_strain"] == best.max_strain
    assert row["required_friction"] == best.required_friction
    assert row["evaluations"] > best.increments and row["timing"]["seconds"] > 0


def test_planners_numbers_are_the_same_again_and_with_more_workers(benchmark: Benchmark) -> None:
    scenes = benchmark.splits["test"].scenes(2)
    methods = [Method("planner", "eased"), Method("random", "random")]
    tasks = [coarse(m, s.dump(), number=k) for k, s in enumerate(scenes) for m in methods]
    alone = run_tasks(tasks, compete, None, jobs=1)
    together = run_tasks(tasks, compete, None, jobs=2)
    assert json.dumps(numbers(alone)) == json.dumps(numbers(together))


def test_who_finds_nothing_fails_for_the_commonest_reason() -> None:
    scene = default_scene().dump() | {"limits": {"strain": 0.5, "friction": 0.01}}
    row = compete(coarse(Method("planner", "ctc"), scene))
    assert not row["certified"] and row["reason"] in ("slip", "release")
    assert row["max_strain"] is None and row["evaluations"] > 0


def test_doing_nothing_does_not_expose_the_target() -> None:
    row = compete(coarse(Method("nothing", "nothing"), default_scene().dump()))
    assert not row["certified"] and row["reason"] == "not_visible"
    assert row["decisions"] == 64
    assert row["clearance"] < 0


def test_a_policy_is_judged_by_what_its_jaws_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan that is played through the environment gets, to the steps' size, its own certificate."""
    from baselines.benchmark import methods
    from retract_env.rollout import PathPolicy

    scene = default_scene()
    grasp = Grasp(-0.03, 0.2 * scene.tissue.height)
    path = ctc(scene, grasp)
    monkeypatch.setattr(methods, "acting", lambda method, task: PathPolicy(scene, grasp, path))
    row = compete(coarse(Method("policy", "player"), scene.dump()))
    alone = certify(scene, grasp, path, "coarse")
    assert row["certified"] and alone.certified
    # the environment's steps are straight, 2 mm or 6 degrees each: chords of the path's curve
    assert row["max_strain"] == pytest.approx(alone.max_strain, rel=0.02)
    assert row["required_friction"] == pytest.approx(alone.required_friction, abs=0.03)
    assert row["decisions"] == row["evaluations"] > 5


def test_a_path_goes_on_as_it_ended() -> None:
    scene = default_scene()
    path = ctc(scene, Grasp(-0.03, 1e-3))
    longer = led_out(path, 3)
    assert longer.waypoints[: len(path)] == pytest.approx(path.waypoints, abs=1e-15)
    steps = np.diff(longer.poses, axis=0)
    assert steps[-3:] == pytest.approx(np.repeat(steps[-4:-3], 3, axis=0), abs=1e-12)


def test_trained_policies_are_found_at_any_depth(benchmark: Benchmark, tmp_path: Path) -> None:
    for seed in (1, 0):
        save_policy(policy(seed), tmp_path / "a" / f"seed{seed}" / "policy")
    found = methods_of(benchmark, tmp_path)
    assert [m.name for m in found] == [
        *benchmark.planners,
        *benchmark.slow_planners,
        "toy",
        "toy",
        "random",
        "nothing",
    ]
    assert [m.run for m in found if m.kind == "policy"] == [0, 1]
    contents = {m.content for m in found if m.kind == "policy"}
    assert len(contents) == 2
    save_policy(policy(0), tmp_path / "again")
    with pytest.raises(BenchmarkError, match=r": both are toy, seed 0$"):
        methods_of(benchmark, tmp_path)
    (tmp_path / "again" / "policy.json").write_text("{}")
    with pytest.raises(PolicyError):
        methods_of(benchmark, tmp_path)


def test_tasks_are_plain_and_name_the_code(benchmark: Benchmark) -> None:
    tasks = tasks_of(benchmark, [Method("planner", "ctc")], ["validation"], most=2)
    assert [task["number"] for task in tasks] == [0, 1]
    assert json.loads(json.dumps(tasks)) == tasks
    assert all(task["resolution"] == "fine" and "+" in task["code"] for task in tasks)
    both = tasks_of(benchmark, [Method("planner", "ctc")], ["validation", "shifted:3"], most=2)
    assert [task["split"] for task in both] == ["validation"] * 2 + ["shifted"] * 3
    for wrong in ("exam", "test:", "test:0", "test:-1", "exam:3"):
        with pytest.raises(BenchmarkError, match=rf"^split = '{wrong}', allowed validation, test, shifted, "):
            tasks_of(benchmark, [], [wrong])


def test_methods_are_chosen_by_name(benchmark: Benchmark) -> None:
    methods = methods_of(benchmark, None)
    assert [m.name for m in chosen(methods, ["random", "ctc"])] == ["ctc", "random"]
    assert chosen(methods, None) == methods
    with pytest.raises(BenchmarkError, match=r"^method = 'luck', allowed ctc, eased, "):
        chosen(methods, ["luck"])


def test_slow_planners_are_judged_on_the_first_scenes_only(benchmark: Benchmark) -> None:
    split = benchmark.splits["validation"].model_copy(update={"slow": 2})
    few = benchmark.model_copy(update={"splits": {"validation": split}})
    tasks = tasks_of(few, methods_of(few, None), ["validation"])
    numbers = {
        name: [t["number"] for t in tasks if t["method"]["name"] == name] for name in ("ctc", "elastica")
    }
    assert numbers == {"ctc": list(range(32)), "elastica": [0, 1]}


@pytest.mark.slow
def test_a_policy_is_played_on_the_other_physics_too(tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    save_policy(policy(), tmp_path)
    row = compete(coarse(Method.trained(tmp_path), default_scene().dump(), transfer=True))
    assert row["transfer"] in ("ok", "not_visible", "slip", "strain", "release", "diverged")


# --- Scores and report


def made_up(method: str, strains: list[float | None], run: int = 0, **changes: Any) -> list[Row]:
    """Rows of one method; None where it slipped."""
    return [
        {
            "method": method,
            "run": run,
            "split": "test",
            "number": k,
            "scene_hash": f"scene {k}",
            "certified": strain is not None,
            "reason": "ok" if strain is not None else "slip",
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
    assert second.excess == pytest.approx(0.0)  # 1, 2, 1, 1 times the best
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
    assert summary.excess == pytest.approx(1.0)
    assert best_known(alone, known) == {**known, "scene 2": 0.05}


def test_without_anything_to_compare_with_there_is_no_score() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.report import in_text
    from baselines.benchmark.scores import summaries

    (summary,) = summaries(made_up("ctc", [0.2, None]), None, 0, 50)
    assert summary.certified.value == 0.5
    assert np.isnan(summary.score.value) and np.isnan(summary.excess)
    assert "certified" in in_text([summary]) and "score" not in in_text([summary])


def test_a_method_is_scored_on_the_scenes_that_it_was_judged_on(rows: list[Row]) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.report import in_text
    from baselines.benchmark.scores import best_known, summaries

    some = [*rows, *made_up("slow", [0.1, 0.1])]
    found = summaries(some, best_known(some, {}), 0, 50)
    assert {s.method: s.scenes for s in found} == {"ctc": 4, "mine": 4, "slow": 2}
    slow = next(s for s in found if s.method == "slow")
    assert slow.certified.value == 1 and slow.of_reference == 1 and slow.excess == pytest.approx(0)
    assert "| slow | 2 | 100 % (" in in_text(found) and "| ctc |  | 75 % (" in in_text(found)


def test_the_interquartile_mean_is_that_of_the_middle_half() -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.scores import interquartile_mean

    assert interquartile_mean(np.array([[0.0, 1.0, 2.0, 100.0]])) == pytest.approx(1.5)


def test_the_report_is_whole(rows: list[Row], tmp_path: Path) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark.report import write_report

    curves = {"mine": [[{"steps": 10, "success": 0.2}, {"steps": 20, "success": 0.5}]] * 2}
    written = write_report(rows, tmp_path, "fine", "retract benchmark", curves, {}, 0, 50)
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


@pytest.mark.parametrize(
    ("share", "text"),
    [(0, "0 %"), (1, "100 %"), (1 / 300, "0.3 %"), (299 / 300, "99.7 %"), (0.124, "12 %"), (np.nan, "")],
)
def test_nearly_all_is_not_all(share: float, text: str) -> None:
    from baselines.benchmark.report import _percent

    assert _percent(share) == text


def test_a_report_that_fails_leaves_the_old_one(
    rows: list[Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rliable")
    from baselines.benchmark import report

    def fail(*_: Any) -> str:
        raise OSError("disk full")

    (tmp_path / "benchmark.csv").write_text("old")
    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        report.write_report(rows, tmp_path, "fine", "", {}, {}, 0, 20)
    assert [file.name for file in tmp_path.iterdir()] == ["benchmark.csv"]
    assert (tmp_path / "benchmark.csv").read_text() == "old"


@pytest.mark.parametrize("harm", [lambda text: "{", lambda text: text.replace("hash", "hsah")])
def test_a_broken_configuration_is_one_line(tmp_path: Path, harm: Callable[[str], str]) -> None:
    file = tmp_path / "benchmark.yaml"
    file.write_text(harm(CONFIG.read_text()))
    with pytest.raises(BenchmarkError) as caught:
        load_benchmark(file)
    assert str(caught.value).startswith(str(file)) and "\n" not in str(caught.value)


def test_policies_may_move_on_another_physics(benchmark: Benchmark) -> None:
    """Judged by the same certifier all the same."""
    on_rods = benchmark.played_in("rod")
    assert (on_rods.policy_physics, on_rods.policy_resolution) == ("rod", "rod")
    assert (benchmark.policy_physics, on_rods.splits) == ("fem", benchmark.splits)
    with pytest.raises(BenchmarkError, match=r"^policy_physics = 'jelly', allowed "):
        benchmark.played_in("jelly")
    task = tasks_of(on_rods, [Method.trained(Path("bc-0"))], ["validation"], 1)[0] | {"resolution": "coarse"}
    rods, elements = (
        compete(task | where) for where in ({}, {"policy_physics": "fem", "policy_resolution": "coarse"})
    )
    assert rods["certified"] and elements["certified"]
    assert rods["max_strain"] == pytest.approx(elements["max_strain"], rel=0.1)
    assert rods["max_strain"] != elements["max_strain"]
