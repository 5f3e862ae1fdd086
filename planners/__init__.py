"""Planners of retractions and the certifier that judges them all."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from inspect import signature
from typing import Any

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

__all__ = ["PLANNERS", "Candidate", "Certificate", "NoPlan", "Plan", "asked_of", "certify", "plan"]


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


GRIPS = ("position", "force")
"""What jaws may be closed by."""
LONGEST = 86_400.0
"""s, of a search."""


def plan(
    scene: Scene,
    planner: str = "swift",
    resolution: str = "fine",
    workers: int | None = None,
    on_update: OnUpdate | None = None,
    *,
    grip: str = "position",
    time: float | None = None,
) -> Plan:
    """Find a retraction that meets all three objectives, certified.

    planner: a name in PLANNERS; resolution: of the finite elements that certify; workers: candidates side by
    side, one a core by default; grip: one of GRIPS, by what the jaws are closed; time: s that a search may
    take, for planners that go on searching, as long as their first search takes by default. on_update is
    called, from the thread that works, whenever a candidate changed. Raises NoPlan, with what was tried,
    where nothing is certified; ValueError, one line, for an unknown name, or what that planner does not take.
    """
    asked = asked_of(planner, grip, time)
    return PLANNERS[planner](scene, resolution=resolution, workers=workers, on_update=on_update, **asked)


def asked_of(planner: str, grip: str = "position", time: float | None = None) -> dict[str, Any]:
    """What else a planner's function is given. Raises ValueError as `plan`."""
    if planner not in PLANNERS:
        close = get_close_matches(planner, PLANNERS, 1)
        hint = f", did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"planner = {planner!r}, allowed {', '.join(PLANNERS)}{hint}")
    if grip not in GRIPS:
        raise ValueError(f"grip = {grip!r}, allowed {', '.join(GRIPS)}")
    if time is not None and not 0 < time <= LONGEST:
        raise ValueError(f"time = {time:g} s, allowed (0, {LONGEST:g}] s")
    asked: dict[str, Any] = {}
    if grip != "position":
        _check_takes(planner, "grip", repr(grip), "position")
        asked["grip"] = grip
    if time is not None:
        _check_takes(planner, "time", f"{time:g} s", "none")
        asked["time"] = time
    return asked


def _takes(planner: str, name: str) -> bool:
    """Whether a planner's function has a parameter of that name."""
    return name in signature(PLANNERS[planner]).parameters


def _check_takes(planner: str, name: str, value: str, allowed: str) -> None:
    """Raise ValueError where a planner does not take what it is given."""
    if not _takes(planner, name):
        able = ", ".join(other for other in PLANNERS if _takes(other, name))
        raise ValueError(f"{name} = {value}, allowed {allowed} with planner {planner!r}; any with {able}")
