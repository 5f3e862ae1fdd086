"""What a run begins from and is held to: a policy, a scene's file, a data set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")
pytest.importorskip("tensorboard")

from baselines.learning import cloning, train
from baselines.learning.agents import Agent
from baselines.learning.checkpoints import CheckpointError
from baselines.learning.cloning import Cloner
from baselines.learning.demos import Demos
from baselines.learning.envs import make_envs
from baselines.learning.fields import RecipeError
from baselines.learning.policies import save_policy
from retract_env.scene import Scene
from retract_env.task import HIGH, LOW, SIZE
from tests.baselines.learning.test_train import TINY, Stop, stopped_after, tiny
from tests.baselines.trained import easy_scene, policy, recipe


def shown(seed: int = 0) -> Demos:
    """Moves that no rule is behind."""
    rng = np.random.default_rng(seed)
    seen = rng.uniform(LOW, HIGH, (32, SIZE)).astype(np.float32)
    return Demos(seen, rng.uniform(-0.5, 0.5, (32, 3)).astype(np.float32), 1)


def test_what_a_clone_has_fitted_is_what_its_policy_does() -> None:
    """Also where it began from a policy, whose normalisation it keeps."""
    asked: Any = recipe("bc", 400, 400, learning_rate=3e-3, grasp_weight=1.0)
    envs, demos = make_envs(asked, 1), shown()
    for start in (None, policy(0, (64, 64))):
        clone = Cloner(asked, asked.learner, envs, 0, demos)
        if start is not None:
            clone.begin_from(start)
        clone.learn(400, lambda _: None)
        learned = clone.policy()
        errors = [learned(o) - a for o, a in zip(demos.observations, demos.actions, strict=True)]
        assert np.abs(errors).mean() < 0.02
    envs.close()


def test_a_policy_is_begun_from_with_its_own_normalisation_alone() -> None:
    asked = recipe("ppo", 48, 16, **TINY["ppo"])
    envs = make_envs(asked, 1)
    agent = Agent(asked, envs, 0)
    with pytest.raises(RecipeError, match=r"^observation\.clip = 10, allowed that of the policy, 5$"):
        agent.begin_from(policy(0, (64, 64), clip=5.0))
    fine, least = (np.full(SIZE, value, np.float32) for value in (0.005, 0.01))
    with pytest.raises(
        RecipeError, match=r"^observation\.floor = 0\.01, allowed the policy's, 0\.005 at most$"
    ):
        agent.begin_from(policy(0, (64, 64), deviation=fine))
    agent.begin_from(policy(0, (64, 64), deviation=least))
    envs.close()


def test_a_run_keeps_the_scene_that_a_file_held(tmp_path: Path) -> None:
    """Whatever becomes of the file, it goes on with that; another scene under the name is another run."""
    file, folder = tmp_path / "scene.yaml", tmp_path / "run"
    file.write_text(yaml.safe_dump(easy_scene()))
    data = tiny("ppo").recipe.dump()
    data["task"]["scene"] = str(file)
    run = tiny("ppo", recipe=type(tiny("ppo").recipe).from_data(data))
    with pytest.raises(Stop):
        train.train(run, folder, stopped_after(16))
    file.unlink()
    kept = train.open_run(folder)
    scene = kept.recipe.task.scene
    assert isinstance(scene, dict) and scene == Scene.from_data(easy_scene()).dump()
    assert train.train(kept, folder).env["kwargs"]["scene"] == scene
    file.write_text(yaml.safe_dump(easy_scene() | {"limits": {"strain": 0.8, "friction": 5.0}}))
    with pytest.raises(CheckpointError, match="belongs to another run"):
        train.train(run, folder)


def test_a_policy_to_begin_from_is_needed_until_the_first_checkpoint(tmp_path: Path) -> None:
    start, folder = tmp_path / "start", tmp_path / "run"
    save_policy(policy(0, (64, 64)), start)
    run = tiny("ppo", start=str(start))
    with pytest.raises(Stop):
        train.train(run, folder, stopped_after(-5))
    save_policy(policy(1, (64, 64)), start)
    with pytest.raises(
        train.RunError, match=r"^start: its content is [0-9a-f]{16}, allowed [0-9a-f]{16}, which "
    ):
        train.train(train.open_run(folder), folder)
    save_policy(policy(0, (64, 64)), start)
    with pytest.raises(Stop):
        train.train(train.open_run(folder), folder, stopped_after(16))
    start.rename(tmp_path / "moved")
    assert train.train(train.open_run(folder), folder).name == "toy+ppo"


def test_a_clone_goes_on_with_its_own_data_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No episode of its own ends, so that no share of them breaks a limit."""
    run = replace(tiny("ppo"), recipe=recipe("bc", 48, 16))
    monkeypatch.setattr(cloning, "load_demos", lambda *_: shown())
    learned = train.train(run, tmp_path)
    assert [line["broken"] for line in learned.training["curve"]] == [None] * 3
    head, *lines = (tmp_path / train.CURVE).read_text().splitlines()
    assert {line.split(",")[head.split(",").index("broken")] for line in lines} == {""}
    monkeypatch.setattr(cloning, "load_demos", lambda *_: shown(1))
    with pytest.raises(train.RunError, match=r"^dataset: its content is "):
        train.train(train.open_run(tmp_path), tmp_path)
