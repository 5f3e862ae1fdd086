"""The task: what is observed, what is rewarded, when an episode ends. Pure; the environment only calls it.

The observation is one flat vector, laid out in `LAYOUT`; `SLICES` names its parts, so that nobody counts
indices: `observation[SLICES["gripper"]]`.

The reward is a sum of terms, weighted by `WEIGHTS`. All but the last two are differences of a potential, so
that an episode is worth no more for being long, and ending it by breaking a limit saves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import to_pose
from retract_env.mesh import SectionMesh
from retract_env.objectives import exposure, verdict
from retract_env.physics.base import TissueState
from retract_env.scene import LineOfSight, Scene, Tissue
from retract_env.spring.stiffness import Stiffness
from retract_env.task.rest import rest_section, rest_state

Array = NDArray[np.float64]
Ints = NDArray[np.integer[Any]]

MAX_STEPS = 64
"""Actions in an episode, that of the grasp among them."""
KEYPOINTS = 10
"""Points of each surface that are observed, from the free end on, equally far apart at rest."""
STIFFNESS_SAMPLES = 50
"""Places along the flap, in the middle of as many equal parts of it, where k_eq is observed."""
CAP = 2.0
"""Strain and friction over their limits are observed and rewarded up to here."""

WEIGHTS = {
    "exposure": 1.0,
    "clearance": 1.0,
    "strain": -0.5,
    "friction": -0.25,
    "success": 1.0,
    "failure": -1.0,
}
"""What each term of the reward counts.

* exposure: how much the exposure grew, in [-1, 1].
* clearance: how much of the way from the clearance at rest to zero was made, in [-1, 1].
* strain: how much the greatest strain so far grew over its limit, up to CAP.
* friction: how much the greatest needed friction so far grew over its limit, up to CAP.
* success: 1 + margin in the step that succeeds; the margin is 1 - greatest strain / limit, in [0, 1].
* failure: 1 in the step that breaks a limit.
"""
REWARD_RANGE = (-4.5, 4.0)
"""What one step's reward, and a whole episode's, cannot leave."""


@dataclass(frozen=True)
class Part:
    """One part of the observation."""

    name: str
    size: int
    low: float
    high: float
    unit: str
    meaning: str


LAYOUT = (
    Part("holding", 1, 0, 1, "", "0 until the grasp is chosen, 1 with closed jaws"),
    Part("time_left", 1, 0, 1, f"{MAX_STEPS} steps", "steps that are left"),
    Part("gripper", 2, -3, 3, "length", "midpoint of the jaws, x and y"),
    Part("angle", 2, -1, 1, "", "sine and cosine of the jaw axis' angle, from +y, counter-clockwise"),
    Part("separation", 1, 0, 2, "height", "distance between the jaws"),
    Part(
        "lower",
        2 * KEYPOINTS,
        -3,
        3,
        "length",
        "keypoints of the lower surface from the free end on, x y x y",
    ),
    Part("upper", 2 * KEYPOINTS, -3, 3, "length", "keypoints of the upper surface, likewise"),
    Part("target", 1, -1, 0, "length", "x of B, where the line of sight meets the bed"),
    Part("slope", 1, 0, 2, "rad", "angle between the line of sight and the bed"),
    Part("nearness", 1, 0, 10, "1 / length", "one over the distance from B to the camera"),
    Part(
        "k_eq", STIFFNESS_SAMPLES, 0, 10, "modulus / height", "stiffness along the flap from the free end on"
    ),
    Part("strain", 1, 0, CAP, "limit", "eps_1% now"),
    Part("max_strain", 1, 0, CAP, "limit", "greatest eps_1% so far"),
    Part("friction", 2, 0, CAP, "limit", "friction that the lower and the upper jaw need now"),
    Part("max_friction", 1, 0, CAP, "limit", "greatest friction needed so far"),
    Part("clearance", 1, -3, 3, "length", "signed distance of the lowest tissue to the line of sight"),
    Part("exposure", 1, 0, 1, "", "fraction of the area of interest that the camera sees"),
)
"""Name, size, bounds, unit and meaning of each part. Values are clipped to their bounds."""

_ENDS = np.cumsum([part.size for part in LAYOUT]).tolist()
SIZE = _ENDS[-1]
SLICES = {part.name: slice(end - part.size, end) for part, end in zip(LAYOUT, _ENDS, strict=True)}
LOW = np.repeat([part.low for part in LAYOUT], [part.size for part in LAYOUT]).astype(np.float32)
HIGH = np.repeat([part.high for part in LAYOUT], [part.size for part in LAYOUT]).astype(np.float32)


def default_scene() -> Scene:
    """The paper's homogeneous flap, the line of sight at 45 degrees meeting the bed at 25 % of its length."""
    tissue = Tissue(length=0.05, height=4.4e-3, depth=4.4e-3, density=1000.0, modulus=40e3, poisson=0.45)
    line = LineOfSight(camera=(-0.0825, 0.07), target=(-0.0125, 0.0))
    return Scene(name="homogeneous", tissue=tissue, line_of_sight=line)


