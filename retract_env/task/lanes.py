"""Episodes on rods side by side: what `Episode` and `RetractionTask` do for one flap, for a block's lanes.

Everything here is compiled, needs no Python while it runs, and treats a lane as if it were alone; `Lanes` and
`Rules` are in `retract_env.task.arrays`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retract_env.mesh.jaws import SLIVER
from retract_env.rod.block import aim, hold, hold_by_force, jaws_in
from retract_env.rod.chain import LANES
from retract_env.rod.flap import (
    DEPTH,
    HEIGHT,
    JAW_WIDTH,
    LENGTH_M,
    MODULUS,
    POISSON,
)
from retract_env.rod.measures import (
    CAMERA_X,
    CAMERA_Y,
    CLEARANCE,
    FIRST_HIT,
    FRICTION_1,
    FRICTION_2,
    HIGHEST,
    LAST_HIT,
    OVERLAP,
    TARGET_X,
    WORST,
)
from retract_env.scene import flaps
from retract_env.scene.flaps import draw_flap
from retract_env.spring.columns import columns
from retract_env.task.arrays import INSIDE
from retract_env.task.rules import (
    CLEARANCE_LIMIT,
    DIVERGED,
    FRICTION_LIMIT,
    GOES_ON,
    OK,
    STIFFNESS_SAMPLES,
    STRAIN_LIMIT,
    TERMS,
    exposed_above,
    grip_range,
    exposed_beside,
    rest_clearance,
    verdict,
    way,
)
from retract_env.task.shown import find_keypoints, lying, surfaces_of


@njit(**INSIDE)
def new_flap(lanes, rules, block, i):
    """Give environment i a random flap; False where its veins have no room."""
    lane = i % LANES
    scalars, flap, sight = lanes.scalars[i], block.flap[lane], block.sight[lane]
    wanted, placed = draw_flap(
        lanes.rng[i], rules.ranges, scalars, lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    )
    flap[LENGTH_M], flap[HEIGHT], flap[DEPTH] = (
        scalars[flaps.LENGTH],
        scalars[flaps.HEIGHT],
        scalars[flaps.DEPTH],
    )
    flap[MODULUS], flap[POISSON] = scalars[flaps.MODULUS], rules.poisson
    sight[CAMERA_X], sight[CAMERA_Y] = scalars[flaps.CAMERA_X], scalars[flaps.CAMERA_Y]
    sight[TARGET_X] = scalars[flaps.TARGET_X]
    return wanted == placed


@njit(**INSIDE)
def look(lanes, block, i):
    """What does not change while environment i has this flap and line of sight."""
    flap, sight = block.flap[i % LANES], block.sight[i % LANES]
    length, height, modulus = flap[LENGTH_M], flap[HEIGHT], flap[MODULUS]
    at = np.empty(STIFFNESS_SAMPLES)
    for k in range(STIFFNESS_SAMPLES):
        at[k] = -length * (1 - (k + 0.5) / STIFFNESS_SAMPLES)
    k_eq = lanes.k_eq[i]
    columns(length, height, modulus, lanes.vertices[i], lanes.offsets[i], lanes.moduli[i], at, k_eq)
    for k in range(STIFFNESS_SAMPLES):
        k_eq[k] = k_eq[k] * height / modulus
    dx, dy = sight[CAMERA_X] - sight[TARGET_X], sight[CAMERA_Y]
    lanes.sight[i, 0] = sight[TARGET_X] / length
    lanes.sight[i, 1] = math.atan2(dy, sight[TARGET_X] - sight[CAMERA_X])
    lanes.sight[i, 2] = length / math.hypot(dx, dy)
    lanes.outset[i] = rest_clearance(length, height, sight[CAMERA_X], sight[CAMERA_Y], sight[TARGET_X])


@njit(**INSIDE)
def begin(lanes, rules, block, i):
    """Environment i at the outset of an episode; False where there is no room for a random flap's veins."""
    if lanes.random[i] and not new_flap(lanes, rules, block, i):
        return False
    look(lanes, block, i)
    flap, sight = block.flap[i % LANES], block.sight[i % LANES]
    length, height, width = flap[LENGTH_M], flap[HEIGHT], flap[JAW_WIDTH]
    lanes.holding[i], lanes.steps[i], lanes.over[i] = False, 0, False
    lanes.jaws[i, 0] = lanes.jaws[i, 2] = -length - width
    lanes.jaws[i, 1], lanes.jaws[i, 3] = 0.0, height
    lanes.strain[i] = lanes.most_strain[i] = lanes.most_friction[i] = 0.0
    lanes.friction[i, 0] = lanes.friction[i, 1] = 0.0
    lanes.overlapped[i], lanes.broken[i], lanes.in_view[i] = False, GOES_ON, False
    lanes.clearance[i] = lanes.outset[i]
    for k in range(len(TERMS)):
        lanes.terms[i, k] = 0.0
    lower, upper = lying(length, height)
    lanes.exposure[i] = exposed_above(
        lower, upper, sight[CAMERA_X], sight[CAMERA_Y], sight[TARGET_X], -length
    )
    return True


