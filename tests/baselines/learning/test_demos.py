"""Demonstrations: certified, played without loss into a Minari data set, and learned from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("minari")
pytest.importorskip("h5py")


from baselines.benchmark.splits import load_benchmark
from baselines.jobs.journal import Row, run_tasks
from baselines.learning import demos
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import gripper_pose
from retract_env.scene import sample_scene
from retract_env.task import SIZE, SLICES

BENCHMARK = Path(__file__).resolve().parents[3] / "configs" / "benchmark.yaml"
NAME = "toy/eased-v0"


@pytest.fixture(autouse=True)
def _datasets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.getbasetemp() / "minari"))


@pytest.fixture(scope="module")
def tasks() -> list[dict[str, Any]]:
    return [{"planner": "eased", "resolution": "coarse", "physics": "fem", "seed": seed} for seed in (1, 2)]


@pytest.fixture(scope="module")
def rows(tasks: list[dict[str, Any]]) -> list[Row]:
    return run_tasks(tasks, demos.demonstrate, None)


@pytest.fixture
def dataset(rows: list[Row], tasks: list[dict[str, Any]]) -> Any:
    import minari

    if NAME not in minari.list_local_datasets():
        demos.write_dataset(NAME, rows, tasks[0], "retract demos")
    return minari.load_dataset(NAME)


def test_a_demonstration_is_certified_and_succeeds(rows: list[Row]) -> None:
    for row in rows:
        assert row["certificate"]["certified"] and row["episode"] is not None
        assert row["scene_hash"] == row["certificate"]["scene_hash"] == demos.demo_scene(row["seed"]).hash


def test_it_is_the_same_again(rows: list[Row], tasks: list[dict[str, Any]]) -> None:
    assert demos.demonstrate(tasks[0]) == rows[0]


def test_the_dataset_keeps_seeds_certificates_and_command(dataset: Any, rows: list[Row]) -> None:
    metadata = dataset.storage.metadata
    assert metadata["command"] == "retract demos" and metadata["certificates"] == "coarse"
    assert metadata["algorithm_name"] == "eased" and metadata["failed_seeds"] == {}
    assert dataset.env_spec.id == PHYSICS["fem"].env_id
    kept = list(dataset.storage.get_episode_metadata(range(2)))
    for row, about in zip(rows, kept, strict=True):
        assert about["scene_seed"].tolist() == [demos.SEED, row["seed"]]
        assert about["scene_hash"] == row["scene_hash"]
        assert json.loads(about["certificate"]) == row["certificate"]


def assert_said(info: dict[str, Any], kept: dict[str, Any], step: int) -> None:
    """What the environment says at a step is what the data set keeps."""
    assert set(kept) == set(info) - {"failure"} >= {"cost", "reward_terms"}
    for name, values in kept.items():
        if isinstance(values, dict):
            assert {key: of[step] for key, of in values.items()} == info[name]
        else:
            assert values[step] == info[name]


def test_its_episodes_are_replayed_from_their_own_seeds(dataset: Any) -> None:
    """The environment that the data set recovers, reset with an episode's seed, is where it was played."""
    env = dataset.recover_environment()
    metadata = list(dataset.storage.get_episode_metadata(range(2)))
    for episode, about in zip(dataset, metadata, strict=True):
        seen, info = env.reset(seed=about["seed"])
        scene = env.unwrapped.episode.task.scene
        assert scene.hash == about["scene_hash"]
        for k, action in enumerate(episode.actions):
            assert np.array_equal(seen, episode.observations[k])
            assert_said(info, episode.infos, k)
            seen, reward, terminated, _, info = env.step(action)
            assert reward == episode.rewards[k]
        assert np.array_equal(seen, episode.observations[-1])
        assert_said(info, episode.infos, k + 1)
        assert terminated and episode.terminations.tolist() == [False] * k + [True]
        assert info["is_success"]
        # it moved: the jaws ended somewhere else than they closed
        poses = [gripper_pose(o, scene) for o in episode.observations[[1, -1]]]
        assert np.hypot(*(poses[1] - poses[0])[:2]) > 5e-3
    env.close()


def test_plans_are_played_on_the_physics_that_is_asked_for(tasks: list[dict[str, Any]]) -> None:
    """On rods: the data set names their environment, which begins its episodes as they were played."""
    import minari

    task = tasks[0] | {"physics": "rod"}
    row = demos.demonstrate(task)
    assert row["certificate"]["certified"] and row["episode"] is not None
    demos.write_dataset("toy/rods-v0", [row], task, "retract demos --physics rod")
    dataset = minari.load_dataset("toy/rods-v0")
    assert dataset.env_spec.id == PHYSICS["rod"].env_id
    env, episode = dataset.recover_environment(), dataset[0]
    seen, _ = env.reset(seed=demos.episode_seed(task["seed"]))
    for k, action in enumerate(episode.actions):
        assert np.array_equal(seen, episode.observations[k])
        seen, reward, terminated, _, _ = env.step(action)
        assert reward == episode.rewards[k]
    assert terminated
    env.close()


