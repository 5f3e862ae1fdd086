"""What a certified plan survives, and how firmly it would have to be held to survive nearly everything.

Draws of what is not known are followed by the rod, corrected by what the certificate's finite elements felt,
as in the robust statement (`planners.certify.robust`). That bounds a probability from above; here it is
estimated, so that draws which the rod cannot decide are judged by finite elements or, beyond a number of
them, counted by the rod's word.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.certify import certify
from planners.certify.robust import RARE, corrected_by, exceeded, followed, levels, outcome
from planners.correction import Correction
from planners.whatif import Flaps
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

Array = NDArray[np.float64]
History = Mapping[str, Sequence[Any]]
"""Of a certificate."""

ON = "coarse"
"""Finite elements that draws are judged on."""
ENOUGH = 0.99
"""Survival at which grips are compared."""
MOST = 0.45
"""Compression over the height, at most; that of `planners.swift`."""
HALVINGS = 3
"""of the step between the lightest rung of a ladder that survives and the next"""
FIRMER = (5.0, 4.0, 3.2, 2.5, 2.0, 1.6, 1.25, 1.0)
"""Rungs of the ladder on which a plan's own grip is made firmer: times its compression, or its force."""
TRIES, STEP = 3, 1.12
"""Rungs of it that are certified, and the factor from one to the next: the rod is corrected by the plan's own
certificate until then, and may promise too much."""


@dataclass(frozen=True)
class Survived:
    """How many of some draws a plan survives."""

    share: float
    draws: int
    judged: int = 0
    """of them by finite elements"""
    undecided: int = 0
    """of them neither by finite elements nor by the rod with the margin that its word needs"""
    few: bool = False
    """whether they are the first few alone, by finite elements, as the rod cannot follow the plan"""

    @property
    def nearly_all(self) -> bool:
        """Whether so many survive that grips are compared; a few draws cannot tell."""
        return self.share >= ENOUGH and not self.few


def by_rod(
    scene: Scene, grasp: Grasp, path: JawPath, corrected: Correction, z: Array
) -> tuple[Array, NDArray[np.object_]]:
    """(n,) the greatest level with which the plan holds on each draw, and what becomes of it, by the rod."""
    return levels(followed(scene, grasp, path, Flaps(scene, z), corrected))


def share_by_rod(scene: Scene, grasp: Grasp, path: JawPath, history: History, z: Array) -> float:
    """The part of draws that a plan survives, by the rod alone; 0 where it cannot follow the plan."""
    corrected = corrected_by(scene, grasp, path, history)
    if corrected is None:
        return 0.0
    return float(np.mean(by_rod(scene, grasp, path, corrected, z)[1] == "ok"))


def survived(scene: Scene, grasp: Grasp, path: JawPath, history: History, z: Array, most: int) -> Survived:
    """What a certified plan survives of draws z (n, UNKNOWNS), `most` of them at most by finite elements.

    Where the rod cannot follow the plan, those few are all that is judged.
    """
    corrected = corrected_by(scene, grasp, path, history)
    if corrected is None:
        ends = [outcome(scene, grasp, path, one, ON) for one in z[:most]]
        return Survived(ends.count("ok") / max(1, len(ends)), len(ends), len(ends), few=True)
    level, reason = by_rod(scene, grasp, path, corrected, z)
    holds = reason == "ok"
    held = (level > 0) & (exceeded(np.maximum(level, 0.0)) <= RARE)
    between = np.flatnonzero(~held & (level != -2.0))
    for i in between[:most]:
        holds[i] = outcome(scene, grasp, path, z[i], ON) == "ok"
    judged = min(len(between), most)
    return Survived(float(holds.mean()), len(z), judged, len(between) - judged)


def lightest_part(survival_of: Callable[[float], float], parts: Sequence[float]) -> float | None:
    """The lightest part of a grip that survives: of a ladder from firm to light, the last rung before those
    that do not, then between it and the next; None where no rung survives."""
    surviving = [survival_of(part) >= ENOUGH for part in parts]
    if True not in surviving:
        return None
    first = surviving.index(True)
    after = surviving.index(False, first) if False in surviving[first:] else len(parts)
    part = parts[after - 1]
    if after < len(parts):
        too_light = parts[after]
        for _ in range(HALVINGS):
            between = math.sqrt(part * too_light)
            if survival_of(between) >= ENOUGH:
                part = between
            else:
                too_light = between
    return part


def firmer(scene: Scene, grasp: Grasp, path: JawPath, part: float) -> tuple[Grasp, JawPath] | None:
    """The same place and motion with jaws that close so many times as far, or press so many times as hard;
    None where they would close too far."""
    if grasp.force is not None:
        return Grasp(grasp.x, force=part * grasp.force), path
    height, poses = scene.tissue.height, path.poses.copy()
    closed = part * (height - poses[1:, 3])
    if closed.max() > MOST * height:
        return None
    poses[1:, 3] = height - closed
    return Grasp(grasp.x, part * grasp.compression), JawPath.from_poses(poses, path.kind)


def made_firm(
    scene: Scene, grasp: Grasp, path: JawPath, history: History, z: Array, most: int, resolution: str
) -> tuple[float, float] | None:
    """How many times as firm a plan that survives too little has to be held, and its strain then; None where
    no grip of that place and motion survives."""
    corrected = corrected_by(scene, grasp, path, history)
    if corrected is None:
        return None
    grips = {part: grip for part in FIRMER if (grip := firmer(scene, grasp, path, part)) is not None}

    def survival_of(part: float) -> float:
        held = firmer(scene, grasp, path, part)
        assert held is not None
        return float(np.mean(by_rod(scene, *held, corrected, z)[1] == "ok"))

    found = lightest_part(survival_of, list(grips))
    for part in _rungs_from(found) if found is not None else ():
        if (held := firmer(scene, grasp, path, part)) is None:
            return None
        try:
            judged = certify(scene, *held, resolution)
        except MeshError:
            continue
        if judged.certified and survived(scene, *held, judged.history, z, most).nearly_all:
            return part, judged.max_strain
    return None


def _rungs_from(part: float) -> Iterator[float]:
    """The rung that the rod promises to be enough, and firmer ones; not the plan's own, which is not."""
    first = max(part, STEP)
    return (first * STEP**k for k in range(TRIES))
