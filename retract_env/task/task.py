"""The task: what is rewarded, what counts as success or failure, when an episode ends. Pure functions.

The reward is a sum of terms, weighted by `TaskConfig.weights`. All but the last two are differences of a
potential, so that an episode is worth no more for being long, and ending it by breaking a limit saves
nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.mesh import SectionMesh
from retract_env.objectives import verdict
from retract_env.physics.base import TissueState
from retract_env.scenarios import Drawn
from retract_env.scene import LineOfSight, Scene, Tissue
from retract_env.task.config import TaskConfig
from retract_env.task.observation import Observer
from retract_env.task.rest import rest_section, rest_state
from retract_env.task.rules import exposed_past
from retract_env.task.situation import Situation


def default_scene() -> Scene:
    """The paper's homogeneous flap, the line of sight at 45 degrees meeting the bed at 25 % of its length."""
    tissue = Tissue(length=0.05, height=4.4e-3, depth=4.4e-3, density=1000.0, modulus=40e3, poisson=0.45)
    line = LineOfSight(camera=(-0.0825, 0.07), target=(-0.0125, 0.0))
    return Scene(name="homogeneous", tissue=tissue, line_of_sight=line)


def sound(state: TissueState) -> bool:
    """Whether all of a state is a number; a needed friction may be infinite."""
    # a sum is a number only if all of its terms are; to look at each takes ten times as long
    total = state.points.sum() + state.strain.sum() + state.jaws.sum() + state.reactions.sum()
    one, other = state.required_friction
    return math.isfinite(total + state.worst_strain + state.clearance) and not math.isnan(max(one, other))


@dataclass(frozen=True)
class Outcome:
    """What a step has led to."""

    over: bool = False
    """whether the task ends here"""
    in_view: bool = False
    """whether it ends because the target is in view"""
    failure: str = ""
    """the limit that is broken: "strain", "slip", "release" or "contact"; "diverged" where the physics cannot
    go on"""
    broke: bool = False
    """whether it broke in this step"""

    @property
    def success(self) -> bool:
        """Whether the target is in view and no limit is broken."""
        return self.in_view and not self.failure


