"""Episodes on rods side by side: what `Episode` and `RetractionTask` do for one flap, for all lanes of a block.

`Lanes` has an environment a row, n of them, whatever block they are in: environment i is lane i % LANES of block
i // LANES. Everything here is compiled, needs no Python while it runs, and treats a lane as if it were alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.mesh.jaws import SLIVER
from retract_env.rod.block import aim, hold, jaws_in
from retract_env.rod.chain import LANES
from retract_env.rod.flap import (
    DEPTH,
    FREE,
    HEIGHT,
    INNER,
    JAW_WIDTH,
    LENGTH_M,
    MODULUS,
    POISSON,
    SHORTEST,
)
from retract_env.rod.measures import (
    CAMERA_X,
    CAMERA_Y,
    CLEARANCE,
    COLUMNS,
    FRICTION_1,
    FRICTION_2,
    OVERLAP,
    TARGET_X,
    WORST,
)
from retract_env.scene import flaps
from retract_env.scene.flaps import draw_flap
from retract_env.scene.ziggurat import standard_normal
from retract_env.spring.columns import columns
from retract_env.task.rules import (
    DIVERGED,
    FRICTION_LIMIT,
    GOES_ON,
    OK,
    STIFFNESS_SAMPLES,
    STRAIN_LIMIT,
    CLEARANCE_LIMIT,
    TERMS,
    exposed,
    observe,
    rest_clearance,
    verdict,
    way,
)

Array = NDArray[np.float64]

INSIDE = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""How functions are compiled that only compiled code calls: half of the time went into ways to call them."""


class Rules(NamedTuple):
    """How the task is configured, for all environments alike."""

    weights: Array
    """(6,) of TERMS"""
    move: Array
    """(3,) m, m, rad"""
    compression: Array
    """(2,) least and greatest, over the height"""
    steps: int
    cap: float
    limits_end: bool
    """whether a broken limit ends the episode"""
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    """(SIZE,) bounds of the observation"""
    noise: Array
    """(SIZE,) deviation of the sensors; (0,) where they are exact"""
    hidden: NDArray[np.bool_]
    """(SIZE,) what is observed as 0"""
    ranges: Array
    """(10, 2) of random flaps"""
    poisson: float
    """of random flaps"""
    laws: Array
    held: Array
    """of the rod's grip"""


class Lanes(NamedTuple):
    """Where n environments stand; rows of arrays."""

    rng: NDArray[np.uint64]
    """(n, 6) their generators"""
    random: NDArray[np.bool_]
    """(n,) whether each episode has a new flap"""
    scalars: Array
    vertices: Array
    offsets: NDArray[np.int64]
    moduli: Array
    """of the flaps, as `retract_env.scene.flaps` has them"""
    given: Array
    """(n, 2) m, grasp that an episode begins on; nan where the first action chooses it"""
    limits: Array
    """(n, 3)"""
    k_eq: Array
    """(n, STIFFNESS_SAMPLES) modulus / height"""
    sight: Array
    """(n, 3) as observed"""
    outset: Array
    """(n,) m, clearance at rest"""
    holding: NDArray[np.bool_]
    steps: NDArray[np.int64]
    pose: Array
    """(n, 4) that the jaws were sent to: x, y, theta, separation"""
    jaws: Array
    """(n, 4) m"""
    grasp: Array
    """(n, 2) m, where they grasp and by how much they close"""
    strain: Array
    friction: Array
    """(n,), (n, 2) now"""
    clearance: Array
    exposure: Array
    most_strain: Array
    most_friction: Array
    overlapped: NDArray[np.bool_]
    broken: NDArray[np.int64]
    """(n,) what the last step led to, a code of `rules`"""
    in_view: NDArray[np.bool_]
    over: NDArray[np.bool_]
    terms: Array
    """(n, 6) of the last reward, weighted"""


class Told(NamedTuple):
    """What a step answers with, rows of n."""

    observation: NDArray[np.float32]
    reward: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: Array
    """(n, INFO)"""
    last_observation: NDArray[np.float32]
    last_info: Array
    """of episodes that ended in this step, where a new one began in the same"""
    renewed: NDArray[np.bool_]
    """whether the row is of a new episode"""
    failed: NDArray[np.bool_]
    """whether an episode could not begin: no room for the veins, or a grasp that cannot be closed"""


# What is told besides, as a row of numbers
SUCCESS, FAILURE, COST, COST_STRAIN, COST_FRICTION, MOST_STRAIN, MOST_FRICTION, TO_LINE, EXPOSURE = range(9)
REWARD_TERMS = 9
INFO = REWARD_TERMS + len(TERMS)


