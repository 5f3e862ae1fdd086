"""What is kept of what was played: a plan's file with its certificate, and the episodes of a data set."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from baselines.jobs.files import write_json, written_whole
from baselines.jobs.journal import Journal
from baselines.learning.demos import DemosError, Kept, check_free, packed, without_history, write_episodes
from baselines.play.scenes import Dealt
from baselines.play.session import TASK
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import Rollout

AUTHOR = "person"
"""Who played, where planners have their names."""


class PlanFiles:
    """Files for one plan after the other: the name that was asked for, then that with -2, -3, ... What lies
    there already stays."""

    def __init__(self, first: Path):
        """first: ends in .json."""
        self.first = first

    def write(self, plan: Mapping[str, Any], certificate: Mapping[str, Any] | None) -> Path:
        """Write a plan, and beside it its certificate where there is one, both or none; returns the plan's
        file. Raises OSError."""
        file, number = self.first, 1
        while file.exists() or _beside(file).exists():
            number += 1
            file = self.first.with_stem(f"{self.first.stem}-{number}")
        with ExitStack() as both:
            write_json(both.enter_context(written_whole(file)), plan)
            if certificate is not None:
                write_json(both.enter_context(written_whole(_beside(file))), certificate)
        return file


def _beside(file: Path) -> Path:
    return file.with_name(f"{file.stem}.certificate.json")


class Recorder:
    """Episodes that ended with success, in a journal as they come, and as a Minari data set in the end.

    A journal that was left behind, as the program was killed, is gone on with.
    """

    def __init__(self, name: str, physics: str, source: str | Mapping[str, Any], journal: Path):
        """name: of the data set; source: what the environment is told as `scene`.

        Raises DemosError where the name is taken or none, where Minari is missing, or where the journal has
        episodes of another environment; OSError.
        """
        check_free(name)
        self.name = name
        kwargs = {"scene": source, "grasp": "agent", "task": TASK}
        # as the journal gives it back
        self._env = json.loads(json.dumps({"id": PHYSICS[physics].env_id, "kwargs": kwargs}))
        self._journal = Journal(journal)
        self._file = journal
        if any(row["env"] != self._env for row in self._journal.rows.values()):
            raise DemosError(
                f"{journal}: has episodes for {name} of another physics or scene; allowed the same, another "
                "name, or that file away"
            )

    def __len__(self) -> int:
        """Episodes so far."""
        return len(self._journal.rows)

    def keep(self, dealt: Dealt, played: Rollout) -> str:
        """Keep an episode; it is on the disk when this returns. Returns its key, for its certificate.

        Raises OSError.
        """
        key = str(len(self._journal.rows))
        row = {
            "env": self._env,
            "seed": dealt.seed,
            "scene": dealt.name,
            "scene_hash": dealt.scene.hash,
            "certificate": None,
            "episode": packed(played),
        }
        self._journal.add(key, row)
        return key

    def certify(self, key: str, certificate: Mapping[str, Any]) -> None:
        """Add an episode's certificate, without its history. Raises OSError."""
        self._journal.add(key, self._journal.rows[key] | {"certificate": without_history(certificate)})

    def write(self, command: str) -> int:
        """Make the data set, and drop the journal; returns how many episodes it has, 0: none was made.

        command: that the data set says it comes from. Raises DemosError, OSError; the journal is still there.
        """
        rows = list(self._journal.rows.values())
        if not rows:
            return 0
        episodes = [
            Kept(
                row["episode"],
                row["seed"],
                {
                    "scene": row["scene"],
                    "scene_hash": row["scene_hash"],
                    "certificate": json.dumps(row["certificate"], sort_keys=True),
                },
            )
            for row in rows
        ]
        description = "Retractions by a person, in steps of a thirtieth of a second, that exposed the target."
        about = {"command": command}
        env = self._env
        write_episodes(self.name, episodes, env["id"], env["kwargs"], AUTHOR, description, about)
        self._file.unlink(missing_ok=True)
        return len(rows)
