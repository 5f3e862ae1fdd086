"""How to add ...: each section's example is run."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from baselines.benchmark.methods import UNTRAINED, Method, compete
from baselines.benchmark.splits import load_benchmark
from baselines.benchmark.tasks import methods_of
from baselines.learning.algorithms import ALGORITHMS
from retract_env.task import default_scene
from tests.baselines.trained import easy_scene

ROOT = Path(__file__).resolve().parent.parent
SECTIONS = (ROOT / "docs" / "how-to-add.md").read_text("utf-8").split("\n## ")[1:]


def example(heading: str) -> str:
    (section,) = (section for section in SECTIONS if section.startswith(heading))
    return "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))


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


def test_a_benchmark_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is listed, plays, and is judged."""
    monkeypatch.setitem(UNTRAINED, "lift", UNTRAINED["nothing"])  # so that it is taken out again
    exec(compile(example("A benchmark method"), "example", "exec"), {})
    benchmark = load_benchmark(ROOT / "configs" / "benchmark.yaml")
    assert Method("lift", "lift") in methods_of(benchmark, None)
    item = {
        "method": asdict(Method("lift", "lift")),
        "split": "",
        "number": 0,
        "scene": default_scene().dump(),
        "resolution": "coarse",
        "policy_resolution": "coarse",
        "lead_out": 0,
        "seed": 0,
        "transfer": False,
    }
    row = compete(item)
    assert row["method"] == "lift" and row["decisions"] > 1 and row["max_strain"] > 0
