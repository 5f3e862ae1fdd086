"""A study small enough to be done in seconds, and the command that does it, to be run as a process."""

from __future__ import annotations

import sys
from dataclasses import replace

from baselines.cli.app import main
from baselines.paper.paths import FIG8, path_tasks
from baselines.paper.report import paper_scene
from baselines.paper.studies import STUDIES
from baselines.paper.tasks import Task
from retract_env.scene import Scene

SMALL = "fig8"
GRASPS = (-0.04, -0.02)
"""m, some of the ten of Fig. 8"""


def scenes() -> list[Scene]:
    return [paper_scene("homogeneous"), paper_scene("homogeneous_near")]


def small_tasks() -> list[Task]:
    """Fig. 8 from a few grasps, 16 retractions."""
    return [task for task in path_tasks(scenes()) if any(abs(task.label["x"] - x) < 1e-9 for x in GRASPS)]


def use_small_study() -> None:
    """Fig. 8 is this one, in this process."""
    STUDIES[SMALL] = replace(FIG8, tasks=small_tasks)


if __name__ == "__main__":
    use_small_study()
    sys.exit(main(["reproduce", SMALL, "--resolution", "coarse", *sys.argv[1:]]))
