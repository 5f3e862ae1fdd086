"""Experiments on what plans survive: a planner's plan, or one of the paper's paths gripped more and less
firmly, judged on flaps that are not quite as the scene says."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from baselines.benchmark.methods import COMPETING
from baselines.benchmark.survival import MOST, ON, lightest_part, share_by_rod
from baselines.jobs.journal import Row
from baselines.paper.experiments import measured
from planners import PLANNERS
from planners.base import NoPlan
from planners.certify import Certificate, Robust, certify, stated
from planners.certify.robust import outcome
from planners.foresight import foresee
from planners.paths import PATHS
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.scenarios import draws
from retract_env.scene import UNKNOWNS, Scene, Uncertainty

BY_ROD, ROD_SEED = 1000, 52_000_001
"""Draws that the rod judges, and their seed; not those of the robust statement, of planners or of the finite
elements."""
PARTS = (1.6, 1.25, 1.0, 0.8, 0.63, 0.5, 0.4, 0.3, 0.2)
"""Rungs of a ladder: parts of the compression by Eq. 5."""


def scaled(prior: Uncertainty, by: float) -> Uncertainty:
    """The prior with all ranges as many times as wide; 0: all is known, Poisson's ratio included."""
    if by in (0.0, 1.0):
        return prior if by else Uncertainty.none()
    said: dict[str, Any] = {}
    for name in (*UNKNOWNS, "force_floor"):
        value = getattr(prior, name)
        if name != "poisson":
            said[name] = by * value
        elif value is not None:
            middle, half = (value[0] + value[1]) / 2, by * (value[1] - value[0]) / 2
            said[name] = max(0.0, middle - half), min(0.49, middle + half)
    return Uncertainty(**said)


def planned(
    resolution: str, scene: Any, planner: str, prior: float, count: int, seed: int, hopeless: float
) -> Row:
    """A planner's plan, made for a prior as many times as wide as the scene's, and judged under the scene's.

    count: draws that finite elements judge, with their seed; 0: the rod alone judges, and nothing is stated;
    hopeless: survival by the rod below which the robust statement is not asked for. It would not hold, and
    say so after many retractions on the fine mesh.
    """
    flap = Scene.from_data(scene)
    asked = flap.model_copy(update={"uncertainty": scaled(flap.uncertainty, prior)})
    try:
        plan = COMPETING[planner](asked, resolution=resolution, workers=1, on_update=None)
    except NoPlan:
        return without_plan()
    return judged(flap, plan.grasp, plan.path, plan.certificate, count, seed, hopeless)


def lightest(resolution: str, scene: Any, path: str, count: int, seed: int, hopeless: float) -> Row:
    """One of PATHS from where the paper's planner grasps, closed as lightly as survives; `ladder` tells what
    other compressions come to. Where Eq. 5 holds nowhere, from the grasp that needs least friction there."""
    flap = Scene.from_data(scene)
    try:
        grasp = PLANNERS[path](flap, resolution=resolution, workers=1, on_update=None).grasp
    except NoPlan as none:
        # by the rod, which follows each path to its end
        foreseen = foresee(flap, [(c.grasp, c.path) for c in none.candidates])
        pairs = zip(foreseen, none.candidates, strict=True)
        known = [(f.friction, c.grasp) for f, c in pairs if math.isfinite(f.friction)]
        if not known:
            return without_plan() | {"part": None, "ladder": []}
        grasp = min(known, key=lambda one: one[0])[1]
    allowed = [part for part in PARTS if part * grasp.compression <= MOST * flap.tissue.height]
    ladder: list[Row] = []

    def survival_of(part: float) -> float:
        ladder.append(rung(flap, grasp, path, part))
        return float(ladder[-1]["survival"])

    part = lightest_part(survival_of, allowed)
    if part is None:
        part = max(ladder, key=lambda r: r["survival"])["part"]
    grip = Grasp(grasp.x, part * grasp.compression)
    way = PATHS[path](flap, grip)
    row = judged(flap, grip, way, certify(flap, grip, way, resolution), count, seed, hopeless)
    return {**row, "part": part, "ladder": sorted(ladder, key=lambda r: -r["part"])}


def rung(scene: Scene, grasp: Grasp, path: str, part: float) -> Row:
    """What becomes of a part of a grasp's compression: on the coarse mesh, and how often by the rod."""
    grip = Grasp(grasp.x, part * grasp.compression)
    way = PATHS[path](scene, grip)
    row: Row = {"part": part, "compression": grip.compression}
    try:
        certificate = certify(scene, grip, way, ON)
    except MeshError:
        return row | {"reason": "unmeshable", "max_strain": 0.0, "survival": 0.0}
    said = {"reason": certificate.reason, "max_strain": certificate.max_strain}
    return row | said | {"survival": survival(scene, grip, way, certificate)}


def survival(scene: Scene, grasp: Grasp, path: JawPath, certificate: Certificate) -> float:
    """The part of BY_ROD draws that a plan survives, by the rod that the certificate's mesh corrects."""
    return share_by_rod(scene, grasp, path, certificate.history, draws(BY_ROD, ROD_SEED))


def judged(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    count: int,
    seed: int,
    hopeless: float,
) -> Row:
    """What a row says of a plan: its certificate, the robust statement, and what it survives."""
    row: Row = {
        "x": grasp.x,
        "compression": None if grasp.force else grasp.compression,
        "force": grasp.force,
        **measured(certificate),
        **NOT_JUDGED,
        "by_rod": survival(scene, grasp, path, certificate),
    }
    if not count:
        return row
    row["holds"] = False
    if row["by_rod"] >= hopeless:
        said = stated(certificate, scene, grasp, path, Robust()).robust
        assert said is not None
        row |= {"holds": said["holds"], "bound": said["bound"]}
        row["stated_failures"] = sum(said["failures"].values())
    ends = Counter(outcome(scene, grasp, path, z, ON) for z in draws(count, seed))
    return row | {
        "draws": count,
        "survived": ends.pop("ok", 0),
        "ends": " ".join(f"{reason} {n}" for reason, n in sorted(ends.items())),
    }


NOT_JUDGED: Row = {
    "holds": None, "bound": None, "stated_failures": None, "by_rod": 0.0, "draws": 0, "survived": 0,
    "ends": "",
}  # fmt: skip


def without_plan() -> Row:
    """The row of a planner that found nothing."""
    nothing = {"x": None, "compression": None, "force": None, "reason": "no plan", "max_strain": None}
    return {**nothing, "required_friction": None, "clearance": None, **NOT_JUDGED}
