"""The studies that `retract reproduce` repeats, a file each: the paper's figures, and four of our own."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from baselines.paper.study import Study

STUDIES: dict[str, str] = {
    "fig7": "baselines.paper.studies.fig7",
    "fig8": "baselines.paper.studies.fig8",
    "fig9": "baselines.paper.studies.fig9",
    "fig11": "baselines.paper.studies.fig11",
    "fig12": "baselines.paper.studies.fig12",
    "pruning": "baselines.paper.studies.pruning",
    "light_grip": "baselines.paper.studies.light_grip",
    "robustness": "baselines.paper.studies.robustness",
    "verification": "baselines.paper.studies.verification",
}
"""The module of each study, by the study's name; its STUDY is the study. A module is imported when its study
is asked for, so that the names can be listed without matplotlib."""


def study(name: str) -> Study:
    """The study of a name in STUDIES."""
    found: Study = import_module(STUDIES[name]).STUDY
    return found
