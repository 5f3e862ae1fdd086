"""The studies that `retract reproduce` repeats, by name: the paper's figures, and one of our own."""

from __future__ import annotations

from baselines.paper import grips, pruning
from baselines.paper.lines import FIG12
from baselines.paper.paths import FIG8, FIG11
from baselines.paper.report import Study
from baselines.paper.stiffness import FIG7
from baselines.paper.wide import FIG9

__all__ = ["STUDIES", "Study"]

STUDIES: dict[str, Study] = {
    study.name: study for study in (FIG7, FIG8, FIG11, FIG12, pruning.STUDY, FIG9, grips.STUDY)
}
