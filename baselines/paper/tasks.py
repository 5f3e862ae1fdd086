"""The pieces of work that studies consist of: plain data in, plain data out, the same on any machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import planners
from baselines.jobs.version import code_version
from baselines.paper.surfaces import surfaces
from planners import NoPlan
from planners.base import Candidate
from planners.certify import Certificate, Trial
from planners.deform_closure import brute_force
from planners.light_grip import LightGrip
from planners.proposals import PATHS, along, stable_grasps
from planners.search import generate_and_test, race
from retract_env.errors import ConfigError
from retract_env.grasp import Grasp
from retract_env.scene import Scene
from retract_env.spring import SpringModel

Row = dict[str, Any]
"""One result: numbers, texts, and lists of them."""


@dataclass(frozen=True)
class Task:
    """One piece of work. Its result depends on nothing but kind, arguments, resolution and code."""

    kind: str
    """in KINDS"""
    arguments: Mapping[str, Any]
    """plain data"""
    label: Mapping[str, Any] = field(default_factory=dict)
    """what the study calls it"""

    def work(self, resolution: str) -> dict[str, Any]:
        """All that the result depends on, as plain data for `evaluate`."""
        return {
            "kind": self.kind,
            "arguments": dict(self.arguments),
            "resolution": resolution,
            "code": code_version(),
        }


def evaluate(work: Mapping[str, Any]) -> Row:
    """Do the work of a task. JSON has no infinities: friction without bound is "inf".

    Raises ConfigError where the work is for other code, as on a cluster that was not updated.
    """
    if work["code"] != code_version():
        raise ConfigError(f"a worker runs retract {code_version()}, the work is for {work['code']}")
    row = KINDS[work["kind"]](resolution=work["resolution"], **work["arguments"])
    return {name: str(v) if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}


def retraction(scene: Mapping[str, Any], x: float, compression: float, path: str, label: Row) -> Task:
    """Certify a grasp, m, with a path in PATHS."""
    arguments = {"scene": scene, "x": x, "compression": compression, "path": path}
    return Task("retraction", arguments, label)


def light_grip(scene: Mapping[str, Any], x: float, compression: float, path: str, label: Row) -> Task:
    """Certify the lightest grip that holds there; the compression is where its search begins."""
    arguments = {"scene": scene, "x": x, "compression": compression, "path": path}
    return Task("light_grip", arguments, label)


def _retraction(resolution: str, scene: Any, x: float, compression: float, path: str) -> Row:
    flap, grasp = Scene.from_data(scene), Grasp(x, compression)
    certificate = planners.certify(flap, grasp, PATHS[path](flap, grasp), resolution)
    return {"compression": compression, **_measured(certificate)}


def _light_grip(resolution: str, scene: Any, x: float, compression: float, path: str) -> Row:
    flap, grasp = Scene.from_data(scene), Grasp(x, compression)
    contestant = LightGrip(flap, grasp, PATHS[path](flap, grasp))
    try:
        (tried,) = race(flap, [contestant], "light_grip", resolution, 1).candidates
    except NoPlan as none:
        (tried,) = none.candidates
    return {"compression": tried.grasp.compression, **_measured(tried)}


def _measured(judged: Certificate | Candidate) -> Row:
    return {
        "reason": judged.reason,
        "max_strain": judged.max_strain,
        "required_friction": judged.required_friction,
        "clearance": judged.clearance,
    }


def _search(resolution: str, scene: Any, pruning: str) -> Row:
    """The paper's planner on one thread, with times, s, of this process."""
    flap = Scene.from_data(scene)
    proposals = along(flap, stable_grasps(flap), ["ctc"])
    Trial(flap, *proposals[0], "coarse").squeeze()  # the kernels are loaded
    start, cpu = time.perf_counter(), time.process_time()
    try:
        plan = generate_and_test(flap, proposals, "ctc", resolution, 1, pruning=pruning)
        candidates, best = plan.candidates, {"x": plan.grasp.x, "max_strain": plan.certificate.max_strain}
    except NoPlan as none:
        candidates, best = none.candidates, {"x": math.nan, "max_strain": math.nan}
    return {
        **best,
        "candidates": len(candidates),
        "pruned": sum(c.reason == "pruned" for c in candidates),
        "increments": sum(c.increments for c in candidates),
        "cpu_seconds": time.process_time() - cpu,
        "wall_seconds": time.perf_counter() - start,
    }


def _stiffness(resolution: str, scene: Any, pairs: int, nodes: int) -> Row:  # noqa: ARG001, `nodes` says it
    """Brute force and spring model, with times, s."""
    flap = Scene.from_data(scene)
    brute_force(flap, pairs=3, nodes=100)  # the kernels are loaded
    SpringModel(flap.tissue).stable_grasps()
    start, cpu = time.perf_counter(), time.process_time()
    found = brute_force(flap, pairs, nodes)
    fem, fem_cpu = time.perf_counter() - start, time.process_time() - cpu
    start, cpu = time.perf_counter(), time.process_time()
    spring = SpringModel(flap.tissue)
    stable_grasps(flap)
    spent, spent_cpu = time.perf_counter() - start, time.process_time() - cpu
    return {
        "x": found.x.tolist(),
        "k_fem": found.k.tolist(),
        "strain_fem": found.strain.tolist(),
        "k_spring": spring.k_eq(found.x).tolist(),
        "nodes": found.nodes,
        "fem_seconds": fem,
        "fem_cpu_seconds": fem_cpu,
        "spring_seconds": spent,
        "spring_cpu_seconds": spent_cpu,
    }


def _solid(resolution: str, scene: Any) -> Row:
    """One retraction of a deep flap, from the grasp that is best where the flap is as deep as high."""
    deep = Scene.from_data(scene)
    narrow = deep.tissue.model_copy(update={"depth": deep.tissue.height})
    best = planners.plan(deep.model_copy(update={"tissue": narrow}), "ctc", resolution, 1)
    start, cpu = time.perf_counter(), time.process_time()
    trial = Trial(deep, best.grasp, best.path, resolution)
    trial.squeeze()
    trial.move()
    spent, spent_cpu = time.perf_counter() - start, time.process_time() - cpu
    certificate = trial.certificate()
    skin, veins = surfaces(trial)
    return {
        "x": trial.grasp.x,
        "compression": trial.grasp.compression,
        "reason": certificate.reason,
        "max_strain": certificate.max_strain,
        "narrow_strain": best.certificate.max_strain,
        "required_friction": certificate.required_friction,
        "clearance": certificate.clearance,
        "increments": certificate.increments,
        "nodes": certificate.mesh["nodes"],
        "cpu_seconds": spent_cpu,
        "wall_seconds": spent,
        "jaws": trial.frames[-1].jaws.tolist(),
        "skin": skin,
        "veins": veins,
    }


KINDS: dict[str, Callable[..., Row]] = {
    "retraction": _retraction,
    "light_grip": _light_grip,
    "search": _search,
    "stiffness": _stiffness,
    "solid": _solid,
}
