"""Many retractions side by side on rods: what planners search with, and what judges a plan on many flaps.

Each retraction has a flap, a grasp and poses of its own; the veins' outlines are those of one flap, with
factors on their height and their moduli. Compiled, and shared among threads.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.rod.block import advance_blocks, aim, borrowed, hold, hold_by_force, new_blocks
from retract_env.rod.chain import LANES
from retract_env.rod.grip import COMPRESSION
from retract_env.rod.measures import CLEARANCE, DRAG_1, NORMAL_1, OVERLAP, WORST
from retract_env.rod.press import remade

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STRAIN, CLEAR, TOUCHES, NORMAL, DRAG = 0, 1, 2, slice(3, 5), slice(5, 7)
FELT = 7
"""Numbers told of each pose: eps_1%, clearance, m, whether tissue is where something else is, and with what
both jaws press and what they drag along the flap, E h d."""


class Retractions(NamedTuple):
    """n retractions of t poses at most."""

    flap: Array
    """(n, NUMBERS) of `flap`"""
    sight: Array
    """(n, SIGHT) of `measures`"""
    vertices: Array
    """(v, 2) m, as `retract_env.spring.columns` has them"""
    offsets: Indices
    moduli: Array
    """Pa"""
    veins: Array
    """(n, 2) factors on the vertices' y and on the moduli"""
    x: Array
    """(n,) m, of the grasps"""
    poses: Array
    """(n, t, 4) x, y, m, theta, compression over the height: the jaws closed, then the motion"""
    force: Array
    """(n,) N, with which the jaws press, whatever their compression; 0: they close by the compression; below:
    they do not hold the flap, which is lost"""
    goal: Array
    """(n,) m, the clearance with which a retraction is over; inf: it goes on to its last pose"""


class Followed(NamedTuple):
    """What came of them."""

    felt: Array
    """(n, t, FELT), nan from `reached` on"""
    reached: Indices
    """(n,) poses reached: the last one is the one that met the goal, or that before no equilibrium was found,
    or the path's last"""
    lost: NDArray[np.bool_]
    """(n,) whether no equilibrium was found"""


def follow(retractions: Retractions, laws: Array, held: Array, threads: int) -> Followed:
    """Follow all of them, on so many threads. What comes of one depends on no other, to the last bit.

    laws, held: of `grip.load`.
    """
    n, t = retractions.poses.shape[:2]
    felt = np.full((n, t, FELT), np.nan)
    count, lost = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    groups = -(-n // LANES)
    threads = max(1, min(threads, groups))
    ends = [groups * k // threads for k in range(threads + 1)]

    def work(k: int) -> None:
        _follow(new_blocks(1), retractions, laws, held, felt, count, lost, ends[k], ends[k + 1])

    if threads == 1:
        work(0)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, range(threads)))
    return Followed(felt, count, lost)


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(blocks, given, laws, held, felt, count, lost, first, last):
    """Groups first to last, exclusive, of LANES retractions each, in the one block of blocks."""
    n, t = given.poses.shape[0], given.poses.shape[1]
    block = borrowed(blocks, 0)
    vertices = np.empty((LANES, *given.vertices.shape))
    moduli = np.empty((LANES, len(given.moduli)))
    moving = np.empty(LANES, np.bool_)
    for group in range(first, last):
        begin = group * LANES
        many = min(LANES, n - begin)
        moving[:] = False
        for lane in range(many):
            i = begin + lane
            if given.force[i] < 0.0:
                lost[i] = True
                continue
            block.flap[lane], block.sight[lane] = given.flap[i], given.sight[i]
            for v in range(given.vertices.shape[0]):
                vertices[lane, v, 0] = given.vertices[v, 0]
                vertices[lane, v, 1] = given.vertices[v, 1] * given.veins[i, 0]
            moduli[lane] = given.moduli * given.veins[i, 1]
            x, c, force = given.x[i], given.poses[i, 0, 3], given.force[i]
            if force > 0.0:
                hold_by_force(block, lane, x, force, vertices[lane], given.offsets, moduli[lane], laws, held)
            else:
                hold(block, lane, x, c, vertices[lane], given.offsets, moduli[lane], laws, held)
            moving[lane] = True
        for k in range(t):
            waiting = False
            for lane in range(many):
                if moving[lane]:
                    i = begin + lane
                    x, y, theta, c = given.poses[i, k]
                    if k > 0 and given.force[i] == 0.0 and c != given.poses[i, k - 1, 3]:
                        block.grip[lane, COMPRESSION] = c
                        remade(block.flap[lane], block.grip[lane], held, block.free, block.inner, lane)
                    aim(block, lane, x, y, theta)
                    waiting = True
            if not waiting:
                break
            advance_blocks(blocks, held, 0, 1)
            for lane in range(many):
                if moving[lane]:
                    i = begin + lane
                    if not block.done[lane]:
                        lost[i], moving[lane] = True, False
                        continue
                    out = block.measured[lane]
                    felt[i, k, STRAIN] = out[WORST]
                    felt[i, k, CLEAR], felt[i, k, TOUCHES] = out[CLEARANCE], out[OVERLAP]
                    for jaw in range(2):
                        felt[i, k, 3 + jaw] = out[NORMAL_1 + jaw]
                        felt[i, k, 5 + jaw] = out[DRAG_1 + jaw]
                    count[i] = k + 1
                    moving[lane] = out[CLEARANCE] < given.goal[i]
