"""The benchmark: frozen scenes, one judge for all, the same numbers again and for any number of workers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from baselines.benchmark import attempts, contest
from baselines.benchmark.attempts import led_out
from baselines.benchmark.contest import compete
from baselines.benchmark.methods import COMPETING, Method, work_item
from baselines.benchmark.splits import Benchmark, BenchmarkError, load_benchmark
from baselines.benchmark.tasks import check_installed, chosen, methods_of, numbers, tasks_of
from baselines.jobs.journal import key_of, run_tasks
from baselines.jobs.version import code_version
from baselines.learning.policies import PolicyError, save_policy
from planners import PLANNERS, certify, plan
from planners.base import Candidate, NoPlan
from planners.paths import circular, ctc
from retract_env.config import read_yaml
from retract_env.errors import FlapRefused
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
    asked: dict[str, Any] = {"split": "test", "resolution": "coarse", "lead_out": 3, "limit": 300.0}
    return work_item(method=method, scene=scene, **(asked | changes))


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
        changed.splits["validation"].scenes(2)  # a try on some says the same hash


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
    from retract_env.rollout import PathPolicy

    scene = default_scene()
    grasp = Grasp(-0.03, 0.2 * scene.tissue.height)
    path = ctc(scene, grasp)
    monkeypatch.setattr(attempts, "acting", lambda method, task: PathPolicy(scene, grasp, path))
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


def test_trained_policies_are_found_at_any_depth(tmp_path: Path) -> None:
    for seed in (1, 0):
        save_policy(policy(seed), tmp_path / "a" / f"seed{seed}" / "policy")
    found = methods_of(tmp_path)
    assert [m.name for m in found] == [*COMPETING, "toy", "toy", "random", "nothing"]
    assert {*PLANNERS, "swift_force"} == set(COMPETING)
    assert [m.run for m in found if m.kind == "policy"] == [0, 1]
    contents = {m.content for m in found if m.kind == "policy"}
    assert len(contents) == 2
    save_policy(policy(0), tmp_path / "again")
    with pytest.raises(BenchmarkError, match=r": both are toy, seed 0$"):
        methods_of(tmp_path)
    (tmp_path / "again" / "policy.json").write_text("{}")
    with pytest.raises(PolicyError):
        methods_of(tmp_path)


@pytest.mark.parametrize("name", ["ctc", "swift_force", "random", "all", "mine:f"])
def test_a_policy_does_not_take_another_methods_name(tmp_path: Path, name: str) -> None:
    save_policy(policy(name=name), tmp_path / "it")
    with pytest.raises(
        BenchmarkError, match=rf"it: name = '{name}', allowed one without ':' and none of ctc, "
    ):
        methods_of(tmp_path)


def test_a_policy_that_never_chose_its_grasp_is_refused(tmp_path: Path) -> None:
    save_policy(policy(env={"id": "TissueRetractRod-v0", "kwargs": {"grasp": "spring"}}), tmp_path)
    with pytest.raises(
        BenchmarkError, match=r": env\.kwargs\.grasp = 'spring', allowed 'agent' in a benchmark$"
    ):
        Method.trained(tmp_path)


def test_no_more_scenes_than_there_are_and_no_split_twice(benchmark: Benchmark) -> None:
    with pytest.raises(BenchmarkError, match=r"^split = 'validation:33': scenes = 33, allowed 32 at most$"):
        tasks_of(benchmark, [], ["validation:33"])
    every = tasks_of(benchmark, [Method("planner", "ctc")], ["validation"], most=33)
    assert len(every) == 32
    with pytest.raises(BenchmarkError, match=r"^split = 'test:5', allowed each split once$"):
        tasks_of(benchmark, [], ["test:3", "test:5"])


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


def test_methods_are_chosen_by_name() -> None:
    methods = methods_of(None)
    assert [m.name for m in chosen(methods, ["random", "ctc"])] == ["ctc", "random"]
    assert chosen(methods, None) == chosen(methods, ["all"]) == methods
    with pytest.raises(BenchmarkError, match=r"^method = 'eazed', allowed ctc, .*; did you mean 'eased'\?$"):
        chosen(methods, ["eazed"])


def test_what_a_planner_needs_is_asked_for_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.benchmark.tasks.find_spec", lambda name: None)
    with pytest.raises(
        BenchmarkError, match=r"^method = 'elastica' needs casadi: pip install 'retract\[opti"
    ):
        check_installed(methods_of(None))
    check_installed(chosen(methods_of(None), ["ctc", "nothing"]))


def test_all_methods_are_judged_on_one_scene_after_the_other(benchmark: Benchmark) -> None:
    """A run that is stopped has compared them all on the first scenes."""
    methods = methods_of(None)
    tasks = tasks_of(benchmark, methods, ["validation"], 3)
    assert [(t["number"], t["method"]["name"]) for t in tasks] == [
        (k, m.name) for k in range(3) for m in methods
    ]


def test_a_row_is_kept_by_all_that_it_depends_on(benchmark: Benchmark) -> None:
    """Change any of it and it is computed again."""
    method = Method("planner", "ctc")
    (task,) = tasks_of(benchmark, [method], ["validation"], 1)
    assert task["split_version"] == 1 and task["split_hash"] == benchmark.splits["validation"].hash
    assert task["code"] == code_version() and task["limit"] == benchmark.limit
    drawn = benchmark.survival.model_copy(update={"draws": 100})
    others = [
        (benchmark.limited_to(5), method),
        (benchmark.model_copy(update={"survival": drawn}), method),
        (benchmark.played_in("rod"), method),
        (benchmark, replace(method, content="another")),
    ]
    keys = {key_of(tasks_of(b, [m], ["validation"], 1)[0]) for b, m in others}
    assert len(keys) == 4 and key_of(task) not in keys
    moved = replace(method, folder="elsewhere")  # the same files by their hash
    assert key_of(tasks_of(benchmark, [moved], ["validation"], 1)[0]) == key_of(task)
    with pytest.raises(BenchmarkError, match=r"^limit = 0 s?, allowed \[1, 86400\] s"):
        benchmark.limited_to(0)


def test_a_planner_that_takes_too_long_loses_that_row_only() -> None:
    row = compete(coarse(Method("planner", "exhaustive"), default_scene().dump(), limit=0.2))
    assert (row["certified"], row["reason"], row["detail"]) == (False, "time", "nothing within 0.2 s")
    assert row["timing"]["seconds"] == 0.2
    assert compete(coarse(Method("planner", "ctc"), easy_scene()))["certified"]


def test_a_planner_works_with_the_code_that_the_work_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which its process reads when it begins, be it after a change."""
    monkeypatch.setattr(contest, "code_version", lambda: "1.0+old")
    with pytest.raises(BenchmarkError, match=r"a worker runs retract .*, the work is for 1\.0\+old"):
        compete(coarse(Method("planner", "ctc"), easy_scene(), code="1.0+old"))


