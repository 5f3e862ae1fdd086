"""Recipes: those that are shipped, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from baselines.learning.algorithms import ALGORITHMS
from baselines.learning.fields import RecipeError
from baselines.learning.recipe import Recipe, load_recipe
from retract_env.config import read_yaml

ROOT = Path(__file__).resolve().parents[3]
TRAIN = ROOT / "configs" / "train"


def plain(algorithm: str) -> dict[str, Any]:
    data: dict[str, Any] = read_yaml(TRAIN / f"{algorithm}.yaml")
    return data


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_each_algorithm_has_a_recipe_that_writes_everything_out(algorithm: str) -> None:
    """No hyperparameter is left to a default that one would have to look up."""
    recipe = load_recipe(TRAIN / f"{algorithm}.yaml")
    assert recipe.algorithm == algorithm
    assert isinstance(recipe.learner, ALGORITHMS[algorithm])
    data = plain(algorithm)
    assert set(data) == set(Recipe.model_fields)
    parts = (
        ("learner", ALGORITHMS[algorithm]),
        ("task", type(recipe.task)),
        ("evaluation", type(recipe.evaluation)),
    )
    for part, model in parts:
        assert set(data[part]) == set(model.model_fields)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_recipe_comes_back_from_plain_data(algorithm: str) -> None:
    recipe = load_recipe(TRAIN / f"{algorithm}.yaml")
    assert Recipe.from_data(recipe.dump()) == recipe


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "ddpg"}, "algorithm = 'ddpg', allowed ppo, ppo_lagrangian, sac, tqc, bc"),
        ({"steps": 0}, "steps = 0, allowed [1, 1e+09]"),
        ({"steps": 1.5}, "steps = 1.5, not a whole number"),
        ({"seed": 1}, "seed: unknown key; known keys: name, algorithm, steps"),
        (
            {"learner": {"learning_rat": 1e-3}},
            "learner.learning_rat: unknown key, did you mean learning_rate?",
        ),
        ({"learner": 3}, "learner = 3, not a mapping"),
        ({"network": {"sizes": [0]}}, "network.sizes[0] = 0, allowed [1, 4096]"),
        ({"task": {"physics": "jelly"}}, "task.physics = 'jelly', allowed bullet, fem, rod"),
        ({"task": {"resolution": "ultra"}}, "task.resolution = 'ultra', allowed "),
        ({"task": {"scene": {}}}, ": missing"),
        ({"task": {"task": {"weights": {"stra": 1}}}}, "task.task.weights.stra: unknown key, did you mean"),
        ({"task": {"sensors": {"hide": ["q"]}}}, "task.sensors.hide[0] = 'q', allowed holding, "),
        ({"task": {"grip": "glue"}}, "task.grip: Input should be 'compression' or 'force'"),
        ({"task": {"scene": 3}}, "task.scene = 3, allowed 'random', a file, or a scene as plain data"),
        ({"evaluation": {"every": 8, "checkpoint": 0}}, "evaluation.checkpoint = 0, allowed [1, 1e+09]"),
        ({"steps": 10**400}, "0, allowed [1, 1e+09]"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(RecipeError) as caught:
        Recipe.from_data(plain("ppo") | change)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_hyperparameter_out_of_range_is_named() -> None:
    data = plain("sac")
    data["learner"]["gamma"] = 1.1
    with pytest.raises(RecipeError, match=r"^learner\.gamma = 1\.1, allowed \[0, 1\]$"):
        Recipe.from_data(data)


def test_the_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("algorithm: ppo\nalgorithm: sac\n")
    with pytest.raises(RecipeError, match=r"mine\.yaml: not readable as YAML.*key algorithm given twice"):
        load_recipe(file)


def test_quantiles_are_left_to_learn_from() -> None:
    data = plain("tqc")
    data["learner"]["dropped"] = data["learner"]["quantiles"]
    with pytest.raises(RecipeError, match=r"^learner\.dropped = 10, allowed fewer than quantiles = 10$"):
        Recipe.from_data(data)


def test_only_policies_of_an_algorithm_are_cloned() -> None:
    data = plain("bc")
    for wrong in ("bc", "ddpg", 3):
        data["learner"]["policy"] = wrong
        with pytest.raises(
            RecipeError, match=r"^learner\.policy = .*, allowed ppo, ppo_lagrangian, sac, tqc$"
        ):
            Recipe.from_data(data)


def test_the_learner_is_the_algorithms() -> None:
    recipe = load_recipe(TRAIN / "ppo.yaml")
    other = load_recipe(TRAIN / "sac.yaml").learner
    with pytest.raises(RecipeError, match=r"^algorithm = 'ppo', but the learner's is SAC$"):
        Recipe(**dict(recipe) | {"learner": other})


def test_reading_recipes_needs_nothing_that_computes() -> None:
    code = """
import sys
import baselines.learning.recipe
print(sorted({"torch", "stable_baselines3", "numba", "planners", "minari"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
