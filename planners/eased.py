"""Retractions that spare the tissue: eased CTC paths, gripped as lightly as holds.

On a CTC path the jaws keep the flap at constant curvature up to where they hold it. The bending moment that
this takes passes through the grasp, as shear between jaws and tissue. Jaws that turn by only a part of the
arc's angle carry less of it, so that less friction is needed; and what friction is left over lets them close
less, which spares the tissue most of all: strain grows with the compression, needed friction with one over
it. A slight pull along the flap, finally, takes strain off the side that bending compresses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from planners import paths
from planners.base import PROMISING, TOO_COSTLY, Candidate, Contestant, NoPlan, Plan, Proposals
from planners.certify import Retraction
from planners.effort import TooCostly, retract
from planners.search import OnUpdate, race
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import jaw_range
from retract_env.scene import Scene

TURN = 0.82
"""Part of the arc's angle that the jaws turn by."""
STRETCH = 0.01
"""By how much the flap is drawn out where it would clear the line, over its length."""
RADII = (0.16, 0.20, 0.24, 0.29, 0.37, 0.45, 0.60, 0.75, 1.00)
"""Goal radii (Eq. 6), over the length, for which PLACES and FIRST are given; nearer and steeper lines of
sight have smaller ones. `python -m benchmarks.eased` fits both to random flaps and prints both."""
PLACES = (0.31, 0.33, 0.42, 0.47, 0.53, 0.60, 0.70, 0.77, 0.80)
"""Distance from the fixed end, over the length, of the grasp that strains the tissue least; for each of
RADII."""
FIRST = (0.26, 0.24, 0.16, 0.115, 0.082, 0.055, 0.038, 0.033, 0.036)
"""Compression, over the height, that about holds the flap there, for each of RADII; it is tried first. Veins
matter less than the line of sight."""
ASIDE = (0.0, -0.08, 0.08)
"""Shifts of the grasp, over the length, from the table's place: tried in this order until a grasp holds."""
BOUNDS = (0.02, 0.4)
"""Least and greatest compression, over the height."""
SHARE = 0.73
"""Part of the friction limit that a grip is to need. The rest covers differences between meshes, and the
errors of policies that learn from these plans."""
ENOUGH = (0.65, 0.80)
"""A compression that needs between these parts of the friction limit is corrected no further."""
FIRMER = 1.3
"""After a compression that slipped, this many times as much is tried."""
MOST_TRIALS = 4
"""Compressions tried for one grasp."""
SEARCHED_ON = "coarse"
INCREMENTS = 12
"""Increments of the paths that the search tries; the path handed in has those of `paths.INCREMENTS`."""


def eased(scene: Scene, grasp: Grasp, increments: int = paths.INCREMENTS) -> JawPath:
    """CTC with the jaws turned by a part `TURN` of the arc's angle, drawn out from the fixed end: "eased".

    The stretch grows with the turn, up to where an ideal flap would clear the line, and stays from there on.
    Raises ValueError as `ctc`.
    """
    poses = paths.ctc(scene, grasp, increments).poses.copy()
    goal = paths.goal_turn(scene, -grasp.x)
    fixed = np.array([0.0, scene.tissue.height / 2])
    factor = 1 + STRETCH * np.minimum(-poses[:, 2:3] / goal, 1.0)
    poses[:, :2] = fixed + factor * (poses[:, :2] - fixed)
    poses[:, 2] *= TURN
    return JawPath.from_poses(poses, "eased")


@dataclass
class _Search:
    """Retractions tried on the coarse mesh, all of them and those that hold."""

    scene: Scene
    on_update: OnUpdate | None = None
    tried: list[Candidate] = field(default_factory=list)
    holds: list[Candidate] = field(default_factory=list)

    def attempt(self, x: float, compression: float) -> Candidate:
        """Retract from x, m, with a compression over the height."""
        grasp = Grasp(x, compression * self.scene.tissue.height)
        path = eased(self.scene, grasp, INCREMENTS)
        tried = Retraction(self.scene, grasp, path, SEARCHED_ON)
        candidate = Candidate(len(self.tried), grasp, path, "done")
        try:
            retract(tried, lambda: None)
        except MeshError:
            candidate.reason = "unmeshable"
        except TooCostly:
            candidate.reason = TOO_COSTLY
        else:
            candidate.reason = PROMISING if tried.reason == "ok" else tried.reason
            candidate.max_strain, candidate.required_friction = tried.max_strain, tried.required_friction
            candidate.clearance, candidate.increments = tried.clearance, len(tried.frames) - 1
        self.tried.append(candidate)
        if self.on_update is not None:
            self.on_update(self.tried)
        return candidate

    @property
    def best_first(self) -> list[Grasp]:
        """Grasps that hold, of least strain first."""
        return [c.grasp for c in sorted(self.holds, key=lambda c: (c.max_strain, c.index))]


class InTurn(Contestant):
    """Hands in an eased path from one grasp after the other, until one is certified."""

    def __init__(self, scene: Scene, grasps: Sequence[Grasp]):
        super().__init__(grasps[0], eased(scene, grasps[0]))
        self.scene, self.grasps = scene, grasps

    def propose(self, on_increment: Callable[[], None]) -> Proposals:  # noqa: ARG002, the judge tries
        """One after the other."""
        for grasp in self.grasps:
            verdict = yield grasp, eased(self.scene, grasp)
            if verdict.reason == "ok":
                break
        return None


def plan_eased(
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: OnUpdate | None,
) -> Plan:
    """Search on the coarse mesh, then hand in the first that is certified. Raises NoPlan."""
    searched = search(scene, on_update)
    if not searched.holds:
        raise NoPlan(searched.tried)
    contestants = [InTurn(scene, searched.best_first)]
    return race(scene, contestants, "eased", resolution, workers, on_update, tried=searched.tried)


def search(scene: Scene, on_update: OnUpdate | None = None) -> _Search:
    """Try compressions on the coarse mesh, and another place where none holds."""
    tissue, line = scene.tissue, scene.line_of_sight
    radius = paths.goal_radius(line.camera, line.target) / tissue.length
    place, first = (float(np.interp(radius, RADII, values)) for values in (PLACES, FIRST))
    low, high = jaw_range(tissue.length, scene.jaws.width)
    under_way = _Search(scene, on_update)
    for aside in ASIDE:
        _compressions(under_way, float(np.clip(-(place + aside) * tissue.length, low, high)), first)
        if under_way.holds:
            break
    return under_way


def _compressions(search: _Search, x: float, first: float) -> None:
    """Compressions at x, m, each corrected by the friction that the one before needed."""
    (low, high), compression = BOUNDS, first
    for _ in range(MOST_TRIALS):
        candidate = search.attempt(x, compression)
        share = candidate.required_friction / search.scene.limits.friction
        if candidate.reason == PROMISING:
            if share <= ENOUGH[1]:
                search.holds.append(candidate)
            if ENOUGH[0] <= share <= ENOUGH[1] or (compression == low and share < ENOUGH[0]):
                return
        elif candidate.reason not in ("slip", "release"):
            return
        # needed friction goes with one over the compression; a slip tells only that it was too little
        factor = share / SHARE if candidate.reason == PROMISING else FIRMER
        if compression == high and factor > 1:
            return
        compression = float(np.clip(compression * factor, low, high))
