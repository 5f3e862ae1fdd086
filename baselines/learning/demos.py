"""Demonstrations: certified plans played through the environment, kept as a Minari data set.

Scenes are drawn from seeds. Of each episode the data set keeps the seed that the environment begins it from,
the scene's hash, the plan's certificate and what the environment said besides; of the whole, the command that
made it and the numbers of the scenes for which nothing was certified.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import retract_env
from baselines.jobs.journal import Row, WorkItem
from retract_env.config import brief
from retract_env.errors import ConfigError
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import PathPolicy, Rollout, rollout
from retract_env.scene import Scene, sample_scene
from retract_env.task import SIZE, actions

Floats = NDArray[np.float32]

SEED = 1
"""First number of every demonstrated scene's seed; the benchmark's splits have others, so no scene is in
both."""
UNSAID = ("failure",)
"""What is not kept of the environment's `info`: no demonstration fails."""
ROOT = "MINARI_DATASETS_PATH"
"""The variable of the environment that tells Minari where its data sets are."""
KWARGS: dict[str, Any] = {"scene": "random", "grasp": "agent"}
"""Arguments of the environment that the data set names."""


class DemosError(ConfigError):
    """A data set that cannot be made or used; the message is one line."""


def episode_seed(number: int) -> int:
    """What the environment is reset with to begin demonstration `number`.

    NumPy reads an integer as its 32-bit words, the lowest first: these are SEED and the number, just as a
    split's scene has its own seed and its number.
    """
    return SEED + (number << 32)


def demo_scene(number: int) -> Scene:
    """The scene of demonstration `number`, which the environment draws for itself from `episode_seed`."""
    return sample_scene(np.random.default_rng(episode_seed(number)))


def demonstrate(task: WorkItem) -> Row:
    """Plan, certify and play one scene; work for `run_tasks`.

    task: planner, resolution of its certificate, physics of the environment, seed (the scene's number). The
    row has the certificate, None where none is certified, and the episode, None where the environment did not
    succeed too.
    """
    from planners import NoPlan, plan

    scene = demo_scene(task["seed"])
    row: Row = {"seed": task["seed"], "scene_hash": scene.hash, "certificate": None, "episode": None}
    try:
        best = plan(scene, task["planner"], task["resolution"], workers=1)
    except NoPlan as none:
        return row | {"failure": str(none)}
    row["certificate"] = without_history(best.certificate.to_json())
    env = gym.make(PHYSICS[task["physics"]].env_id, disable_env_checker=True, **KWARGS).unwrapped
    played = rollout(env, PathPolicy.of(best), seed=episode_seed(task["seed"]))
    env.close()
    if not played.success:
        return row | {"failure": f"environment: {played.infos[-1]['failure'] or 'not_visible'}"}
    return row | {"failure": "", "episode": packed(played)}


def without_history(certificate: Mapping[str, Any]) -> dict[str, Any]:
    """The history can be made again; without it a certificate fits into a data set's attributes."""
    return {name: value for name, value in certificate.items() if name != "history"}


def packed(played: Rollout) -> dict[str, Any]:
    """An episode as plain data, for a journal, and for `write_episodes`."""
    return {
        "observations": base64.b64encode(played.observations.astype(np.float32).tobytes()).decode(),
        "actions": base64.b64encode(played.actions.astype(np.float32).tobytes()).decode(),
        "rewards": played.rewards.tolist(),
        "infos": {
            name: [info[name] for info in played.infos] for name in played.infos[0] if name not in UNSAID
        },
    }


def check_free(name: str) -> None:
    """Raise DemosError unless a data set can get this name."""
    _minari()
    from minari.dataset.minari_dataset import DATASET_ID_RE
    from minari.storage import get_dataset_path

    if DATASET_ID_RE.fullmatch(name) is None or "-v" not in name:
        raise DemosError(f"dataset = {name!r}, allowed names such as tissue-retract/ctc-v0")
    if (path := get_dataset_path(name)).exists():
        raise DemosError(f"dataset {name}: there is one already, in {path}")


def write_dataset(name: str, rows: Sequence[Row], task: WorkItem, command: str) -> int:
    """Make the Minari data set `name` from rows of `demonstrate`; returns how many episodes it has.

    Raises DemosError where there are none, where the name is not one of Minari's, or is taken.
    """
    good = [row for row in rows if row["episode"] is not None]
    if not good:
        raise DemosError(f"{len(rows)} scenes, none demonstrated: {rows[0]['failure']}")
    kept = [
        Kept(
            row["episode"],
            episode_seed(row["seed"]),
            {
                "scene_seed": [SEED, row["seed"]],
                "scene_hash": row["scene_hash"],
                "certificate": json.dumps(row["certificate"], sort_keys=True),
            },
        )
        for row in good
    ]
    failed = {str(row["seed"]): row["failure"] for row in rows if row["episode"] is None}
    write_episodes(
        name,
        kept,
        PHYSICS[task["physics"]].env_id,
        KWARGS,
        str(task["planner"]),
        f"Certified retractions of random flaps by the planner {task['planner']}.",
        {"command": command, "certificates": task["resolution"], "failed_seeds": failed},
    )
    return len(good)


