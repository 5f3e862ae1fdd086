"""The studies that `retract reproduce` repeats, by name: the paper's figures, and one of our own."""

from __future__ import annotations

from baselines.studies import grips, pruning
from baselines.studies.lines import FIG12
from baselines.studies.paths import FIG8, FIG11
from baselines.studies.report import Study
from baselines.studies.stiffness import FIG7
from baselines.studies.wide import FIG9

__all__ = ["STUDIES", "Study"]

STUDIES: dict[str, Study] = {
    study.name: study for study in (FIG7, FIG8, FIG11, FIG12, pruning.STUDY, FIG9, grips.STUDY)
}
