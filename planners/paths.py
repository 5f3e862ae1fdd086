"""Kinds of jaw paths. The paper's: constant tissue curvature (CTC), circular, linear. Sec. IV-D, V-B.

Every path begins at rest separation (row 0) and squeezed in place (row 1); the motion follows, at that
separation. It runs on past the pose where an ideal flap would clear the line of sight, to an end that
geometry sets, because gravity and veins ask for more: whoever follows it stops at visibility or at a limit.

The motion's laws are pure functions from one angle or length to the jaws' midpoint and the angle of their
axis, written so that they lose no digits at the flat start, where the radius is infinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from retract_env.spring import expected_compression

Array = NDArray[np.float64]

INCREMENTS = 24
"""Steps from the squeezed grasp to the pose where an ideal flap would clear the line of sight."""
LONGEST = 8
"""Steps of the longest path, over `increments`. One that would have more gets longer steps instead, so that
fewer of them lead to the goal."""
MOST_TURN = 1.5 * math.pi
"""rad. CTC ends when the arc has turned so far that the jaws come down on the other side of its centre."""
MOST_SWING = math.radians(170)
"""rad. Circular ends just before the flap would lie folded over on its surroundings."""
MOST_STRETCH = 2.0
"""Linear ends when the jaws are this many times as far from the fixed end as at rest."""


def goal_radius(camera: ArrayLike, target: ArrayLike) -> float:
    """Radius R_g, m, of the circle above the x axis, tangent to it at the origin and to the line AB. Eq. 6.

    camera A and target B: (2,) m. Raises ValueError where A is level with B or AB goes through the origin.
    """
    (ax, ay), (bx, by) = np.asarray(camera, dtype=np.float64), np.asarray(target, dtype=np.float64)
    cross = bx * ay - ax * by
    if ay == by:
        raise ValueError(f"line_of_sight.camera y = {ay:g} m, allowed any but the target's")
    if cross == 0:
        raise ValueError(f"line_of_sight.target x = {bx:g} m, allowed lines that miss the origin")
    return float((math.hypot(ax - bx, ay - by) * abs(cross) + (ax - bx) * cross) / (ay - by) ** 2)


def arc_turn(curvature: ArrayLike, arc: float, height: float) -> Array:
    """Angle phi = L / (R - h/2), rad, that a flap of length L, m, turns when its lower side curves by 1/R.

    curvature: (...,) 1/m, below 2/height. Returns (...,). Sec. IV-D.
    """
    curvature = np.asarray(curvature, dtype=np.float64)
    return arc * curvature / (1 - curvature * height / 2)


def arc_curvature(turn: ArrayLike, arc: float, height: float) -> Array:
    """Curvature 1/R, 1/m, of the lower side when length L, m, turns by phi, rad; undoes `arc_turn`."""
    turn = np.asarray(turn, dtype=np.float64)
    return turn / (arc + turn * height / 2)


def goal_turn(scene: Scene, arc: float) -> float:
    """Turn, rad, of a flap of length arc, m, at which Eq. 6 has it clear the line of sight; where the line is
    nearer than that, the last one that `ctc` makes."""
    line, height = scene.line_of_sight, scene.tissue.height
    return float(arc_turn(min(1 / goal_radius(line.camera, line.target), _end(arc, height)), arc, height))


def _end(arc: float, height: float) -> float:
    """Curvature 1/m at which `ctc` ends."""
    return min(1 / height, float(arc_curvature(MOST_TURN, arc, height)))


def ctc_motion(turn: ArrayLike, arc: float, height: float) -> Array:
    """Midpoint and axis angle (..., 3) when the medial axis, `arc` long up to the grasp, turns by phi (...,).

    With rho = R - h/2 = arc / phi the midpoint is (-rho sin phi, R - rho cos phi) and the axis points to the
    centre (0, R): the paper's p_a and p_b, one half separation away on each side. Sec. IV-D.
    """
    turn = np.asarray(turn, dtype=np.float64)
    rise = arc * turn / 2 * np.sinc(turn / (2 * np.pi)) ** 2
    return np.stack([-arc * np.sinc(turn / np.pi), height / 2 + rise, -turn], axis=-1)


def circular_motion(swing: ArrayLike, arc: float, height: float) -> Array:
    """Midpoint and axis angle (..., 3) when the grasp turned rigidly, clockwise, about (0, h/2). Sec. V-B.

    swing: (...,) rad.
    """
    swing = np.asarray(swing, dtype=np.float64)
    return np.stack([-arc * np.cos(swing), height / 2 + arc * np.sin(swing), -swing], axis=-1)


def linear_motion(way: ArrayLike, arc: float, height: float, slope: float) -> Array:
    """Midpoint and axis angle (..., 3) after the midpoint went `way` (...,), m, up a line of that slope, rad.

    The axis stays perpendicular to the line from (0, h/2) to the midpoint. Sec. V-B.
    """
    way = np.asarray(way, dtype=np.float64)
    x, rise = way * math.cos(slope) - arc, way * math.sin(slope)
    return np.stack([x, height / 2 + rise, -np.arctan2(rise, -x)], axis=-1)


def ctc(scene: Scene, grasp: Grasp, increments: int = INCREMENTS) -> JawPath:
    """Bend the flap to arcs of equal length and growing, constant curvature: "ctc". Sec. IV-D.

    `increments` equal steps of curvature 1/R lead from flat to R = R_g (Eq. 6, t = T), and more of them past
    it, up to R = h, where the flap's upper surface would shrink to a point, or a turn of `MOST_TURN`. Where
    that end comes before R_g, as for a far grasp and a near, steep line, the steps lead to the end.
    Raises ValueError for a grasp off the flap, jaws that would meet, or fewer than one increment.
    """
    arc, height = _arc(scene, grasp), scene.tissue.height
    end = _end(arc, height)
    goal = 1 / goal_radius(scene.line_of_sight.camera, scene.line_of_sight.target)
    turn = arc_turn(_steps(goal, end, increments), arc, height)
    return _path(scene, grasp, ctc_motion(turn, arc, height), "ctc")


def circular(scene: Scene, grasp: Grasp, increments: int = INCREMENTS) -> JawPath:
    """Turn the jaws rigidly about the fixed end (0, h/2): "circular". Sec. V-B.

    `increments` equal angles lead to the one where a straight flap is parallel to AB, and more of them past
    it, up to `MOST_SWING`. Raises ValueError as `ctc`.
    """
    arc = _arc(scene, grasp)
    swing = _steps(scene.line_of_sight.slope, MOST_SWING, increments)
    return _path(scene, grasp, circular_motion(swing, arc, scene.tissue.height), "circular")


def linear(scene: Scene, grasp: Grasp, slope: float, increments: int = INCREMENTS) -> JawPath:
    """Move the midpoint up and towards the fixed end on a line of that slope, rad: "linear60". Sec. V-B.

    The steps are as long as those of `circular`, of the order of those of `ctc`; they end where the midpoint
    is `MOST_STRETCH` times as far from (0, h/2) as at rest, past any admissible stretch.
    Raises ValueError as `ctc`, and for a slope outside (0, pi/2].
    """
    if not 0 < slope <= math.pi / 2:
        raise ValueError(f"slope = {slope:g} rad, allowed (0, {math.pi / 2:g}]")
    arc, cos = _arc(scene, grasp), math.cos(slope)
    # the distance d from the fixed end obeys d^2 = arc^2 - 2 arc way cos + way^2
    end = arc * (cos + math.sqrt(cos**2 + MOST_STRETCH**2 - 1))
    step = arc * _steps(scene.line_of_sight.slope, MOST_SWING, increments)[0]
    way = step * np.arange(1, math.floor(end / step) + 1)
    motion = linear_motion(way, arc, scene.tissue.height, slope)
    return _path(scene, grasp, motion, f"linear{math.degrees(slope):g}")


def _arc(scene: Scene, grasp: Grasp) -> float:
    """L, m: length of flap between the fixed end and the grasp, once that is known to be on it."""
    grasp.check_inside(scene.tissue.length, scene.tissue.height)
    return -grasp.x


def _steps(goal: float, end: float, increments: int) -> Array:
    """Equal steps from 0, exclusive: `increments` to the goal, or the end if nearer, then on to the end."""
    if increments < 1:
        raise ValueError(f"increments = {increments}, allowed at least 1")
    most = LONGEST * increments
    # a goal nearer than the shortest step is passed by the first one
    goal = max(min(goal, end), end / most)
    count = max(1, min(increments, math.floor(most * goal / end)))
    # the last step is not lost when the end is a whole number of steps, but for rounding
    total = math.floor(count * end / goal * (1 + 1e-12))
    return goal * (np.arange(1, total + 1) / count)


def _path(scene: Scene, grasp: Grasp, motion: Array, kind: str) -> JawPath:
    """Rest, squeeze and motion (n, 3) as one path."""
    height = scene.tissue.height
    poses = np.empty((2 + len(motion), 4))
    poses[:2, :3] = grasp.x, height / 2, 0.0
    poses[2:, :3] = motion
    poses[0, 3] = height
    poses[1:, 3] = height - expected_compression(scene, grasp)
    return JawPath.from_poses(poses, kind)


PathOf = Callable[[Scene, Grasp], JawPath]

PATHS: dict[str, PathOf] = {
    "ctc": ctc,
    "circular": circular,
    "linear60": partial(linear, slope=math.radians(60)),
    "linear75": partial(linear, slope=math.radians(75)),
}
"""Every kind of path, by the name that its `JawPath.kind` bears. No kind is a planner, or part of a study,
unless PLANNERS or the study names it."""
PAPER_PATHS = ("ctc", "circular", "linear60", "linear75")
"""The four kinds that the paper compares. Sec. V-B."""
