"""Many motions on the rod at once, LANES side by side: a set in seconds, so that laws can be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.physics.rod import flap_numbers, sight_numbers
from retract_env.rod import block as rods
from retract_env.rod import grip, measures
from retract_env.rod.chain import LANES
from retract_env.rod.flap import DEPTH, HEIGHT, MODULUS
from retract_env.scene import Scene
from retract_env.spring.columns import veins_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """What jaws do with a flap."""

    scene: Scene
    x: float
    """m, where they grasp"""
    progress: Array
    """(n,)"""
    poses: Array
    """(n, 4) x, y, theta, separation; m and rad"""


@dataclass(frozen=True)
class Followed:
    """What becomes of a flap on a course, in the units of `benchmarks.rod_motions.row`."""

    states: Array
    """(n, 12), up to the first move that the rod did not follow"""
    measured: Array
    """(n, MEASURED) as `retract_env.rod.measures` has it"""
    loads: Array
    """(n, 6) of `retract_env.rod.flap.move`"""
    rod_strain: Array
    """(n, 1) eps_1%, squeeze apart"""
    kept: Array
    """(n, GRIP)"""
    here: Array
    """(n, 4) x, y, theta, push; heights"""
    points: Array
    """(n, COLUMNS, 4) lower and upper surface, heights"""


def follow(courses: Sequence[Course], laws: tuple[Array, Array] | None = None) -> list[Followed]:
    """Every course to its end, whatever limits it passes. laws: of `retract_env.rod.grip.load`."""
    squeezed, held = laws or grip.load()
    found: list[Followed] = []
    for first in range(0, len(courses), LANES):
        found += _side_by_side(courses[first : first + LANES], squeezed, held)
    return found


def _side_by_side(courses: Sequence[Course], laws: Array, held: Array) -> list[Followed]:
    blocks = rods.new_blocks(1)
    block = rods.block_of(blocks, 0)
    veins = [veins_of(course.scene.tissue) for course in courses]
    for lane, course in enumerate(courses):
        block.flap[lane], block.sight[lane] = flap_numbers(course.scene), sight_numbers(course.scene)
        rods.hold(block, lane, course.x, 0.0, *veins[lane], laws, held)
    rows: list[list[tuple[Array, ...]]] = [[] for _ in courses]
    going = [True] * len(courses)
    closed = [0.0] * len(courses)
    for step in range(max(len(course.poses) for course in courses)):
        for lane, course in enumerate(courses):
            if not going[lane] or step >= len(course.poses):
                going[lane] = False
                continue
            x, y, theta, separation = course.poses[step].tolist()
            height = course.scene.tissue.height
            compression = (height - separation) / height
            if compression != closed[lane]:
                rods.close(block, lane, course.x, compression, *veins[lane], held)
                closed[lane] = compression
            rods.aim(block, lane, x, y, theta)
        rods.advance_blocks(blocks, held, 0, 1)
        for lane, course in enumerate(courses):
            if going[lane]:
                going[lane] = bool(block.done[lane])
            if going[lane]:
                rows[lane].append(_taken(block, lane, course, step))
    shapes = [part.shape for part in _taken(block, 0, courses[0], 0)]
    return [
        Followed(*(np.array([r[k] for r in lane]).reshape(-1, *s) for k, s in enumerate(shapes)))
        for lane in rows
    ]


def _taken(block: rods.Block, lane: int, course: Course, step: int) -> tuple[Array, ...]:
    flap, out = block.flap[lane], block.measured[lane].copy()
    unit = flap[MODULUS] * flap[HEIGHT] * flap[DEPTH]
    forces = unit * out[[measures.NORMAL_1, measures.NORMAL_2, measures.DRAG_1, measures.DRAG_2]]
    state = [
        course.progress[step],
        *course.poses[step],
        out[measures.WORST],
        *forces,
        out[measures.CLEARANCE],
        out[measures.OVERLAP],
    ]
    return (
        np.array(state),
        out,
        block.loads.reshape(6, LANES)[:, lane].copy(),
        block.rod_strain[lane : lane + 1].copy(),
        block.grip[lane].copy(),
        block.here.reshape(4, LANES)[:, lane].copy(),
        block.points.reshape(measures.COLUMNS, 4, LANES)[:, :, lane].copy(),
    )


def friction(states: Array) -> Array:
    """(n,) friction that each state requires, the larger of both jaws'; inf where a jaw does not press."""
    normal, along = states[:, 6:8], np.abs(states[:, 8:10])
    found: Array = np.where(normal > 0, along / np.where(normal > 0, normal, 1.0), np.inf).max(axis=1)
    return found
