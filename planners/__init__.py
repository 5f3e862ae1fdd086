"""Planners of retractions and the certifier that judges them all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches

from planners import paths
from planners.base import Candidate, NoPlan, Plan, Planner
from planners.certify import Certificate, certify
from planners.generate_and_test import generate_and_test
from planners.spring import SpringModel
from retract_env.scene import Scene

__all__ = ["PLANNERS", "Candidate", "Certificate", "NoPlan", "Plan", "certify", "plan"]


def _ctc(
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: Callable[[Sequence[Candidate]], None] | None,
) -> Plan:
    """The paper's planner: grasps of the spring model, CTC paths. Sec. IV."""
    grasps = SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)
    proposals = [(grasp, paths.ctc(scene, grasp)) for grasp in grasps]
    return generate_and_test(scene, proposals, "ctc", resolution, workers, on_update)


PLANNERS: dict[str, Planner] = {"ctc": _ctc}


def plan(
    scene: Scene,
    planner: str = "ctc",
    resolution: str = "fine",
    workers: int | None = None,
    on_update: Callable[[Sequence[Candidate]], None] | None = None,
) -> Plan:
    """Find a retraction that meets all three objectives, certified.

    planner: a name in PLANNERS; resolution: of the finite elements that certify; workers: candidates side by
    side, one a core by default. on_update is called, from the thread that works, whenever a candidate
    changed. Raises NoPlan, with what was tried, where nothing is certified; ValueError for an unknown name.
    """
    if planner not in PLANNERS:
        close = get_close_matches(planner, PLANNERS, 1)
        hint = f", did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"planner = {planner!r}, allowed {', '.join(PLANNERS)}{hint}")
    return PLANNERS[planner](scene, resolution=resolution, workers=workers, on_update=on_update)
