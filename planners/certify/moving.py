"""How fast a retraction may be made: the certified motion again, at a speed, with inertia and vibration.

The jaws go the way that they went in the certificate, which is without time, at a mean speed; smoothly, by
the law of least jerk (Flash and Hogan 1985), from rest to rest, or at that speed from the first moment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planners.certify.retraction import SQUEEZE_INCREMENTS
from retract_env.errors import Diverged
from retract_env.grasp import to_pose
from retract_env.physics.base import TissueState
from retract_env.physics.moving import MovingFem
from retract_env.scene import Scene

Array = NDArray[np.float64]
Start = Literal["smooth", "sudden"]

STEP = 2e-3
"""s; a flap's free end, which vibrates slowest, does so 14 to 19 times a second."""
DAMPING = 0.05
"""Over the critical. That is little for soft tissue, and what is damped less needs more friction."""
LEAST_STEPS = 50
AFTERWARDS = 0.1
"""s, that the jaws are then held still, and the tissue is still looked at."""


@dataclass(frozen=True)
class Moving:
    """A motion in time."""

    speed: float
    """m/s, mean, of the point between the jaws"""
    start: Start
    damping: float
    """of the free end's first vibration, over the critical"""
    duration: float
    """s"""
    max_strain: float
    """eps_max"""
    required_friction: float
    clearance: float
    """m, least once the jaws stand still"""


def law(start: Start, part: float) -> float:
    """Part of the way that is made after a part of the time."""
    part = min(part, 1.0)
    return part if start == "sudden" else part**3 * (10 + part * (6 * part - 15))


def way_long(frames: Sequence[TissueState]) -> float:
    """m, that the point between the jaws goes once they are closed."""
    return float(_made(np.array([to_pose(f.jaws) for f in frames if f.progress >= 1]))[-1])


def _made(poses: Array) -> Array:
    """(n,) m, of the way until each pose (n, 4)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])


def moving(
    scene: Scene,
    frames: Sequence[TissueState],
    speed: float,
    resolution: str = "fine",
    start: Start = "smooth",
    damping: float = DAMPING,
    on_increment: Callable[[], None] = lambda: None,
) -> Moving:
    """Make the motion of a certificate's frames at a mean speed, m/s.

    Where it cannot be solved strain and friction are infinite. Raises ValueError for a speed that is none, or
    frames without a motion.
    """
    from scipy.interpolate import CubicSpline

    if not (np.isfinite(speed) and speed > 0):
        raise ValueError(f"speed = {speed:g} m/s, allowed above 0")
    kept = [f for f in frames if f.progress >= 1]
    if len(kept) < 2:
        raise ValueError("frames: no motion, allowed those of a certificate whose jaws have moved")
    poses = np.array([to_pose(f.jaws) for f in kept])
    poses[:, 2] = np.unwrap(poses[:, 2])
    at = np.array([f.progress for f in kept])
    made = _made(poses)
    duration, made = made[-1] / speed, made / made[-1]
    distinct = np.concatenate([[True], np.diff(made) > 1e-9])
    way = CubicSpline(made[distinct], poses[distinct])  # without corners, which would be shocks

    jaw_x = float(frames[0].jaws[0])
    physics = MovingFem(scene, jaw_x, resolution)
    physics.reset()
    opened = to_pose(frames[0].jaws)
    for k in range(1, SQUEEZE_INCREMENTS + 1):
        part = k / SQUEEZE_INCREMENTS
        physics.move_to(opened + part * (poses[0] - opened), part)
    physics.begin(damping)
    count = max(LEAST_STEPS, round(duration / STEP))
    step = duration / count
    state = physics.state()
    strain, friction = state.worst_strain, float(state.required_friction.max())
    clearance = np.inf
    for k in range(1, count + round(AFTERWARDS / step) + 1):
        part = law(start, k / count)
        try:
            state = physics.advance(way(part), step, float(np.interp(part, made, at)))
        except Diverged:
            strain, friction, clearance = np.inf, np.inf, -np.inf
            break
        strain = max(strain, state.worst_strain)
        friction = max(friction, float(state.required_friction.max()))
        if k >= count:
            clearance = min(clearance, state.clearance)
        on_increment()
    return Moving(speed, start, damping, duration, strain, friction, clearance)
