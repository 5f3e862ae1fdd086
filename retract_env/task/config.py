"""What a user may want to change about the task, as one object with today's task as its defaults."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import field_validator

from retract_env.config import Frozen, Listed, Range, brief, one_of, refusal, whole

Weight = Annotated[float, Range(-1e3, 1e3)]
Move = Annotated[float, Range(0.0, 0.05, "m", "(]")]
Turn = Annotated[float, Range(0.0, math.pi / 2, "rad", "(]")]
Share = Annotated[float, Range(0.0, 1.0, "height", "()")]
Push = Annotated[float, Range(0.0, 10.0, "E w d", "()")]


class Weights(Frozen):
    """What each term of the reward counts; 0 leaves it out."""

    exposure: Weight = 1.0
    """how much the exposure grew, in [-1, 1]"""
    clearance: Weight = 1.0
    """how much of the way from the clearance at rest to zero was made, in [-1, 1]"""
    strain: Weight = -0.5
    """how much the greatest strain so far grew over its limit, up to the cap"""
    friction: Weight = -0.25
    """how much the greatest needed friction so far grew over its limit, up to the cap"""
    success: Weight = 1.0
    """1 + margin in the step that brings the target into view; the margin is 1 - greatest strain / limit, in
    [0, 1]"""
    failure: Weight = -1.0
    """1 in the step that breaks a limit"""


class TaskConfig(Frozen):
    """The task but for its scene; plain data in, refused in one line where a value cannot be used."""

    weights: Weights = Weights()
    steps: Annotated[int, whole(1, 100_000)] = 64
    """Actions in an episode, that of the grasp among them."""
    move: Annotated[tuple[Move, Move, Turn], Listed] = (2e-3, 2e-3, math.radians(6.0))
    """m, m, rad: how far -1 or 1 moves the gripper in x, in y and in its angle."""
    compression: Annotated[tuple[Share, Share], Listed] = (0.02, 0.5)
    """Least and greatest compression of a grasp over the flap's height, for flaps as slender as the paper's;
    for others `rules.grip_range` says the least. The spring model's are at most half
    the strain limit (Eq. 5). Equal steps of the action are equal factors: needed friction goes with one over
    the compression, and the lightest grips that hold differ by that much."""
    grip: Annotated[Literal["compression", "force"], one_of(("compression", "force"))] = "compression"
    """What the jaws hold by, and the action chooses: how far they close, or the force with which they press
    from then on."""
    force: Annotated[tuple[Push, Push], Listed] = (0.03, 1.0)
    """Least and greatest force over E w d: modulus, jaws' width, flap's depth. A compression c of the height
    presses with about 2.6 E w d c, so that half the strain limit (Eq. 5) takes 0.6 and the least compression
    0.05; what presses with less than that slips, or hardly holds."""
    cap: Annotated[float, Range(1.0, 100.0, "limit", "(]")] = 2.0
    """Strain and friction over their limits are observed, rewarded and counted as cost up to here."""
    limits: Annotated[Literal["end", "cost"], one_of(("end", "cost"))] = "end"
    """What a broken limit does. "end": it ends the episode. "cost": it costs, and the episode goes on until
    the target is in view or time is up."""

    @field_validator("compression", "force")
    @classmethod
    def _grows(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not ends[0] < ends[1]:
            raise refusal(f" = {brief(list(ends))}, allowed [least, greatest]")
        return ends

    @property
    def firmness(self) -> tuple[float, float]:
        """Least and greatest of what the jaws hold by."""
        return self.force if self.grip == "force" else self.compression

    @property
    def reward_range(self) -> tuple[float, float]:
        """What one step's reward, and a whole episode's, cannot leave."""
        weights, cap = self.weights, self.cap
        spans = (
            (weights.exposure, -1.0, 1.0),
            (weights.clearance, -1.0, 1.0),
            (weights.strain, 0.0, cap),
            (weights.friction, 0.0, cap),
            (weights.success, 0.0, 2.0),
            (weights.failure, 0.0, 1.0),
        )
        low = sum(min(weight * least, weight * most) for weight, least, most in spans)
        return low, sum(max(weight * least, weight * most) for weight, least, most in spans)