def sound(state: TissueState) -> bool:
    """Whether all of a state is a number; a needed friction may be infinite."""
    numbers = (state.points, state.strain, state.jaws, state.reactions, state.max_strain, state.clearance)
    return all(np.isfinite(n).all() for n in numbers) and not np.isnan(state.required_friction).any()


@dataclass(frozen=True)
class Situation:
    """Where an episode stands."""

    section: SectionMesh
    state: TissueState
    exposure: float
    holding: bool = False
    """whether the jaws have closed"""
    steps: int = 0
    """taken so far"""
    max_strain: float = 0.0
    """greatest so far"""
    required_friction: float = 0.0
    """greatest of both jaws so far"""


class RetractionTask:
    """The task in one scene."""

    def __init__(self, scene: Scene):
        self.scene = scene
        tissue, line = scene.tissue, scene.line_of_sight
        self._stations = -tissue.length * (1 - np.arange(KEYPOINTS) / KEYPOINTS)
        at = -tissue.length * (1 - (np.arange(STIFFNESS_SAMPLES) + 0.5) / STIFFNESS_SAMPLES)
        self._k_eq = Stiffness(tissue).k_eq(at) * tissue.height / tissue.modulus
        distance = np.hypot(*np.subtract(line.camera, line.target))
        self._sight = {
            "target": line.target[0] / tissue.length,
            "slope": line.slope,
            "nearness": tissue.length / distance,
        }
        self._outset = rest_state(scene, rest_section(scene)).clearance
        self._surfaces: tuple[SectionMesh, Ints, Ints] | None = None

    def begin(self) -> Situation:
        """The flap at rest, the grasp still to be chosen."""
        section = rest_section(self.scene)
        return self._situation(section, rest_state(self.scene, section))

    def hold(self, before: Situation, section: SectionMesh, state: TissueState) -> Situation:
        """After the jaws closed or moved; state belongs to section."""
        now = self._situation(section, state)
        return replace(
            now,
            holding=True,
            steps=before.steps,
            max_strain=max(before.max_strain, float(state.max_strain)),
            required_friction=max(before.required_friction, float(state.required_friction.max())),
        )

    def _situation(self, section: SectionMesh, state: TissueState) -> Situation:
        line = self.scene.line_of_sight
        outline = state.points[section.boundary]
        seen = exposure(outline, line.camera, line.target, -self.scene.tissue.length)
        return Situation(section, state, seen)

    def verdict(self, now: Situation) -> str | None:
        """ "ok", "strain", "slip" or "release", by the certifier's rule; None while the episode goes on."""
        if not now.holding:
            return None
        limits, state = self.scene.limits, now.state
        return verdict(
            state.max_strain, state.required_friction, state.clearance, limits.strain, limits.friction
        )

    def cost(self, now: Situation) -> float:
        """How many limits are broken now: of strain, of friction."""
        limits, state = self.scene.limits, now.state
        return float(state.max_strain > limits.strain) + float(
            state.required_friction.max() > limits.friction
        )

    def reward_terms(self, before: Situation, now: Situation, verdict: str | None) -> dict[str, float]:
        """The weighted terms of a step's reward, by name; see WEIGHTS."""
        margin = 1 - min(now.max_strain / self.scene.limits.strain, 1.0)
        terms = {
            "exposure": now.exposure - before.exposure,
            "clearance": self._way(now) - self._way(before),
            "strain": self._strain(now.max_strain) - self._strain(before.max_strain),
            "friction": self._friction(now.required_friction) - self._friction(before.required_friction),
            "success": 1 + margin if verdict == "ok" else 0.0,
            "failure": 1.0 if verdict not in (None, "ok") else 0.0,
        }
        return {name: WEIGHTS[name] * float(term) + 0.0 for name, term in terms.items()}  # no -0

    def info(
        self, now: Situation, terms: dict[str, float], verdict: str | None, diverged: bool = False
    ) -> dict[str, Any]:
        """What a step says besides; the same keys in every step, plain values all."""
        return {
            "is_success": verdict == "ok",
            "failure": "diverged" if diverged else "" if verdict in (None, "ok") else verdict,
            "cost": self.cost(now),
            "max_strain": now.max_strain,
            "required_friction": now.required_friction,
            "clearance": float(now.state.clearance),
            "exposure": now.exposure,
            "reward_terms": terms,
        }

    def _way(self, now: Situation) -> float:
        """Part of the way from the clearance at rest to zero, in [0, 1]."""
        return float(np.clip(1 - now.state.clearance / self._outset, 0.0, 1.0))

    def _strain(self, strain: float) -> float:
        return min(strain / self.scene.limits.strain, CAP)

    def _friction(self, friction: float) -> float:
        return min(friction / self.scene.limits.friction, CAP)

    def observation(self, now: Situation) -> NDArray[np.float32]:
        """(SIZE,) as LAYOUT says."""
        tissue, state, limits = self.scene.tissue, now.state, self.scene.limits
        x, y, theta, separation = to_pose(state.jaws).tolist()
        lower, upper = self._keypoints(now)
        parts = self._sight | {
            "holding": now.holding,
            "time_left": 1 - now.steps / MAX_STEPS,
            "gripper": np.array([x, y]) / tissue.length,
            "angle": (np.sin(theta), np.cos(theta)),
            "separation": separation / tissue.height,
            "lower": lower / tissue.length,
            "upper": upper / tissue.length,
            "k_eq": self._k_eq,
            "strain": state.max_strain / limits.strain,
            "max_strain": now.max_strain / limits.strain,
            "friction": state.required_friction / limits.friction,
            "max_friction": now.required_friction / limits.friction,
            "clearance": state.clearance / tissue.length,
            "exposure": now.exposure,
        }
        values = np.empty(SIZE)
        for name, value in parts.items():
            values[SLICES[name]] = value
        return np.clip(values, LOW, HIGH).astype(np.float32)

    def _keypoints(self, now: Situation) -> tuple[Array, Array]:
        """(2 KEYPOINTS,) m of the lower and of the upper surface."""
        section, points = now.section, now.state.points
        if self._surfaces is None or self._surfaces[0] is not section:
            self._surfaces = section, *surfaces(section, self.scene.tissue.height)
        found = []
        for nodes in self._surfaces[1:]:
            at = section.points[nodes, 0]
            found.append([np.interp(self._stations, at, c) for c in points[nodes].T])
        lower, upper = (np.stack(pair, axis=1).ravel() for pair in found)
        return lower, upper


def surfaces(section: SectionMesh, height: float) -> tuple[Ints, Ints]:
    """Nodes of the lower and of the upper surface, along x. height: m, of the flap."""
    x, y = section.points.T
    by_x = np.argsort(x, kind="stable")
    low, high = (by_x[np.abs(y[by_x] - level) < 1e-6 * height] for level in (0.0, height))
    return low, high