@pytest.mark.parametrize("work", [attempts.hand_in, attempts.transferred, attempts.played_on_draws])
def test_no_two_scenes_have_the_same_noise(work: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int | None] = []

    class Begun(Exception):
        pass

    def rollout(env: Any, policy: Any, seed: int | None = None, options: Any = None) -> None:
        seeds.append(seed)
        raise Begun

    monkeypatch.setattr(attempts, "rollout", rollout)
    monkeypatch.setattr(attempts, "gym", SimpleNamespace(make=lambda *_, **__: MagicMock()))
    scene = default_scene()
    for number in (0, 1):
        task = coarse(
            Method("nothing", "nothing"), scene.dump(), number=number, played=2, survival={"seed": 5}
        )
        with pytest.raises(Begun):
            work(task)
    assert len(set(seeds)) == 2 and None not in seeds


def test_a_flap_that_the_physics_refuses_costs_its_own_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: Any, **__: Any) -> Any:
        raise FlapRefused("too stiff")

    monkeypatch.setattr(attempts, "rollout", refuses)
    task = coarse(Method("nothing", "nothing"), easy_scene())
    row = compete(task)
    assert (row["certified"], row["reason"]) == (False, "raised")
    assert row["detail"].startswith("FlapRefused: too stiff (")
    played: dict[str, Any] = {"detail": ""}
    monkeypatch.setattr(contest, "transferred", refuses)
    contest._also(played, contest._here, refuses, task)
    assert played["transfer"] == "raised" and played["detail"].startswith(
        "transfer: raised FlapRefused: too "
    )


@pytest.mark.slow
def test_a_policy_is_played_on_the_other_physics_too(tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    save_policy(policy(), tmp_path)
    row = compete(coarse(Method.trained(tmp_path), default_scene().dump(), transfer=True))
    assert row["transfer"] in ("ok", "not_visible", "slip", "strain", "release", "diverged")


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


def test_what_keeps_a_planner_from_an_answer_is_a_reason_that_is_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for reason, told, detail in (
        ("slip", "slip", ""),
        ("unsure", "unsure", ""),
        ("unsolved (infeasible)", "unsolved", "unsolved (infeasible)"),
        ("unmeshable", "unsolved", "unmeshable"),
    ):

        def fails(*_: Any, reason: str = reason, **__: Any) -> Any:
            grasp = Grasp(-0.03, 1e-3)
            candidate = Candidate(0, grasp, circular(default_scene(), grasp))
            candidate.reason = reason
            raise NoPlan([candidate])

        monkeypatch.setitem(COMPETING, "ctc", fails)
        row = attempts.hand_in(coarse(Method("planner", "ctc"), easy_scene()))
        assert (row["reason"], row["detail"]) == (told, detail)
        assert row["reason"] in contest.REASONS