def test_what_is_learned_from_has_a_grasp_in_each_episode(dataset: Any) -> None:
    learned = demos.load_demos(NAME)
    assert learned.episodes == 2
    assert learned.observations.shape == (len(learned.actions), SIZE)
    assert (learned.observations[:, SLICES["holding"]] == 0).sum() == 2
    assert demos.load_demos(NAME, 1).episodes == 1
    assert demos.load_demos(NAME, 1).hash != learned.hash == demos.load_demos(NAME).hash
    with pytest.raises(demos.DemosError, match=r"^demos = 3, allowed 2 at most: "):
        demos.load_demos(NAME, 3)


def test_demonstrated_scenes_are_none_of_the_benchmarks() -> None:
    splits = load_benchmark(BENCHMARK).splits
    assert demos.SEED not in {split.seed for split in splits.values()}
    drawn = sample_scene(np.random.default_rng([demos.SEED, 5]))  # as a split's scene is drawn
    assert demos.demo_scene(5).hash == drawn.hash


@pytest.mark.parametrize("name", ["", "no version", "a/b", "../up-v0"])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(demos.DemosError, match=r"^dataset = .*, allowed names such as "):
        demos.check_free(name)


def test_a_name_is_given_once(dataset: Any) -> None:
    with pytest.raises(demos.DemosError, match=rf"^dataset {NAME}: there is one already"):
        demos.check_free(NAME)


def test_what_is_missing_or_broken_is_said(
    dataset: Any, rows: list[Row], tasks: list[dict[str, Any]]
) -> None:
    with pytest.raises(demos.DemosError, match=r"^dataset toy/none-v0: there is none; `retract demos` makes"):
        demos.load_demos("toy/none-v0")
    broken = dataset.storage.data_path / "main_data.hdf5"
    whole = broken.read_bytes()
    try:
        broken.write_bytes(b"something else")
        with pytest.raises(demos.DemosError, match=rf"^dataset {NAME}: "):
            demos.load_demos(NAME)
    finally:
        broken.write_bytes(whole)
    failed = [row | {"episode": None, "failure": "1 candidates: 1 slip"} for row in rows]
    with pytest.raises(demos.DemosError, match=r"^2 scenes, none demonstrated: 1 candidates: 1 slip$"):
        demos.write_dataset("toy/failed-v0", failed, tasks[0], "retract demos")


def vectors(count: int) -> gym.spaces.Box:
    return gym.spaces.Box(-1, 1, (count,))


@pytest.mark.parametrize(
    ("seen", "moves", "said"),
    [
        (gym.spaces.Dict({"image": vectors(3)}), vectors(3), "observations Dict"),
        (gym.spaces.Discrete(5), vectors(3), "observations Discrete"),
        (vectors(SIZE - 1), vectors(3), "observations Box"),
        (vectors(SIZE), vectors(2), "actions Box"),
    ],
    ids=lambda value: str(value)[:12],
)
def test_a_data_set_of_another_task_is_refused(
    seen: Any, moves: Any, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign = MagicMock(observation_space=seen, action_space=moves)
    monkeypatch.setattr("minari.load_dataset", lambda _: foreign)
    with pytest.raises(
        demos.DemosError, match=rf"^dataset a/b-v0: {said}.*, allowed vectors of [0-9]+ numbers$"
    ):
        demos.load_demos("a/b-v0")


def test_a_clone_repeats_what_it_was_shown(dataset: Any, tmp_path: Path) -> None:
    """Fitted to two demonstrations it does both again."""
    pytest.importorskip("stable_baselines3")
    from baselines.learning import train
    from baselines.learning.recipe import Recipe
    from tests.baselines.trained import LEARNERS

    data = {
        "algorithm": "bc",
        "steps": 1200,
        "task": {"scene": "random"},
        "network": {"sizes": [64, 64]},
        "evaluation": {"every": 600},
        "learner": LEARNERS["bc"] | {"dataset": NAME, "learning_rate": 3e-3},
    }
    scenes = [demos.demo_scene(seed).dump() for seed in (1, 2)]
    trained = train.train(train.Run(Recipe.from_data(data), 0, 1, scenes), tmp_path)
    assert trained.scores["validation"]["success"] == 1
    assert trained.name == "bc" and trained.training["recipe"]["learner"]["dataset"] == NAME