@njit(**INSIDE)
def act(lanes, rules, block, i, action):
    """Have environment i's jaws close or move as an action (3,) in [-1, 1] says, at the next `advance`."""
    lane = i % LANES
    if lanes.holding[i]:
        pose = lanes.pose[i]
        for k in range(3):
            pose[k] += action[k] * rules.move[k]
        aim(block, lane, pose[0], pose[1], pose[2])
        return
    flap = block.flap[lane]
    length, height, width = flap[LENGTH_M], flap[HEIGHT], flap[JAW_WIDTH]
    near, far = -length, -(0.5 + SLIVER) * width * (1 + 1e-6)
    unit = flap[MODULUS] * width * flap[DEPTH] if rules.by_force else height
    light, firm = rules.firmness[0], rules.firmness[1]
    lightest, most = grip_range(light, firm, length, height)
    along, strength = (action[0] + 1) / 2, (action[1] + 1) / 2
    firmness = unit * min(max(lightest * most**strength, lightest), firm)
    compression, force = (np.nan, firmness) if rules.by_force else (firmness, np.nan)
    take(lanes, rules, block, i, near + along * (far - near), compression, force)


@njit(**INSIDE)
def take(lanes, rules, block, i, x, compression, force):
    """Have environment i's jaws close at x by a compression, m, or until they press with a force, N, once its
    block advances; the other is nan."""
    lane = i % LANES
    height, pose = block.flap[lane, HEIGHT], lanes.pose[i]
    veins = lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    pose[0], pose[1], pose[2], pose[3] = x, height / 2, 0.0, height
    if math.isnan(force):
        lanes.grasp[i, 0], lanes.grasp[i, 1] = x, compression
        pose[3] = height - compression
        closed = (height - pose[3]) / height
        hold(block, lane, x, closed, veins[0], veins[1], veins[2], rules.laws, rules.held)
    else:
        lanes.grasp[i, 0], lanes.grasp[i, 1] = x, force
        hold_by_force(block, lane, x, force, veins[0], veins[1], veins[2], rules.laws, rules.held)
    aim(block, lane, x, height / 2, 0.0)
    find_keypoints(lanes, i, block.flap[lane, LENGTH_M], height)


@njit(**INSIDE)
def settle(lanes, rules, block, i, told):
    """What a step has led to in environment i, whose block has advanced, into its row of told."""
    lane = i % LANES
    lanes.steps[i] += 1
    exposure, clearance = lanes.exposure[i], lanes.clearance[i]
    most_strain, most_friction = lanes.most_strain[i], lanes.most_friction[i]
    diverged = not block.done[lane]
    code, in_view, broke = DIVERGED, False, False
    if not diverged:
        before = _broken_so_far(lanes, i)
        hold_on(lanes, block, i)
        code, in_view, broke = _judge(lanes, rules, i, before)
    lanes.broken[i], lanes.in_view[i] = code, in_view
    over = (code != GOES_ON) if rules.limits_end else in_view
    told.terminated[i] = over and not diverged
    told.truncated[i] = not told.terminated[i] and (diverged or lanes.steps[i] >= rules.steps)
    lanes.over[i] = told.terminated[i] or told.truncated[i]
    _reward(lanes, rules, i, exposure, clearance, most_strain, most_friction, in_view, broke)
    reward = 0.0
    for k in range(len(TERMS)):
        reward += lanes.terms[i, k]
    told.reward[i] = reward


