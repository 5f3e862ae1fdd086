"""Recipes: those that are shipped, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from baselines.learning.recipe import LEARNERS, Recipe, RecipeError, load_recipe
from retract_env.config import read_yaml

TRAIN = Path(__file__).resolve().parents[3] / "configs" / "train"


def plain(algorithm: str) -> dict[str, Any]:
    data: dict[str, Any] = read_yaml(TRAIN / f"{algorithm}.yaml")
    return data


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_each_algorithm_has_a_recipe_that_writes_everything_out(algorithm: str) -> None:
    """No hyperparameter is left to a default that one would have to look up."""
    recipe = load_recipe(TRAIN / f"{algorithm}.yaml")
    assert recipe.algorithm == algorithm
    assert isinstance(recipe.learner, LEARNERS[algorithm])
    data = plain(algorithm)
    assert set(data) == set(Recipe.model_fields)
    for part, model in (("learner", LEARNERS[algorithm]), ("task", type(recipe.task))):
        assert set(data[part]) == set(model.model_fields)


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_a_recipe_comes_back_from_plain_data(algorithm: str) -> None:
    recipe = load_recipe(TRAIN / f"{algorithm}.yaml")
    assert Recipe.from_data(recipe.dump()) == recipe


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "ddpg"}, "algorithm: Input should be 'ppo', 'sac', 'tqc' or 'bc'"),
        ({"steps": 0}, "steps = 0, allowed [1, 1e+09]"),
        ({"steps": 1.5}, "steps = 1.5, not a whole number"),
        ({"seed": 1}, "seed: unknown key; known keys: algorithm, steps"),
        (
            {"learner": {"learning_rat": 1e-3}},
            "learner.learning_rat: unknown key, did you mean learning_rate?",
        ),
        ({"learner": 3}, "learner = 3, not a mapping"),
        ({"network": {"sizes": [0]}}, "network.sizes[0] = 0, allowed [1, 4096]"),
        ({"task": {"physics": "jelly"}}, "task.physics = 'jelly', allowed bullet, fem"),
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
