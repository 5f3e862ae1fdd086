"""What every planner hands in, and how it says that it found nothing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from planners.certify import Certificate, Retraction
from retract_env.config import brief, unknown_keys
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS
from retract_env.scene import Scene

PROMISING = "promising"
"""Reason of a candidate that keeps all limits, on a rod or on a mesh that is too coarse for a certificate."""
TOO_COSTLY = "too costly"
"""Reason of a candidate that was given up because it took too much work."""


DISMISSED = "dismissed"
"""Reason of a candidate that the rod already shows to be no better than the best one, or to fail: its strain,
friction and clearance are the rod's (`planners.foresight`). Where no candidate is certified at least one
other tells what the finite elements said."""


@dataclass
class Candidate:
    """One retraction that a planner tried, and what came of it."""

    index: int
    grasp: Grasp
    path: JawPath
    status: str = "waiting"
    """waiting, searching, squeezing, squeezed, moving, done"""
    reason: str | None = None
    """why it ended: a certificate's reason, "pruned", "unmeshable", TOO_COSTLY, PROMISING, DISMISSED, or in a
    planner's own words; None while under way"""
    max_strain: float = math.nan
    """eps_max so far"""
    required_friction: float = math.nan
    clearance: float = math.nan
    """m"""
    increments: int = 0
    seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain data without the path, which the planner can make again from the grasp."""

        def number(x: float) -> float | str | None:
            return None if math.isnan(x) else x if math.isfinite(x) else str(x)

        return {
            "grasp": {
                "x": self.grasp.x,
                **self.grasp.firmness,
                "score": number(self.grasp.score),
            },
            "path": self.path.kind,
            "reason": self.reason,
            "max_strain": number(self.max_strain),
            "required_friction": number(self.required_friction),
            "clearance": number(self.clearance),
            "increments": self.increments,
        }


@dataclass(frozen=True)
class Verdict:
    """What became of a retraction, as its planner hears it."""

    reason: str
    """as `Candidate.reason`"""
    max_strain: float = math.nan
    required_friction: float = math.nan
    """as far as the retraction went"""
    clearance: float = math.nan
    """m"""
    progress: float = math.nan
    """in waypoints, of the last equilibrium; 0: none was found with the jaws closed at all"""
    history: Mapping[str, list[Any]] | None = None
    """as a certificate's, of a retraction that was followed"""


def verdict_of(retraction: Retraction, reason: str | None = None) -> Verdict:
    """Verdict on a retraction that ended; reason: why it was given up, where it did not end by itself."""
    reason = retraction.reason if reason is None else reason
    assert reason is not None, "a verdict is final"
    progress = retraction.frames[-1].progress if retraction.frames else math.nan
    strain, friction = retraction.max_strain, retraction.required_friction
    return Verdict(reason, strain, friction, retraction.clearance, progress, retraction.history())


Proposals = Generator[tuple[Grasp, JawPath], Verdict, Verdict | None]
"""What a contestant hands in one after the other, each answered by the verdict on it. Returns None where what
was certified last is to stand, or the last verdict if nothing was; or a verdict of its own, never "ok", where
it withdraws."""


class Contestant:
    """Hands retractions to the judge and hears the verdicts; this one hands in one and is content with it.

    A planner that tries things owns `Retraction`s, at whatever limits and resolution help it.
    """

    doubt = 0.0
    """A retraction that strains more than the best certified one by up to this part of it is followed on: the
    next proposal may strain less."""
    least_strain = 0.0
    """No proposal will strain less, as far as is known before the judge has looked; 0: nothing is known."""

    def __init__(self, grasp: Grasp, path: JawPath):
        """What it begins with."""
        self.grasp, self.path = grasp, path

    @property
    def is_content(self) -> bool:
        """Whether it hands in what it begins with and nothing else."""
        return type(self).propose is Contestant.propose

    def propose(self, on_increment: Callable[[], None]) -> Proposals:  # noqa: ARG002, it tries nothing itself
        """on_increment: to be called at each increment of what it tries itself; what it raises ends that.

        Diverged, MeshError and TooCostly may leave it, and are then the reason why it gave up.
        """
        yield self.grasp, self.path
        return None


