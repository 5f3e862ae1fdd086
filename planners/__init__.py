"""Planners of retractions and the certifier that judges them all."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import partial

from planners.base import Candidate, Contestant, NoPlan, Plan, Planner
from planners.certify import Certificate, certify
from planners.deform_closure import closure_grasps
from planners.eased import plan_eased
from planners.fem_gradient.planner import plan_fem_gradient
from planners.light_grip import LightGrip, lightest_grips
from planners.paths import PAPER_PATHS
from planners.proposals import along, stable_grasps, uniform_grasps
from planners.search import OnUpdate, generate_and_test, race
from planners.swift.planner import best_grasps, plan_swift
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

__all__ = ["PLANNERS", "Candidate", "Certificate", "NoPlan", "Plan", "certify", "plan"]


Grasps = Callable[[Scene], Iterable[Grasp]]


def _search(
    name: str,
    grasps: Grasps,
    kinds: Sequence[str],
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: OnUpdate | None,
) -> Plan:
    """Every grasp with every path of these kinds, generated and tested. Sec. IV."""
    proposals = along(scene, grasps(scene), kinds)
    return generate_and_test(scene, proposals, name, resolution, workers, on_update)


def _improve(
    name: str,
    contestant: Callable[[Scene, Grasp, JawPath], Contestant],
    begin: Callable[[Scene], Sequence[Grasp]],
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: OnUpdate | None,
) -> Plan:
    """Contestants that begin with the CTC paths of the grasps that the rod finds best; where none of them is
    certified, with those of the stable grasps."""
    start = time.perf_counter()
    tried: Sequence[Candidate] = ()
    for grasps in (begin, stable_grasps):
        contestants = [contestant(scene, *proposal) for proposal in along(scene, grasps(scene), ["ctc"])]
        try:
            found = race(scene, contestants, name, resolution, workers, on_update, tried=tried)
        except NoPlan as none:
            tried = none.candidates
        else:
            return replace(found, timings={**found.timings, "total": time.perf_counter() - start})
    raise NoPlan(tried)


def _elastica(scene: Scene, grasp: Grasp, path: JawPath) -> Contestant:
    """An `Elastica`, imported when it is wanted, as it needs the extra `optimize`."""
    from planners.elastica.planner import Elastica

    return Elastica(scene, grasp, path)


ELASTICA_PLACES = 2
"""Places that "elastica" begins at. Its program chooses all but the place, which matters little."""

PLANNERS: dict[str, Planner] = {
    # the paper's, and the paths that it compares with
    **{kind: partial(_search, kind, stable_grasps, [kind]) for kind in PAPER_PATHS},
    "exhaustive": partial(_search, "exhaustive", uniform_grasps, PAPER_PATHS),
    "light_grip": partial(_improve, "light_grip", LightGrip, lightest_grips),
    "deform_closure": partial(_search, "deform_closure", closure_grasps, ["ctc"]),
    "swift": plan_swift,
    "eased": plan_eased,
    "fem_gradient": plan_fem_gradient,
    "elastica": partial(_improve, "elastica", _elastica, partial(best_grasps, count=ELASTICA_PLACES)),
}


def plan(
    scene: Scene,
    planner: str = "ctc",
    resolution: str = "fine",
    workers: int | None = None,
    on_update: OnUpdate | None = None,
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
