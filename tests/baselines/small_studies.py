"""A study small enough to be done in seconds, and the command that does it, to be run as a process."""

from __future__ import annotations

import sys
from dataclasses import replace

from baselines.cli.app import main
from baselines.paper.experiments import Experiment
from baselines.paper.studies import STUDIES, fig8
from baselines.paper.study import paper_scene

SMALL = "fig8"
GRASPS = (-0.04, -0.02)
"""m, some of the ten of Fig. 8"""


def small_experiments() -> list[Experiment]:
    """Fig. 8 from a few grasps, 16 retractions."""
    scenes = [paper_scene("homogeneous"), paper_scene("homogeneous_near")]
    every = fig8.path_experiments(scenes)
    return [one for one in every if any(abs(one.label["x"] - x) < 1e-9 for x in GRASPS)]


STUDY = replace(fig8.STUDY, experiments=small_experiments)


def use_small_study() -> None:
    """Fig. 8 is this one, in this process."""
    STUDIES[SMALL] = "tests.baselines.small_studies"


if __name__ == "__main__":
    use_small_study()
    sys.exit(main(["reproduce", SMALL, "--resolution", "coarse", *sys.argv[1:]]))
