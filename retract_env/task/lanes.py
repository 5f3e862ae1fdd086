"""Episodes on rods side by side: what `Episode` and `RetractionTask` do for one flap, for a block's lanes.

Everything here is compiled, needs no Python while it runs, and treats a lane as if it were alone; `Lanes` and
`Rules` are in `retract_env.task.arrays`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retract_env import scenarios
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
    SPECIFIC_WEIGHT,
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
from retract_env.scene.pcg64 import uniform
from retract_env.spring.columns import columns
from retract_env.task.arrays import INSIDE
from retract_env.task.rules import (
    CLEARANCE_LIMIT,
    DIVERGED,
    FRICTION_LIMIT,
    GOES_ON,
    OK,
    RELEASE,
    STIFFNESS_SAMPLES,
    STRAIN_LIMIT,
    TERMS,
    exposed_above,
    exposed_beside,
    grip_range,
    rest_clearance,
    verdict,
    way,
)
from retract_env.task.shown import find_keypoints, lying, surfaces_of


@njit(**INSIDE)
def new_flap(lanes, rules, block, i):
    """Give environment i a random flap; False where its veins have no room."""
    lane = i % LANES
    scalars, flap, stated = lanes.scalars[i], block.flap[lane], lanes.stated[i]
    wanted, placed = draw_flap(
        lanes.rng[i], rules.ranges, scalars, lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    )
    flap[LENGTH_M] = stated[scenarios.LENGTH] = scalars[flaps.LENGTH]
    flap[DEPTH], block.sight[lane, CAMERA_Y] = scalars[flaps.DEPTH], scalars[flaps.CAMERA_Y]
    stated[scenarios.HEIGHT], stated[scenarios.MODULUS] = scalars[flaps.HEIGHT], scalars[flaps.MODULUS]
    stated[scenarios.CAMERA_X], stated[scenarios.TARGET_X] = scalars[flaps.CAMERA_X], scalars[flaps.TARGET_X]
    return wanted == placed


@njit(**INSIDE)
def turn_out(lanes, rules, block, i):
    """Have environment i's flap be what it turns out to be in this episode."""
    lane = i % LANES
    numbers, z, asked = lanes.numbers[i], lanes.z[i], lanes.asked[i]
    wanted = not math.isnan(asked[0])
    lanes.drawn[i] = wanted or rules.unknown
    if lanes.drawn[i]:
        for k in range(len(z)):
            z[k] = asked[k] if wanted else uniform(lanes.rng[i], -1.0, 1.0)
        scenarios.turn_out(lanes.stated[i], lanes.prior[i], z, numbers)
    else:
        numbers[:] = lanes.stated[i]
    flap, sight = block.flap[lane], block.sight[lane]
    flap[HEIGHT], flap[MODULUS] = numbers[scenarios.HEIGHT], numbers[scenarios.MODULUS]
    flap[POISSON], flap[JAW_WIDTH] = numbers[scenarios.POISSON], numbers[scenarios.JAW_WIDTH]
    flap[SPECIFIC_WEIGHT] = numbers[scenarios.DENSITY] * numbers[scenarios.GRAVITY]
    sight[CAMERA_X], sight[TARGET_X] = numbers[scenarios.CAMERA_X], numbers[scenarios.TARGET_X]
    lanes.limits[i, FRICTION_LIMIT] = numbers[scenarios.FRICTION]


@njit(**INSIDE)
def look(lanes, block, i):
    """What does not change in an episode of environment i: what is known of its flap and line of sight, and
    the clearance at rest."""
    flap, sight, stated = block.flap[i % LANES], block.sight[i % LANES], lanes.stated[i]
    length, height, modulus = (
        stated[scenarios.LENGTH],
        stated[scenarios.HEIGHT],
        stated[scenarios.MODULUS],
    )
    at = np.empty(STIFFNESS_SAMPLES)
    for k in range(STIFFNESS_SAMPLES):
        at[k] = -length * (1 - (k + 0.5) / STIFFNESS_SAMPLES)
    k_eq = lanes.k_eq[i]
    columns(length, height, modulus, lanes.vertices[i], lanes.offsets[i], lanes.moduli[i], at, k_eq)
    for k in range(STIFFNESS_SAMPLES):
        k_eq[k] = k_eq[k] * height / modulus
    camera_x, target_x = stated[scenarios.CAMERA_X], stated[scenarios.TARGET_X]
    dx, dy = camera_x - target_x, sight[CAMERA_Y]
    lanes.sight[i, 0] = target_x / length
    lanes.sight[i, 1] = math.atan2(dy, target_x - camera_x)
    lanes.sight[i, 2] = length / math.hypot(dx, dy)
    lanes.outset[i] = rest_clearance(length, flap[HEIGHT], sight[CAMERA_X], sight[CAMERA_Y], sight[TARGET_X])