class RetractionTask:
    """The task in one scene, or in what a draw makes of it."""

    def __init__(self, stated: Scene, config: TaskConfig | None = None, z: ArrayLike | None = None):
        """stated: what is known of the scene; z: (UNKNOWNS,) a draw of what is not, None: it is as stated."""
        self.stated, self.config = stated, config or TaskConfig()
        self.drawn = None if z is None else Drawn(stated, z)
        self.scene = scene = stated if self.drawn is None else self.drawn.scene
        """what there is"""
        self.observation: Callable[[Situation], NDArray[np.float32]] = Observer(scene, self.config, stated)
        """from a situation to the exact observation (SIZE,)"""
        self._weights: dict[str, float] = self.config.weights.model_dump()
        self._outset = rest_state(scene, rest_section(scene)).clearance

    def begin(self) -> Situation:
        """The flap at rest, the grasp still to be chosen."""
        section = rest_section(self.scene)
        waiting = rest_state(self.stated, section).jaws  # as far open as is known to be enough
        return self._situation(section, replace(rest_state(self.scene, section), jaws=waiting))

    def miss(self, before: Situation) -> Situation:
        """After the jaws closed without closing on the flap: it lies as before, and they are open again."""
        nothing = np.full(2, math.inf)
        state = replace(before.state, required_friction=nothing)
        return replace(before, state=state, greatest_friction=math.inf, missed=True)

    def hold(self, before: Situation, section: SectionMesh, state: TissueState) -> Situation:
        """After the jaws closed or moved; state belongs to section."""
        now = self._situation(section, state)
        return replace(
            now,
            holding=True,
            steps=before.steps,
            greatest_strain=max(before.greatest_strain, float(state.worst_strain)),
            greatest_friction=max(before.greatest_friction, float(state.required_friction.max())),
            overlapped=before.overlapped or state.overlap,
            off=before.off,
        )

    def _situation(self, section: SectionMesh, state: TissueState) -> Situation:
        line = self.scene.line_of_sight
        outline = state.points[section.boundary]
        seen = exposed_past(outline, *line.camera, line.target[0], -self.scene.tissue.length)
        return Situation(section, state, seen)

    @property
    def z(self) -> NDArray[np.float64] | None:
        """(UNKNOWNS,) the draw, None where there is none."""
        return None if self.drawn is None else self.drawn.z

    # --- What has become of it

    def judge(self, before: Situation, now: Situation) -> Outcome:
        """What the step from one situation to the next has led to.

        Where limits end an episode, they are the certifier's, asked of the state now. Where they only cost,
        the episode ends with the target in view, and a limit that was ever broken stays so: no certifier
        would call it a success. Jaws that have missed the flap have let go, which ends it in either case, as
        they can do no more.
        """
        if now.missed:
            return Outcome(over=True, failure="release", broke=True)
        if not now.holding:
            return Outcome()
        if self.config.limits == "end":
            found = self._verdict_on(now.state)
            failure = "" if found in (None, "ok") else found or ""
            return Outcome(found is not None, found == "ok", failure, bool(failure))
        in_view = self._verdict(0.0, 0.0, now.state.clearance, overlap=False) == "ok"
        failure = self._broken_so_far(now)
        return Outcome(in_view, in_view, failure, bool(failure) and not self._broken_so_far(before))

    def _broken_so_far(self, now: Situation) -> str:
        return self._verdict(now.greatest_strain, now.greatest_friction, -math.inf, now.overlapped) or ""

    def _verdict_on(self, state: TissueState) -> str | None:
        return self._verdict(state.worst_strain, state.required_friction, state.clearance, state.overlap)

    def _verdict(self, strain: float, friction: Any, clearance: float, overlap: bool) -> str | None:
        limits = self.scene.limits
        return verdict(strain, friction, clearance, limits.strain, limits.friction, limits.clearance, overlap)

    @property
    def stop_when(self) -> Callable[[TissueState], bool] | None:
        """Where a move may end that cannot be made whole: where a limit breaks, if that ends the episode."""
        return self._broken if self.config.limits == "end" else None

    def _broken(self, state: TissueState) -> bool:
        found = self._verdict_on(state)
        return state.progress >= 1 and found not in (None, "ok")

    # --- What it is worth

    def cost(self, now: Situation) -> float:
        """How many limits are broken now: of strain, of friction."""
        limits, state = self.scene.limits, now.state
        return float(state.worst_strain > limits.strain) + float(
            state.required_friction.max() > limits.friction
        )

    def cost_terms(self, now: Situation) -> dict[str, float]:
        """By how much of itself each limit is exceeded now, in [0, cap - 1]; 0 where it holds."""
        limits, state = self.scene.limits, now.state
        friction = float(state.required_friction.max())
        over = {"strain": state.worst_strain / limits.strain, "friction": friction / limits.friction}
        return {name: max(0.0, self._capped(share) - 1) for name, share in over.items()}

    def reward_terms(self, before: Situation, now: Situation, outcome: Outcome) -> dict[str, float]:
        """The weighted terms of a step's reward, by name; see `Weights`."""
        strain, friction = self.scene.limits.strain, self.scene.limits.friction
        margin = 1 - min(now.greatest_strain / strain, 1.0)
        terms = {
            "exposure": now.exposure - before.exposure,
            "clearance": self._way(now) - self._way(before),
            "strain": self._capped(now.greatest_strain / strain)
            - self._capped(before.greatest_strain / strain),
            "friction": self._capped(now.greatest_friction / friction)
            - self._capped(before.greatest_friction / friction),
            "success": 1 + margin if outcome.in_view else 0.0,
            "failure": 1.0 if outcome.broke else 0.0,
        }
        return {name: self._weights[name] * float(term) + 0.0 for name, term in terms.items()}  # no -0

    def info(self, now: Situation, terms: dict[str, float] | None, outcome: Outcome) -> dict[str, Any]:
        """What a step says besides; the same keys in every step of an episode.

        terms: of the reward; None where there is none, after a reset. With `unknowns`, the draw, where the
        scene is not quite as it is stated.
        """
        told: dict[str, Any] = {
            "is_success": outcome.success,
            "failure": outcome.failure,
            "cost": self.cost(now),
            "cost_terms": self.cost_terms(now),
            "max_strain": now.greatest_strain,
            "required_friction": now.greatest_friction,
            "clearance": float(now.state.clearance),
            "exposure": now.exposure,
            "reward_terms": dict.fromkeys(self._weights, 0.0) if terms is None else terms,
        }
        return told if self.drawn is None else told | {"unknowns": self.drawn.z.copy()}

    def _way(self, now: Situation) -> float:
        """Part of the way from the clearance at rest to what the scene asks for, in [0, 1]."""
        asked = self.scene.limits.clearance
        return float(np.clip(1 - (now.state.clearance - asked) / (self._outset - asked), 0.0, 1.0))

    def _capped(self, share: float) -> float:
        return min(share, self.config.cap)
