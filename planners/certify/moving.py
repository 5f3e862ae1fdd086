"""How fast a retraction may be made: the certified motion again, at a speed, with inertia and vibration.

The jaws go through the poses that they had in the certificate, which is without time, on a smooth curve, at a
mean speed: by the law of least jerk (Flash and Hogan 1985), from rest to rest, or at that speed from the
first moment. Jaws that hold by force keep the separations which that took without inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

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

DAMPING = 0.05
"""Over the critical. Little for soft tissue."""
PER_PERIOD = 80
"""Steps of time in a period of the slowest vibration; twice as many change friction by .002."""
LEAST_STEPS, MOST_STEPS = 50, 1500
"""Of a motion; one that takes longer than the latter resolve leaves nothing to vibrate."""
AFTERWARDS = 2
"""Periods that the jaws are then held still, and the tissue is still looked at."""
NOWHERE = 1e-6
"""m; jaws that go less far do not move."""


@dataclass(frozen=True)
class Moving:
    """A motion in time."""

    speed: float
    """m/s, mean, of the jaw that goes farther"""
    start: Start
    damping: float
    """of the slowest vibration, over the critical"""
    duration: float
    """s"""
    max_strain: float
    """eps_max"""
    required_friction: float
    clearance: float
    """m, least once the jaws stand still"""
    overlap: bool
    """whether tissue ran into itself or the fixed block"""


def check_motion(scene: Scene, speed: float, start: str = "smooth", damping: float = DAMPING) -> None:
    """Raise ValueError where no such motion can be made."""
    if not 1e-6 <= speed <= 1e3:
        raise ValueError(f"speed = {speed:g} m/s, allowed 1e-06 to 1000")
    if start not in get_args(Start):
        raise ValueError(f"start = {start!r}, allowed {', '.join(get_args(Start))}")
    if not 0 <= damping < 1:
        raise ValueError(f"damping = {damping:g}, allowed [0, 1)")
    if scene.tissue.density == 0:
        raise ValueError("tissue.density = 0 kg/m^3, allowed above 0 for a motion in time")


def way_long(frames: Sequence[TissueState]) -> float:
    """m, that the jaw which goes farther goes once both are closed."""
    jaws = [f.jaws for f in frames if f.progress >= 1]
    return float(_made(np.array(jaws))[-1]) if jaws else 0.0


def _made(jaws: Array) -> Array:
    """(n,) m, of the way until each place of the jaws (n, 4), step by step of the one that goes farther."""
    steps = np.hypot(*np.moveaxis(np.diff(jaws, axis=0).reshape(-1, 2, 2), -1, 0)).max(axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def law(start: Start, part: float) -> float:
    """Part of the way that is made after a part of the time."""
    part = min(part, 1.0)
    return part if start == "sudden" else part**3 * (10 + part * (6 * part - 15))


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

    Where it cannot be solved strain and friction are infinite. Raises ValueError as `check_motion`, and for
    frames whose jaws go nowhere.
    """
    from scipy.interpolate import CubicSpline

    check_motion(scene, speed, start, damping)
    if way_long(frames) < NOWHERE:
        raise ValueError("frames: no motion, allowed those of a certificate whose jaws have gone somewhere")
    kept = [f for f in frames if f.progress >= 1]
    jaws = np.array([f.jaws for f in kept])
    made = _made(jaws)
    apart = np.concatenate([np.diff(made) > 0, [True]])  # of frames in one place the last
    made, jaws, at = made[apart], jaws[apart], np.array([f.progress for f in kept])[apart]
    poses = np.array([to_pose(places) for places in jaws])
    poses[:, 2] = np.unwrap(poses[:, 2])
    way, duration = CubicSpline(made, poses), float(made[-1] / speed)

    states = []
    try:
        physics = _closed(scene, to_pose(frames[0].jaws), poses[0], resolution)
        physics.begin(damping)
        states.append(physics.state())
        step = physics.period / PER_PERIOD
        count = round(min(max(duration / step, LEAST_STEPS), MOST_STEPS))
        for k, seconds in enumerate([duration / count] * count + [step] * (AFTERWARDS * PER_PERIOD), 1):
            gone = law(start, k / count) * made[-1]
            states.append(physics.advance(way(gone), seconds, float(np.interp(gone, made, at))))
            on_increment()
    except Diverged:
        return Moving(speed, start, damping, duration, np.inf, np.inf, -np.inf, overlap=False)
    return Moving(
        speed,
        start,
        damping,
        duration,
        max(state.worst_strain for state in states),
        max(float(state.required_friction.max()) for state in states),
        min(state.clearance for state in states[count:]),
        any(state.overlap for state in states),
    )


def _closed(scene: Scene, opened: Array, closed: Array, resolution: str) -> MovingFem:
    """The flap at rest between jaws that have closed from one pose (4,) to another."""
    physics = MovingFem(scene, float(opened[0]), resolution)
    physics.reset()
    for part in np.linspace(0, 1, SQUEEZE_INCREMENTS + 1)[1:]:
        physics.move_to(opened + part * (closed - opened), float(part))
    return physics
