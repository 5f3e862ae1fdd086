"""What is shown of an environment on a rod: its observation, and what is told besides; compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env import scenarios
from retract_env.rod.chain import LANES
from retract_env.rod.flap import DEPTH, HEIGHT, LENGTH_M
from retract_env.rod.measures import COLUMNS
from retract_env.rod.section import columns_of, reactions_on
from retract_env.scene.ziggurat import standard_normal
from retract_env.task.arrays import (
    COST,
    COST_FRICTION,
    COST_STRAIN,
    DRAW,
    EXPOSURE,
    FAILURE,
    INSIDE,
    IS_DRAWN,
    MOST_FRICTION,
    MOST_STRAIN,
    REWARD_TERMS,
    SUCCESS,
    TO_LINE,
)
from retract_env.task.rules import (
    FRICTION_LIMIT,
    GOES_ON,
    KEYPOINTS,
    OK,
    STRAIN_LIMIT,
    TERMS,
    between,
    keypoints,
    observe,
    sensed,
    station,
)


@njit(**INSIDE)
def lying(length, height):
    """Both surfaces before the flap is touched."""
    lower, upper = np.empty((3, 2)), np.empty((3, 2))
    lower[0, 0], lower[1, 0], lower[2, 0] = -length, -length / 2, 0.0
    for k in range(3):
        upper[k, 0] = lower[k, 0]
        lower[k, 1], upper[k, 1] = 0.0, height
    return lower, upper


@njit(**INSIDE)
def find_keypoints(lanes, i, length, height):
    """Between which sections environment i's keypoints are, once it is known where its jaws grasp."""
    at = columns_of(length, height, lanes.grasp[i, 0])
    for k in range(KEYPOINTS):
        lanes.section[i, k], lanes.share[i, k] = between(at, station(k, length))


@njit(**INSIDE)
def surfaces_of(block, lane):
    """Lower and upper surface (COLUMNS, 2) m of one lane."""
    height = block.flap[lane, HEIGHT]
    lower, upper = np.empty((COLUMNS, 2)), np.empty((COLUMNS, 2))
    for column in range(COLUMNS):
        at = 4 * column * LANES + lane
        lower[column, 0], lower[column, 1] = block.points[at] * height, block.points[at + LANES] * height
        upper[column, 0] = block.points[at + 2 * LANES] * height
        upper[column, 1] = block.points[at + 3 * LANES] * height
    return lower, upper


@njit(**INSIDE)
def _points(lanes, block, i, out):
    """Environment i's keypoints into out (4 KEYPOINTS,), m."""
    lane = i % LANES
    length, height = block.flap[lane, LENGTH_M], block.flap[lane, HEIGHT]
    if not lanes.holding[i]:
        lower, upper = lying(length, height)
        keypoints(lower[:, 0], lower, length, out[: 2 * KEYPOINTS])
        keypoints(lower[:, 0], upper, length, out[2 * KEYPOINTS :])
        return
    for k in range(KEYPOINTS):
        section, share = lanes.section[i, k], lanes.share[i, k]
        here, there = 4 * section * LANES + lane, 4 * min(section + 1, COLUMNS - 1) * LANES + lane
        for surface in range(2):
            for axis in range(2):
                row = (2 * surface + axis) * LANES
                a, b = block.points[here + row] * height, block.points[there + row] * height
                out[2 * KEYPOINTS * surface + 2 * k + axis] = a + share * (b - a)


@njit(**INSIDE)
def observe_now(lanes, rules, block, i, out):
    """Environment i observed into out."""
    points = np.empty(4 * KEYPOINTS)
    _points(lanes, block, i, points)
    stated, forces = lanes.stated[i], (0.0, 0.0, 0.0, 0.0)
    length, height = stated[scenarios.LENGTH], stated[scenarios.HEIGHT]
    if lanes.holding[i]:
        flap, jaws = block.flap[i % LANES], lanes.jaws[i]
        unit = stated[scenarios.MODULUS] * stated[scenarios.JAW_WIDTH] * flap[DEPTH]
        forces = sensed(reactions_on(flap, block.measured[i % LANES], jaws), jaws, unit)
    observe(
        lanes.holding[i],
        1 - lanes.steps[i] / rules.steps,
        lanes.jaws[i],
        length,
        height,
        points,
        lanes.sight[i],
        lanes.k_eq[i],
        lanes.strain[i],
        lanes.most_strain[i],
        lanes.friction[i, 0],
        lanes.friction[i, 1],
        lanes.most_friction[i],
        lanes.clearance[i],
        lanes.exposure[i],
        lanes.limits[i],
        forces,
        lanes.off[i],
        rules.low,
        rules.high,
        out,
    )
    if len(rules.noise):
        for k in range(len(out)):
            blurred = out[k] + rules.noise[k] * standard_normal(lanes.rng[i])
            out[k] = min(max(blurred, rules.low[k]), rules.high[k])
    for k in range(len(out)):
        if rules.hidden[k]:
            out[k] = 0.0


@njit(**INSIDE)
def tell(lanes, rules, i, row):
    """What is told of environment i besides, into row (INFO,)."""
    strain, friction = lanes.limits[i, STRAIN_LIMIT], lanes.limits[i, FRICTION_LIMIT]
    needed = max(lanes.friction[i, 0], lanes.friction[i, 1])
    code = lanes.broken[i]
    failed = code != GOES_ON and code != OK
    row[SUCCESS] = 1.0 if lanes.in_view[i] and not failed else 0.0
    row[FAILURE] = code if failed else GOES_ON
    row[COST] = (1.0 if lanes.strain[i] > strain else 0.0) + (1.0 if needed > friction else 0.0)
    row[COST_STRAIN] = max(0.0, min(lanes.strain[i] / strain, rules.cap) - 1)
    row[COST_FRICTION] = max(0.0, min(needed / friction, rules.cap) - 1)
    row[MOST_STRAIN], row[MOST_FRICTION] = lanes.most_strain[i], lanes.most_friction[i]
    row[TO_LINE], row[EXPOSURE] = lanes.clearance[i], lanes.exposure[i]
    for k in range(len(TERMS)):
        row[REWARD_TERMS + k] = lanes.terms[i, k]
    row[IS_DRAWN] = 1.0 if lanes.drawn[i] else 0.0
    if lanes.drawn[i]:
        row[DRAW:] = lanes.z[i]
