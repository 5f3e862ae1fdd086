"""One step of many environments on rods, in rounds: each is compiled code that a thread runs on its blocks.

In rounds, so that nothing that takes long to compile is compiled into two of them. They all take the same
arguments first, whether they need them or not.
"""

from __future__ import annotations

import math

from numba import njit

from retract_env.rod.block import advance_blocks, borrowed
from retract_env.rod.chain import LANES
from retract_env.task.lanes import act, begin, hold_on, let_go, settle, take
from retract_env.task.shown import observe_now, tell

NEXT_STEP, SAME_STEP, DISABLED = range(3)
"""When an episode that is over is followed by a new one, as Gymnasium has it."""


@njit(cache=True, nogil=True, error_model="numpy")
def act_range(blocks, lanes, rules, told, first, last, actions, modes):
    """Say what the jaws do in blocks first to last, exclusive; actions (n, 3) within [-1, 1].

    modes (n,): when an episode that is over is followed by a new one; those that are now are noted in told.
    """
    for b in range(first, last):
        block = borrowed(blocks, b)
        for i in range(b * LANES, min((b + 1) * LANES, len(lanes.steps))):
            told.renewed[i] = modes[i] == NEXT_STEP and lanes.over[i]
            if told.renewed[i]:
                told.reward[i], told.terminated[i], told.truncated[i] = 0.0, False, False
            else:
                act(lanes, rules, block, i, actions[i])


def advance_range(blocks, lanes, rules, told, first, last):  # noqa: ARG001, as all rounds
    """Move the jaws in blocks first to last, exclusive, that are to move."""
    advance_blocks(blocks, rules.held, first, last)


@njit(cache=True, nogil=True, error_model="numpy")
def settle_range(blocks, lanes, rules, told, first, last, fresh):
    """What the step has led to in blocks first to last, exclusive; with fresh, what closing a given grasp has
    led to in new episodes."""
    for b in range(first, last):
        block = borrowed(blocks, b)
        for i in range(b * LANES, min((b + 1) * LANES, len(lanes.steps))):
            if not fresh and not told.renewed[i]:
                settle(lanes, rules, block, i, told)
            elif fresh and told.renewed[i] and not math.isnan(lanes.given[i, 0]) and not told.failed[i]:
                if lanes.missed[i]:
                    let_go(lanes, i)
                    continue
                told.failed[i] = not block.done[i % LANES]
                if block.done[i % LANES]:
                    hold_on(lanes, block, i)


@njit(cache=True, nogil=True, error_model="numpy")
def show_range(blocks, lanes, rules, told, first, last, wanted, modes):
    """Observe environments in blocks first to last, exclusive, where wanted (n,), and tell of them.

    Of those whose episode is over and followed by another in the same step, the row is kept as the last one.
    """
    for b in range(first, last):
        block = borrowed(blocks, b)
        for i in range(b * LANES, min((b + 1) * LANES, len(lanes.steps))):
            if wanted[i]:
                observe_now(lanes, rules, block, i, told.observation[i])
                tell(lanes, rules, i, told.info[i])
                if modes[i] == SAME_STEP and lanes.over[i]:
                    told.renewed[i] = True
                    told.last_observation[i] = told.observation[i]
                    told.last_info[i] = told.info[i]


@njit(cache=True, nogil=True, error_model="numpy")
def begin_range(blocks, lanes, rules, told, first, last):
    """New episodes in blocks first to last, exclusive, where told.renewed."""
    for b in range(first, last):
        block = borrowed(blocks, b)
        for i in range(b * LANES, min((b + 1) * LANES, len(lanes.steps))):
            if told.renewed[i]:
                told.failed[i] = not begin(lanes, rules, block, i)


@njit(cache=True, nogil=True, error_model="numpy")
def take_range(blocks, lanes, rules, told, first, last):
    """Have given grasps close in new episodes in blocks first to last, exclusive."""
    for b in range(first, last):
        block = borrowed(blocks, b)
        for i in range(b * LANES, min((b + 1) * LANES, len(lanes.steps))):
            if told.renewed[i] and not told.failed[i] and not math.isnan(lanes.given[i, 0]):
                given = lanes.given[i]
                take(lanes, rules, block, i, given[0], given[1], given[2])