@dataclass(frozen=True)
class Kept:
    """An episode that ended with success, as a data set keeps it."""

    episode: Mapping[str, Any]
    """as `packed` makes it"""
    seed: int
    """that the environment was reset with"""
    about: Mapping[str, Any]
    """what else is kept of it, numbers and texts by name"""


def write_episodes(
    name: str,
    episodes: Sequence[Kept],
    env_id: str,
    kwargs: Mapping[str, Any],
    author: str,
    description: str,
    about: Mapping[str, Any],
) -> None:
    """Make the Minari data set `name` of these episodes, whole or not at all.

    env_id, kwargs: of the environment that they were played in; author: who or what played; about: what else
    the data set keeps of itself, by name. Raises DemosError where Minari refuses, or the name is taken.
    """
    minari = _minari()
    from minari.data_collector.episode_buffer import EpisodeBuffer

    check_free(name)
    env = gym.make(env_id, **kwargs)
    width, size = (gym.spaces.flatdim(space) for space in (env.observation_space, env.action_space))
    buffers = []
    for number, kept in enumerate(episodes):
        episode = kept.episode
        steps = len(episode["rewards"])
        last = [k == steps - 1 for k in range(steps)]
        buffers.append(
            EpisodeBuffer(
                id=number,
                seed=kept.seed,
                observations=list(_unpacked(episode["observations"], width)),
                actions=list(_unpacked(episode["actions"], size)),
                rewards=episode["rewards"],
                terminations=last,  # the environment has succeeded
                truncations=[False] * steps,
                infos=_by_term(episode["infos"]),
            )
        )
    try:
        with warnings.catch_warnings(), _built_beside(name):
            warnings.simplefilter("ignore")  # of what it would like to know besides
            dataset = minari.create_dataset_from_buffers(
                name, buffers, env=env, algorithm_name=author, description=description
            )
            dataset.storage.update_episode_metadata([dict(kept.about) for kept in episodes])
            dataset.storage.update_metadata({"retract_version": retract_env.__version__, **about})
    except (ValueError, OSError) as error:
        raise DemosError(f"dataset {name}: {error}") from None
    finally:
        env.close()


@contextmanager
def _built_beside(name: str) -> Iterator[None]:
    """What Minari makes in the block is made in a folder of its own; the data set gets its place when the
    block ends well, and nothing is left of it where not."""
    from minari.storage import get_dataset_path

    place, root = get_dataset_path(name), get_dataset_path()
    before = os.environ.get(ROOT)
    with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=root) as folder:
        os.environ[ROOT] = folder
        try:
            yield
        finally:
            del os.environ[ROOT]
            if before is not None:
                os.environ[ROOT] = before
        place.parent.mkdir(parents=True, exist_ok=True)
        (Path(folder) / name).rename(place)
        for file in Path(folder).rglob("*.*"):  # what Minari says of a namespace, beside its data sets
            if file.is_file() and not (there := root / file.relative_to(folder)).exists():
                file.rename(there)


@dataclass(frozen=True)
class Demos:
    """A data set as the learner wants it: n moves of all episodes in a row."""

    observations: Floats
    """(n, SIZE)"""
    actions: Floats
    """(n, 3)"""
    episodes: int

    @property
    def hash(self) -> str:
        """16 hex digits of the SHA-256 over all of its numbers."""
        return hashlib.sha256(self.observations.tobytes() + self.actions.tobytes()).hexdigest()[:16]


def load_demos(name: str, most: int | None = None) -> Demos:
    """A data set's first `most` episodes, or all. Raises DemosError, also for one of another task and where
    there are not so many."""
    minari = _minari()
    try:
        dataset = minari.load_dataset(name)
        if most is not None and most > len(dataset):
            raise DemosError(f"demos = {most}, allowed {len(dataset)} at most: dataset {name} has no more")
        for what, space, size in (
            ("observations", dataset.observation_space, SIZE),
            ("actions", dataset.action_space, actions.SIZE),
        ):
            if space.shape != (size,):
                raise DemosError(f"dataset {name}: {what} {brief(space)}, allowed vectors of {size} numbers")
        episodes = [episode for _, episode in zip(range(most or len(dataset)), dataset, strict=False)]
        observations = np.concatenate([e.observations[:-1] for e in episodes]).astype(np.float32)
        moves = np.concatenate([e.actions for e in episodes]).astype(np.float32)
    except DemosError:
        raise
    except FileNotFoundError:
        raise DemosError(f"dataset {name}: there is none; `retract demos` makes one") from None
    except (ValueError, OSError, KeyError) as error:
        raise DemosError(f"dataset {name}: {error}") from None
    return Demos(observations, moves, len(episodes))


def _by_term(infos: Mapping[str, list[Any]]) -> dict[str, Any]:
    """As Minari keeps them: a list (t + 1) of each value, those of mappings by their keys."""
    return {
        name: {key: [value[key] for value in values] for key in values[0]}
        if isinstance(values[0], dict)
        else values
        for name, values in infos.items()
    }


def _unpacked(text: str, width: int) -> Floats:
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(-1, width)


def _minari() -> Any:
    try:
        import minari
    except ImportError:
        raise DemosError("demonstrations need Minari: pip install 'retract[rl]'") from None
    return minari


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """One line of counts."""
    good = sum(row["episode"] is not None for row in rows)
    certified = sum(row["certificate"] is not None for row in rows)
    return f"{len(rows)} scenes, {certified} certified, {good} demonstrated"