@njit(**INSIDE)
def new_flap(lanes, rules, block, i):
    """Give environment i a random flap; False where its veins have no room."""
    lane = i % LANES
    scalars, flap, sight = lanes.scalars[i], block.flap[lane], block.sight[lane]
    wanted, placed = draw_flap(
        lanes.rng[i], rules.ranges, scalars, lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    )
    flap[LENGTH_M], flap[HEIGHT], flap[DEPTH] = scalars[flaps.LENGTH], scalars[flaps.HEIGHT], scalars[flaps.DEPTH]
    flap[MODULUS], flap[POISSON] = scalars[flaps.MODULUS], rules.poisson
    sight[CAMERA_X], sight[CAMERA_Y] = scalars[flaps.CAMERA_X], scalars[flaps.CAMERA_Y]
    sight[TARGET_X] = scalars[flaps.TARGET_X]
    look(lanes, block, i)
    return wanted == placed


@njit(**INSIDE)
def look(lanes, block, i):
    """What does not change while environment i has this flap and line of sight."""
    flap, sight, lane = block.flap[i % LANES], block.sight[i % LANES], i % LANES
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
    _, lower, upper = _at_rest(length, height)
    lanes.exposure[i] = exposed(lower, upper, sight[CAMERA_X], sight[CAMERA_Y], sight[TARGET_X], -length)
    return True


@njit(**INSIDE)
def _at_rest(length, height):
    """Places along the flap and both surfaces there, before it is touched."""
    at, lower, upper = np.empty(3), np.empty((3, 2)), np.empty((3, 2))
    at[0], at[1], at[2] = -length, -length / 2, 0.0
    for k in range(3):
        lower[k, 0] = upper[k, 0] = at[k]
        lower[k, 1], upper[k, 1] = 0.0, height
    return at, lower, upper


@njit(**INSIDE)
def act(lanes, rules, block, i, action):
    """Have environment i's jaws close or move as an action (3,) within [-1, 1] says, once its block advances."""
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
    light, firm = rules.compression[0] * height, rules.compression[1] * height
    along, strength = (action[0] + 1) / 2, (action[1] + 1) / 2
    compression = min(max(light * (firm / light) ** strength, light), firm)
    take(lanes, rules, block, i, near + along * (far - near), compression)


@njit(**INSIDE)
def take(lanes, rules, block, i, x, compression):
    """Have environment i's jaws close at x by a compression, m, once its block advances."""
    lane = i % LANES
    height, pose = block.flap[lane, HEIGHT], lanes.pose[i]
    veins = lanes.vertices[i], lanes.offsets[i], lanes.moduli[i]
    lanes.grasp[i, 0], lanes.grasp[i, 1] = x, compression
    pose[0], pose[1], pose[2], pose[3] = x, height / 2, 0.0, height - compression
    closed = (height - pose[3]) / height
    hold(block, lane, x, closed, veins[0], veins[1], veins[2], rules.laws, rules.held)
    aim(block, lane, x, height / 2, 0.0)


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
    observe_now(lanes, rules, block, i, told.observation[i])


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
    lower, upper = _surfaces(block, lane)
    lanes.exposure[i] = exposed(lower, upper, sight[CAMERA_X], sight[CAMERA_Y], sight[TARGET_X], -length)


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
    strain, friction, asked = lanes.limits[i, STRAIN_LIMIT], lanes.limits[i, FRICTION_LIMIT], lanes.limits[i, 2]
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


@njit(**INSIDE)
def _surfaces(block, lane):
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
def observe_now(lanes, rules, block, i, out):
    """Environment i observed into out."""
    lane = i % LANES
    length, height = block.flap[lane, LENGTH_M], block.flap[lane, HEIGHT]
    if not lanes.holding[i]:
        at, lower, upper = _at_rest(length, height)
        _observe(lanes, rules, block, i, at, lower, upper, out)
        return
    x = lanes.grasp[i, 0]
    left = min(-length, x - SHORTEST * height)
    at = np.empty(COLUMNS)
    for k in range(2 * FREE):
        at[k] = left + (x - left) * (k / (2 * FREE))
    for k in range(2 * INNER + 1):
        at[2 * FREE + k] = x * (1 - k / (2 * INNER))
    lower, upper = _surfaces(block, lane)
    _observe(lanes, rules, block, i, at, lower, upper, out)


@njit(**INSIDE)
def _observe(lanes, rules, block, i, at, lower, upper, out):
    flap = block.flap[i % LANES]
    observe(
        lanes.holding[i],
        1 - lanes.steps[i] / rules.steps,
        lanes.jaws[i],
        flap[LENGTH_M],
        flap[HEIGHT],
        at,
        lower,
        at,
        upper,
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


