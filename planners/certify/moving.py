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
LEAST_STEPS, MOST_STEPS = 50, 1500
"""Of a motion; one that takes longer than the latter resolve leaves nothing to vibrate."""
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
    poses = [to_pose(f.jaws) for f in frames if f.progress >= 1]
    return float(_made(np.array(poses))[-1]) if poses else 0.0


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
    frames whose jaws go nowhere.
    """
    from scipy.interpolate import CubicSpline

    if not (np.isfinite(speed) and speed > 0):
        raise ValueError(f"speed = {speed:g} m/s, allowed above 0")
    if way_long(frames) == 0:
        raise ValueError("frames: no motion, allowed those of a certificate whose jaws have gone somewhere")
    kept = [f for f in frames if f.progress >= 1]
    poses, at = np.array([to_pose(f.jaws) for f in kept]), [f.progress for f in kept]
    poses[:, 2] = np.unwrap(poses[:, 2])
    made = _made(poses)
    duration, made = made[-1] / speed, made / made[-1]
    distinct = np.concatenate([[True], np.diff(made) > 1e-9])
    way = CubicSpline(made[distinct], poses[distinct])  # without corners, which would be shocks

    count = round(min(max(duration / STEP, LEAST_STEPS), MOST_STEPS))
    steps = [duration / count] * count + [STEP] * round(AFTERWARDS / STEP)
    states = []
    try:
        physics = _closed(scene, to_pose(frames[0].jaws), poses[0], resolution)
        physics.begin(damping)
        states.append(physics.state())
        for k, step in enumerate(steps, 1):
            part = law(start, k / count)
            states.append(physics.advance(way(part), step, float(np.interp(part, made, at))))
            on_increment()
    except Diverged:
        return Moving(speed, start, damping, duration, np.inf, np.inf, -np.inf)
    return Moving(
        speed,
        start,
        damping,
        duration,
        max(state.worst_strain for state in states),
        max(float(state.required_friction.max()) for state in states),
        min(state.clearance for state in states[count:]),
    )


def _closed(scene: Scene, opened: Array, closed: Array, resolution: str) -> MovingFem:
    """The flap at rest between jaws that have closed from one pose (4,) to another."""
    physics = MovingFem(scene, float(opened[0]), resolution)
    physics.reset()
    for part in np.linspace(0, 1, SQUEEZE_INCREMENTS + 1)[1:]:
        physics.move_to(opened + part * (closed - opened), float(part))
    return physics
