"""docs/how-to-add.md: each section's example, executed as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from rich.console import Console

from baselines.benchmark.contest import compete
from baselines.benchmark.methods import UNTRAINED, Method, work_item
from baselines.benchmark.ranking import YOUR_OWN
from baselines.benchmark.tasks import methods_of
from baselines.learning.algorithms import ALGORITHMS
from baselines.paper.reproduce import names, reproduce
from baselines.paper.studies import STUDIES
from planners import PLANNERS, certify
from planners.paths import PATHS
from retract_env.physics.registry import PHYSICS
from retract_env.task import default_scene
from tests.baselines.trained import easy_scene

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "how-to-add.md").read_text("utf-8")


def example(heading: str) -> str:
    """The Python of a section, all its blocks."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))


def test_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The file is read, and its flap can be retracted."""
    text = PAGE.partition("\n## A scene\n")[2].partition("```yaml\n")[2].partition("```")[0]
    (tmp_path / "two_veins.yaml").write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    space: dict[str, Any] = {}
    exec(compile(example("A scene"), "a scene", "exec"), space)
    same, veins = capsys.readouterr().out.split()
    assert same == "True" and 2 <= int(veins) <= 4
    assert PLANNERS["eased"](
        space["scene"], resolution="coarse", workers=1, on_update=None
    ).certificate.certified
    env = gym.make("retract_env:TissueRetractRod-v0", scene="two_veins.yaml")
    assert env.reset(seed=0)[1]["exposure"] < 1


def test_a_path(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(PATHS, "lifted", PATHS["ctc"])  # taken out again after the test
    space: dict[str, Any] = {}
    exec(compile(example("A path"), "a path", "exec"), space)
    assert PATHS["lifted"] is space["lifted"]
    assert space["lifted"](space["scene"], space["grasp"]).kind == "lifted"
    assert capsys.readouterr().out.strip() in ("ok", "strain", "slip", "release", "not_visible")


def test_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "firmer.py").write_text(example("A study"), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(STUDIES, "firmer", "firmer")
    assert names("firmer") == ["firmer"]
    written = reproduce(["firmer"], tmp_path, "coarse", workers=1, console=Console(quiet=True))
    assert [path.name for path in written] == ["firmer.csv", "firmer.png", "firmer.md"]
    assert "| a firmer grip strains the tissue more |" in (tmp_path / "firmer.md").read_text("utf-8")


def test_a_physics(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The toy is listed, has its environment and plays an episode to its end."""
    monkeypatch.setitem(PHYSICS, "sheet", PHYSICS["fem"])  # so that it is taken out again
    registered = set(gym.registry)
    try:
        exec(compile(example("A physics"), "example", "exec"), {})
        assert "sheet" in PHYSICS and PHYSICS["sheet"].env_id in gym.registry
        assert capsys.readouterr().out == "True 12\n"
    finally:
        for name in set(gym.registry) - registered:
            del gym.registry[name]


def test_a_planner(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(PLANNERS, "firmer", PLANNERS["ctc"])  # taken out again after the test
    space: dict[str, Any] = {}
    exec(compile(example("A planner"), "a planner", "exec"), space)
    assert PLANNERS["firmer"] is space["plan_firmer"]
    assert capsys.readouterr().out.strip() == "ok 3"
    best = space["best"]
    judged = certify(space["scene"], best.grasp, best.path, "coarse")
    assert judged.to_json() == best.certificate.to_json()


def test_an_algorithm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is read from a recipe, trains, and its policy is kept. The example is a file of its own: this one's
    future imports are not its."""
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("tensorboard")
    from baselines.learning import train
    from baselines.learning.recipe import Recipe

    monkeypatch.setitem(ALGORITHMS, "a2c", ALGORITHMS["ppo"])  # so that it is taken out again
    exec(compile(example("An algorithm"), "example", "exec", dont_inherit=True), {"__name__": "example"})
    data: dict[str, Any] = {
        "algorithm": "a2c",
        "steps": 16,
        "task": {"scene": easy_scene(), "grasp": "spring"},
        "network": {"sizes": [8]},
        "evaluation": {"every": 16},
        "learner": {"learning_rate": 1e-3, "rollout": 8, "gamma": 0.98, "critic_first": 0},
    }
    policy = train.train(train.Run(Recipe.from_data(data), 0, 1, [None]), tmp_path)
    assert policy.name == "a2c" and policy.training["curve"][-1]["steps"] == 16


def test_a_benchmark_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first listing is a file of somebody's own, and judged; it is the one of the results' page."""
    listing = example("A benchmark method").split("\n\n\ndef follow")[0]
    assert f"```python\n{listing}\n```" in YOUR_OWN
    (tmp_path / "mine.py").write_text(example("A benchmark method"), "utf-8")
    monkeypatch.chdir(tmp_path)
    rows = [
        compete(
            work_item(
                method=Method.external(f"mine:{name}"),
                scene=default_scene().dump(),
                resolution="coarse",
                limit=120.0,
            )
        )
        for name in ("lift", "follow")
    ]
    assert [row["method"] for row in rows] == ["mine:lift", "mine:follow"]
    assert all(row["max_strain"] > 0 and not row["detail"] for row in rows)
    assert rows[0]["decisions"] == 0 and rows[1]["decisions"] > 1


def test_a_method_that_plays_untrained(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is listed, plays, and is judged."""
    monkeypatch.setitem(UNTRAINED, "up", UNTRAINED["nothing"])  # so that it is taken out again
    exec(compile(example("A method that plays untrained"), "example", "exec"), {})
    assert Method("up", "up") in methods_of(None)
    item = work_item(method=Method("up", "up"), scene=default_scene().dump(), resolution="coarse")
    row = compete(item)
    assert row["method"] == "up" and row["decisions"] > 1 and row["max_strain"] > 0
