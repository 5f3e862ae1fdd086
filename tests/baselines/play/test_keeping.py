"""Demonstrations by a person: whole data sets of whole episodes that can be played again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("minari")
pytest.importorskip("h5py")

from baselines.learning.demos import DemosError, load_demos
from baselines.play.keeping import Recorder
from baselines.play.scenes import Dealt, named_scene, random_scene
from baselines.play.session import TASK, Phase, Session
from retract_env.env import TissueRetractEnv
from tests.baselines.play.person import closed, retract

NAME = "toy/person-v0"
CERTIFICATE = {"certified": True, "reason": "ok", "history": {"strain": [0.1]}}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path


@pytest.fixture(scope="module")
def done() -> Session:
    return retract(closed())


def recorder(folder: Path, source: Any = None) -> Recorder:
    source = named_scene("ten_veins").source if source is None else source
    return Recorder(NAME, "rod", source, folder / "journal.jsonl")


def play_again(name: str) -> int:
    """Every episode of a data set in the environment that it names; returns how many."""
    import minari

    dataset = minari.load_dataset(name)
    env = dataset.recover_environment()
    about = dataset.storage.get_episode_metadata(range(len(dataset)))
    for episode, told in zip(dataset, about, strict=True):
        seen, _ = env.reset(seed=told["seed"])
        assert env.unwrapped.episode.task.scene.hash == told["scene_hash"]
        for k, action in enumerate(episode.actions):
            assert np.array_equal(seen, episode.observations[k])
            seen, reward, terminated, truncated, info = env.step(action)
            assert reward == episode.rewards[k] and not truncated
        assert terminated and info["is_success"] and np.array_equal(seen, episode.observations[-1])
    env.close()
    return len(dataset)


def test_an_episode_that_is_recorded_plays_again_to_the_last_bit(folder: Path, done: Session) -> None:
    import minari

    kept = recorder(folder)
    key = kept.keep(done.dealt, done.played)
    kept.keep(done.dealt, done.played)
    kept.certify(key, CERTIFICATE)
    assert kept.write("retract play ten_veins") == 2 and not (folder / "journal.jsonl").exists()
    assert play_again(NAME) == 2
    dataset = minari.load_dataset(NAME)
    assert dataset.storage.metadata["algorithm_name"] == "person"
    assert dataset.storage.metadata["command"] == "retract play ten_veins"
    first, second = (json.loads(told["certificate"]) for told in dataset.storage.get_episode_metadata([0, 1]))
    assert first == {"certified": True, "reason": "ok"} and second is None
    assert load_demos(NAME).episodes == 2


def lifted(dealt: Dealt) -> Session:
    """A random flap, retracted by the same motion with a firm grip."""
    begun = Session(TissueRetractEnv("rod", scene=dealt.source, task=TASK), dealt)
    begun.propose(-0.6, 0.4)
    begun.confirm()
    return retract(begun)


def test_random_flaps_are_drawn_again_from_their_seeds(folder: Path) -> None:
    kept = recorder(folder, "random")
    flaps = (lifted(random_scene(number)) for number in range(20))
    ended = [flap for flap in flaps if flap.success][:2]
    assert len(ended) == 2 and all(flap.phase is Phase.ENDED for flap in ended)
    for flap in ended:
        kept.keep(flap.dealt, flap.played)
    assert kept.write("retract play") == 2 and play_again(NAME) == 2


def test_a_session_that_was_killed_is_gone_on_with(folder: Path, done: Session) -> None:
    recorder(folder).keep(done.dealt, done.played)  # and then nobody closes it
    with (folder / "journal.jsonl").open("ab") as file:
        file.write(b'{"key": "1", "ro')
    kept = recorder(folder)
    assert len(kept) == 1
    kept.keep(done.dealt, done.played)
    assert kept.write("retract play") == 2
    with pytest.raises(DemosError, match=rf"^dataset {NAME}: there is one already"):
        recorder(folder)


def test_a_journal_of_another_scene_is_not_mixed_in(folder: Path, done: Session) -> None:
    recorder(folder).keep(done.dealt, done.played)
    with pytest.raises(
        DemosError, match=r"has episodes for .* of another physics or scene; allowed the same"
    ):
        recorder(folder, "random")


def test_nothing_is_written_where_nothing_succeeded(folder: Path) -> None:
    assert recorder(folder).write("retract play") == 0
    assert not any((folder / "minari").rglob("*.hdf5"))


def test_a_data_set_is_written_whole_or_not_at_all(
    folder: Path, done: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    from minari.dataset.minari_storage import MinariStorage

    kept = recorder(folder)
    kept.keep(done.dealt, done.played)

    def full(*_: Any) -> None:
        raise OSError("no space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(MinariStorage, "update_metadata", full)
        with pytest.raises(DemosError, match="no space left"):
            kept.write("retract play")
    assert not any((folder / "minari").rglob("*.hdf5")) and (folder / "journal.jsonl").exists()
    assert kept.write("retract play") == 1 and play_again(NAME) == 1
