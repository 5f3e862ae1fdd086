"""What a batch of environments is made of: rows of arrays, and the numbers that are alike for all.

`Lanes` has an environment a row, n of them, whatever block of rods they are in: environment i is lane
i % LANES of block i // LANES.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from retract_env.scene import UNKNOWNS
from retract_env.task.rules import TERMS

Array = NDArray[np.float64]

INSIDE = {"error_model": "numpy", "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""How functions are compiled that only compiled code calls: half of the time went into ways to call them."""


class Rules(NamedTuple):
    """How the task is configured, for all environments alike."""

    weights: Array
    """(6,) of TERMS"""
    move: Array
    """(3,) m, m, rad"""
    by_force: bool
    """whether the jaws hold by force, not by compression"""
    firmness: Array
    """(2,) least and greatest force, over E w d, or compression, over the height"""
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
    laws: Array
    held: Array
    """of the rod's grip"""
    unknown: bool
    """whether each episode is a draw of what is not known"""


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
    stated: Array
    numbers: Array
    """(n, NUMBERS) of `retract_env.scenarios`: of the scene as it is stated, and as it turns out"""
    prior: Array
    """(n, PRIOR) of `retract_env.scenarios`"""
    asked: Array
    """(n, UNKNOWNS) the draw of the next episode; nan where none is asked for"""
    drawn: NDArray[np.bool_]
    z: Array
    """(n,) whether the episode is a draw, and (n, UNKNOWNS) which one"""
    given: Array
    """(n, 3) m, m, N: x, and compression or force, of the grasp that an episode begins on; the other is nan,
    and all are where the first action chooses it"""
    limits: Array
    """(n, 3) as they turn out"""
    k_eq: Array
    """(n, STIFFNESS_SAMPLES) modulus / height"""
    sight: Array
    """(n, 3) as observed"""
    outset: Array
    """(n,) m, clearance at rest"""
    holding: NDArray[np.bool_]
    missed: NDArray[np.bool_]
    """(n,) whether the jaws have closed, and whether they were closed without closing on the flap"""
    off: Array
    """(n, 3) m, as `Situation` has it"""
    steps: NDArray[np.int64]
    pose: Array
    """(n, 4) that the jaws were sent to: x, y, theta, separation"""
    jaws: Array
    """(n, 4) m, where they are"""
    grasp: Array
    """(n, 2) m, where they grasp, and m or N, by how much they close or how hard they press"""
    section: NDArray[np.int64]
    share: Array
    """(n, KEYPOINTS) before which section of the rod a keypoint is, and how far on to the next"""
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
IS_DRAWN = REWARD_TERMS + len(TERMS)
DRAW = IS_DRAWN + 1
INFO = DRAW + len(UNKNOWNS)