@njit(**INSIDE)
def hold_on(lanes, block, i):
    """Take over what was measured of environment i after its jaws closed or moved."""
    lane = i % LANES
    out = block.measured[lane]
    lanes.holding[i] = True
    lanes.strain[i], lanes.clearance[i] = out[WORST], out[CLEARANCE]
    lanes.friction[i, 0], lanes.friction[i, 1] = out[FRICTION_1], out[FRICTION_2]
    lanes.most_strain[i] = max(lanes.most_strain[i], out[WORST])
    lanes.most_friction[i] = max(lanes.most_friction[i], max(out[FRICTION_1], out[FRICTION_2]))
    lanes.overlapped[i] = lanes.overlapped[i] or out[OVERLAP] > 0
    jaws_in(block, lane, lanes.jaws[i])
    sight, length = block.sight[lane], block.flap[lane, LENGTH_M]
    target = sight[TARGET_X]
    if out[HIGHEST] < sight[CAMERA_Y]:
        lanes.exposure[i] = exposed_beside(out[FIRST_HIT], out[LAST_HIT], target, -length)
    else:
        lower, upper = surfaces_of(block, lane)
        lanes.exposure[i] = exposed_above(lower, upper, sight[CAMERA_X], sight[CAMERA_Y], target, -length)


@njit(**INSIDE)
def _judge(lanes, rules, i, before):
    """Code of what has become of environment i, whether the target is in view, whether a limit broke now."""
    limits = lanes.limits[i]
    if rules.limits_end:
        friction = max(lanes.friction[i, 0], lanes.friction[i, 1])
        # overlap of this state alone; had there been one before, the episode were over
        found = verdict(lanes.strain[i], friction, lanes.clearance[i], limits, lanes.overlapped[i])
        failed = found != GOES_ON and found != OK
        return found, found == OK, failed
    in_view = lanes.clearance[i] >= limits[CLEARANCE_LIMIT]
    failure = _broken_so_far(lanes, i)
    return failure, in_view, failure != GOES_ON and before == GOES_ON


@njit(**INSIDE)
def _broken_so_far(lanes, i):
    return verdict(
        lanes.most_strain[i], lanes.most_friction[i], -np.inf, lanes.limits[i], lanes.overlapped[i]
    )


@njit(**INSIDE)
def _reward(lanes, rules, i, exposure, clearance, most_strain, most_friction, in_view, broke):
    """The weighted terms of environment i's reward; the arguments say how it stood before."""
    strain, friction, asked = (
        lanes.limits[i, STRAIN_LIMIT],
        lanes.limits[i, FRICTION_LIMIT],
        lanes.limits[i, 2],
    )
    outset, cap = lanes.outset[i], rules.cap
    margin = 1 - min(lanes.most_strain[i] / strain, 1.0)
    terms = lanes.terms[i]
    terms[0] = lanes.exposure[i] - exposure
    terms[1] = way(lanes.clearance[i], outset, asked) - way(clearance, outset, asked)
    terms[2] = min(lanes.most_strain[i] / strain, cap) - min(most_strain / strain, cap)
    terms[3] = min(lanes.most_friction[i] / friction, cap) - min(most_friction / friction, cap)
    terms[4] = 1 + margin if in_view else 0.0
    terms[5] = 1.0 if broke else 0.0
    for k in range(len(TERMS)):
        terms[k] = rules.weights[k] * terms[k] + 0.0  # no -0
