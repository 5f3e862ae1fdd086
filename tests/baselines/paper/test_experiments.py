"""Experiments: a result belongs to its work and to its code; the work can be done elsewhere."""

from __future__ import annotations

import json
from functools import partial, wraps

import pytest

from baselines.jobs.journal import Row, key_of
from baselines.paper import experiments
from baselines.paper.experiments import Experiment, evaluate
from retract_env.errors import ConfigError
from tests.baselines.small_studies import small_experiments


def doubled(resolution: str, n: int) -> Row:
    """Work that a study outside this package brings along."""
    return {"twice": 2 * n, "on": resolution}


def test_a_study_brings_its_own_work() -> None:
    work = json.loads(json.dumps(Experiment(doubled, {"n": 4}).work("coarse")))
    assert evaluate(work) == {"twice": 8, "on": "coarse"}


def test_a_result_belongs_to_its_work_its_resolution_and_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = small_experiments()[:2]
    keys = {key_of(one.work("coarse")), key_of(one.work("fine")), key_of(other.work("coarse"))}
    keys.add(key_of(Experiment(doubled, one.arguments).work("coarse")))
    monkeypatch.setattr(experiments, "code_version", lambda: "0+other")
    keys.add(key_of(one.work("coarse")))
    assert len(keys) == 5
    renamed = Experiment(one.function, one.arguments, {"called": "otherwise"})
    assert key_of(renamed.work("coarse")) in keys


def test_work_that_no_other_process_could_find_is_refused() -> None:
    with pytest.raises(ValueError, match=r"experiment.function = .*<lambda>, allowed functions at the top"):
        Experiment(lambda **_: {}, {})
    with pytest.raises(ValueError, match=r"experiment.function = .*partial.*, allowed functions at the top"):
        Experiment(partial(doubled, n=2), {})


def test_work_for_other_code_is_refused() -> None:
    work = small_experiments()[0].work("coarse") | {"code": "0.0.9+something"}
    with pytest.raises(ConfigError, match=r"the work is for 0\.0\.9\+something"):
        evaluate(work)


def test_friction_without_bound_goes_into_json(monkeypatch: pytest.MonkeyPatch) -> None:
    @wraps(experiments.certified)
    def released(**_: object) -> Row:
        return {"required_friction": float("inf")}

    monkeypatch.setattr(experiments, "certified", released)
    row = evaluate(small_experiments()[0].work("coarse"))
    assert json.loads(json.dumps(row, allow_nan=False)) == {"required_friction": "inf"}