@dataclass(frozen=True)
class Plan:
    """A certified retraction: grasp and path, the certificate, and every candidate that was tried, best score
    first."""

    scene: Scene
    planner: str
    grasp: Grasp
    path: JawPath
    certificate: Certificate
    candidates: tuple[Candidate, ...]
    timings: dict[str, float] = field(default_factory=dict, compare=False)
    """s of work by kind, summed over threads; "total" is wall-clock"""

    def to_json(self) -> dict[str, Any]:
        """Plain data that `plan_from_json` reads back; no wall-clock is in it."""
        resolution = self.certificate.mesh["resolution"]
        return plan_to_json(self.scene, self.planner, self.grasp, self.path, resolution, self.candidates)


def plan_to_json(
    scene: Scene,
    planner: str,
    grasp: Grasp,
    path: JawPath,
    resolution: str,
    candidates: Sequence[Candidate] = (),
) -> dict[str, Any]:
    """The content of a plan's file; planner: who made it; candidates: what was tried."""
    return {
        "scene": scene.dump(),
        "planner": planner,
        "grasp": {"x": grasp.x, **grasp.firmness},
        "path": path.to_json(),
        "resolution": resolution,
        "candidates": [c.to_json() for c in candidates],
    }


def plan_from_json(data: Mapping[str, Any]) -> tuple[Scene, Grasp, JawPath]:
    """Scene, grasp and path of a plan's file, which may tell no more than `plan_to_json` does.

    Raises ValueError, one line, for anything else.
    """
    if not isinstance(data, Mapping) or not {"scene", "grasp", "path"} <= set(data):
        raise ValueError("plan: allowed is an object with scene, grasp and path")
    known = ("scene", "planner", "grasp", "path", "resolution", "candidates")
    if faults := unknown_keys(data, known):
        raise ValueError("plan" + faults[0])
    if (resolution := data.get("resolution", "fine")) not in list(RESOLUTIONS):
        raise ValueError(f"plan.resolution = {brief(resolution)}, allowed {', '.join(RESOLUTIONS)}")
    if not isinstance(planner := data.get("planner", ""), str):
        raise ValueError(f"plan.planner = {brief(planner)}, allowed a text")
    candidates = data.get("candidates", [])
    if not isinstance(candidates, list) or not all(isinstance(c, Mapping) for c in candidates):
        raise ValueError(f"plan.candidates = {brief(candidates)}, allowed a list of objects")
    grasp, path = _grasp(data["grasp"]), JawPath.from_json(data["path"])
    return Scene.from_data(data["scene"]), grasp, path


def _grasp(data: object) -> Grasp:
    """The inverse of x and `Grasp.firmness`. Raises ValueError, one line."""
    firmness = "force" if isinstance(data, Mapping) and "force" in data else "compression"
    names, numbers = ("x", firmness), (int, float)
    if not isinstance(data, Mapping) or not all(
        isinstance(data.get(k), numbers) and not isinstance(data.get(k), bool) for k in names
    ):
        raise ValueError(
            "plan.grasp: allowed is an object with the numbers x and compression, or x and force"
        )
    if faults := unknown_keys(data, names):
        raise ValueError("plan.grasp" + faults[0])
    return Grasp(**{name: data[name] for name in names})


class NoPlan(Exception):
    """No candidate was certified. The message counts the reasons: 9 candidates: 6 strain, 2 slip, 1
    not_visible."""

    def __init__(self, candidates: Sequence[Candidate], detail: str = ""):
        self.candidates = tuple(candidates)
        reasons = Counter(str(c.reason) for c in self.candidates)
        listed = ", ".join(f"{n} {reason}" for reason, n in sorted(reasons.items(), key=lambda r: -r[1]))
        super().__init__(f"{len(self.candidates)} candidates: {listed or 'nothing to try'}{detail}")


class Planner(Protocol):
    """A planner by name in PLANNERS."""

    def __call__(
        self,
        scene: Scene,
        *,
        resolution: str,
        workers: int | None,
        on_update: Callable[[Sequence[Candidate]], None] | None,
    ) -> Plan:
        """Raises NoPlan."""