@njit(**INSIDE)
def begin(lanes, rules, block, i):
    """Environment i at the outset of an episode; False where there is no room for a random flap's veins."""
    if lanes.random[i] and not new_flap(lanes, rules, block, i):
        return False
    turn_out(lanes, rules, block, i)
    look(lanes, block, i)
    flap, sight, stated = block.flap[i % LANES], block.sight[i % LANES], lanes.stated[i]
    length, height = flap[LENGTH_M], flap[HEIGHT]
    lanes.holding[i], lanes.missed[i], lanes.steps[i], lanes.over[i] = False, False, 0, False
    lanes.jaws[i, 0] = lanes.jaws[i, 2] = -length - stated[scenarios.JAW_WIDTH]
    lanes.jaws[i, 1], lanes.jaws[i, 3] = 0.0, stated[scenarios.HEIGHT]
    for k in range(3):
        lanes.off[i, k] = 0.0
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
    if lanes.missed[i]:
        return  # nothing is left to do
    if lanes.holding[i]:
        pose = lanes.pose[i]
        for k in range(3):
            pose[k] += action[k] * rules.move[k]
        aim(block, lane, pose[0], pose[1], pose[2])
        return
    stated = lanes.stated[i]
    length, height, width = (
        stated[scenarios.LENGTH],
        stated[scenarios.HEIGHT],
        stated[scenarios.JAW_WIDTH],
    )
    near, far = -length, -(0.5 + SLIVER) * width * (1 + 1e-6)
    unit = stated[scenarios.MODULUS] * width * block.flap[lane, DEPTH] if rules.by_force else height
    light, firm = rules.firmness[0], rules.firmness[1]
    lightest, most = grip_range(light, firm, length, height)
    along, strength = (action[0] + 1) / 2, (action[1] + 1) / 2
    firmness = unit * min(max(lightest * most**strength, lightest), firm)
    compression, force = (np.nan, firmness) if rules.by_force else (firmness, np.nan)
    take(lanes, rules, block, i, near + along * (far - near), compression, force)


@njit(**INSIDE)
def take(lanes, rules, block, i, x, compression, force):
    """Have environment i's jaws close at x by a compression, m, or until they press with a force, N, once its
    block advances; the other is nan. As it turns out, they may close elsewhere, otherwise, or on nothing."""
    lane, pose = i % LANES, lanes.pose[i]
    height, separation = block.flap[lane, HEIGHT], lanes.stated[i, scenarios.HEIGHT] - compression
    vertices, offsets, moduli = lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    if lanes.drawn[i]:
        numbers, found = lanes.numbers[i], np.empty(scenarios.CLOSED)
        stated, prior, z = lanes.stated[i, scenarios.HEIGHT], lanes.prior[i], lanes.z[i]
        if not scenarios.close_on(stated, numbers, prior, z, x, separation, force, found):
            lanes.missed[i] = True
            return
        x, separation, force = found[scenarios.X], found[scenarios.SEPARATION], found[scenarios.HOLDS_BY]
        lanes.off[i] = found[scenarios.OFF_X :]
        vertices, moduli = vertices.copy(), moduli * numbers[scenarios.STIFFER]
        for k in range(len(vertices)):
            vertices[k, 1] *= numbers[scenarios.THICKER]
    pose[0], pose[1], pose[2], pose[3] = x, height / 2, 0.0, height
    lanes.grasp[i, 0] = x
    if math.isnan(force):
        lanes.grasp[i, 1] = height - separation
        pose[3] = separation
        closed = (height - separation) / height
        hold(block, lane, x, closed, vertices, offsets, moduli, rules.laws, rules.held)
    else:
        lanes.grasp[i, 1] = force
        hold_by_force(block, lane, x, force, vertices, offsets, moduli, rules.laws, rules.held)
    aim(block, lane, x, height / 2, 0.0)
    find_keypoints(lanes, i, block.flap[lane, LENGTH_M], height)


@njit(**INSIDE)
def settle(lanes, rules, block, i, told):
    """What a step has led to in environment i, whose block has advanced, into its row of told."""
    lane = i % LANES
    lanes.steps[i] += 1
    exposure, clearance = lanes.exposure[i], lanes.clearance[i]
    most_strain, most_friction = lanes.most_strain[i], lanes.most_friction[i]
    missed = lanes.missed[i]
    diverged = not missed and not block.done[lane]
    code, in_view, broke = DIVERGED, False, False
    if missed:
        let_go(lanes, i)
        code, broke = RELEASE, True
    elif not diverged:
        before = _broken_so_far(lanes, i)
        hold_on(lanes, block, i)
        code, in_view, broke = _judge(lanes, rules, i, before)
    lanes.broken[i], lanes.in_view[i] = code, in_view
    over = (code != GOES_ON) if rules.limits_end or missed else in_view
    told.terminated[i] = over and not diverged
    told.truncated[i] = not told.terminated[i] and (diverged or lanes.steps[i] >= rules.steps)
    lanes.over[i] = told.terminated[i] or told.truncated[i]
    _reward(lanes, rules, i, exposure, clearance, most_strain, most_friction, in_view, broke)
    reward = 0.0
    for k in range(len(TERMS)):
        reward += lanes.terms[i, k]
    told.reward[i] = reward


@njit(**INSIDE)
def let_go(lanes, i):
    """What it comes to that environment i's jaws have not closed on the flap: they would have to pull."""
    lanes.friction[i, 0] = lanes.friction[i, 1] = lanes.most_friction[i] = np.inf


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
