"""LANES flaps side by side, each between jaws of its own: what environments and planners step.

A block is a tuple of arrays, so that compiled code takes it as it is. `hold` puts a flap into a lane, `close`
and `aim` say what its jaws do next, `advance` moves the jaws of all lanes and measures what has become of the
flaps. Jaws may hold by force instead: after `hold_by_force`, or `press` in place of `close`, every `advance`
finds the compression at which they press so (`block.grip[lane, COMPRESSION]`); where there is none, the lane
is not done.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.rod.chain import LANES, SCRATCH
from retract_env.rod.flap import (
    DEPTH,
    FACTORS,
    FREE,
    FREE_PARAMETERS,
    FREE_UNKNOWNS,
    HEIGHT,
    INNER,
    INNER_PARAMETERS,
    INNER_UNKNOWNS,
    JAW_WIDTH,
    MODULUS,
    NUMBERS,
    build,
    lay_flat,
    move,
)
from retract_env.rod.grip import COMPRESSION, FORCE, GRIP, MADE_FOR, PUSH, grip, pushed_out, root_of
from retract_env.rod.measures import (
    CLEARANCE,
    COLUMNS,
    IN_SIGHT,
    MEASURED,
    SIGHT,
    measure,
    surfaces,
    tool_clearance,
    worst_strain,
)
from retract_env.rod.outline import outlines
from retract_env.rod.press import CLOSE_ENOUGH, PASSES, find_compression, first_compression, remade

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSE = 4
"""x, y, theta, and how far the tissue between the jaws pushes both parts away."""


class Block(NamedTuple):
    """Arrays of LANES flaps; rows of them where a comment gives no shape."""

    flap: Array
    """(LANES, NUMBERS) what each flap is"""
    sight: Array
    """(LANES, SIGHT) where one looks from"""
    free: Array
    inner: Array
    free_u: Array
    inner_u: Array
    here: Array
    """of the jaws, POSE rows"""
    goal: Array
    grip: Array
    """(LANES, GRIP)"""
    loads: Array
    rod_strain: Array
    points: Array
    measured: Array
    """(LANES, MEASURED)"""
    todo: Flags
    """(LANES,) which lanes' jaws are to move"""
    done: Flags
    """(LANES,) which did"""
    scratch: Array
    factors: Array
    work: Array


STATE = ("flap", "sight", "free", "inner", "free_u", "inner_u", "here", "grip", "loads", "points", "measured")
"""What a block has to keep to go on as it would have gone on."""


def state_of(block: Block, lane: int) -> dict[str, Array]:
    """Copies of all that a lane goes on from."""
    return {name: _lane(getattr(block, name), lane).copy() for name in STATE}


def set_state(block: Block, lane: int, state: Mapping[str, Array]) -> None:
    """Have a lane go on from there."""
    for name in STATE:
        _lane(getattr(block, name), lane)[...] = state[name]


def _lane(array: Array, lane: int) -> Array:
    return array[lane] if array.ndim == 2 else array.reshape(-1, LANES)[:, lane]


def new_block() -> Block:
    """A block without flaps."""

    def rows(count: int) -> Array:
        return np.zeros(count * LANES)

    return Block(
        np.zeros((LANES, NUMBERS)),
        np.zeros((LANES, SIGHT)),
        rows(FREE_PARAMETERS),
        rows(INNER_PARAMETERS),
        rows(FREE_UNKNOWNS),
        rows(INNER_UNKNOWNS),
        rows(POSE),
        rows(POSE),
        np.zeros((LANES, GRIP)),
        rows(6),
        rows(1),
        rows(4 * COLUMNS),
        np.zeros((LANES, MEASURED)),
        np.zeros(LANES, np.bool_),
        np.zeros(LANES, np.bool_),
        rows(SCRATCH),
        rows(FACTORS),
        rows(4 + 4 * (FREE + INNER)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def close(block, lane, x, compression, vertices, offsets, moduli, held):
    """Have the jaws of a lane, which grasp at x, m, closed by a compression, over the height, from the next
    move on. held: of `grip.load`."""
    kept = block.grip[lane]
    kept[COMPRESSION] = kept[MADE_FOR] = compression
    kept[FORCE] = 0.0
    kept[PUSH] = pushed_out(block.flap[lane], kept, compression, held)
    root = root_of(compression, held)
    build(block.flap[lane], vertices, offsets, moduli, x, root, block.free, block.inner, lane)


@njit(cache=True, nogil=True, error_model="numpy")
def press(block, lane, x, force, vertices, offsets, moduli, held):
    """Have the jaws of a lane, which grasp at x, m, press with a force, N, from the next move on."""
    flap = block.flap[lane]
    force = force / (flap[MODULUS] * flap[HEIGHT] * flap[DEPTH])
    c = first_compression(block.grip[lane], held, force)
    close(block, lane, x, c, vertices, offsets, moduli, held)
    block.grip[lane, FORCE] = force


@njit(cache=True, nogil=True, error_model="numpy")
def hold(block, lane, x, compression, vertices, offsets, moduli, laws, held):
    """Let the flap of a lane lie flat between jaws at x, m, that close by a compression, over the height,
    with the next move.

    vertices, offsets, moduli: of its veins, see `retract_env.spring.columns`; laws, held: of `grip.load`.
    """
    grip(block.flap[lane], vertices, offsets, moduli, x, laws, block.grip[lane])
    close(block, lane, x, compression, vertices, offsets, moduli, held)
    _lie(block, lane, x)


@njit(cache=True, nogil=True, error_model="numpy")
def hold_by_force(block, lane, x, force, vertices, offsets, moduli, laws, held):
    """`hold` between jaws that press with a force, N, from the next move on."""
    grip(block.flap[lane], vertices, offsets, moduli, x, laws, block.grip[lane])
    press(block, lane, x, force, vertices, offsets, moduli, held)
    _lie(block, lane, x)


@njit(error_model="numpy")
def _lie(block, lane, x):
    flap = block.flap[lane]
    lay_flat(block.free, block.free_u, FREE, x / flap[HEIGHT], lane)
    lay_flat(block.inner, block.inner_u, INNER, 0.0, lane)
    block.here[lane], block.here[LANES + lane] = x / flap[HEIGHT], 0.5
    block.here[2 * LANES + lane] = block.here[3 * LANES + lane] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def aim(block, lane, x, y, theta):
    """Have the jaws of a lane move to x, y, m, and theta, rad, next."""
    height = block.flap[lane, HEIGHT]
    block.goal[lane], block.goal[LANES + lane] = x / height, y / height
    block.goal[2 * LANES + lane] = theta
    block.goal[3 * LANES + lane] = block.grip[lane, PUSH]
    block.todo[lane] = True


@njit(error_model="numpy")
def _remembered(block, forced):
    """What a lane whose force cannot be met goes back to; nothing where none holds by force."""
    if not forced:
        none = np.empty(0)
        return none, none, none, none, none, np.empty((0, 0))
    return (
        block.free.copy(),
        block.inner.copy(),
        block.free_u.copy(),
        block.inner_u.copy(),
        block.here.copy(),
        block.grip.copy(),
    )


@njit(error_model="numpy")
def _again(block, held, before, reached, last):
    """After a move, let lanes that hold by force find their compression; whether some have to move again, to
    what follows from it. Those are then in `todo`, all others that got there in `reached`, and in `done` once
    none is left, or this was the last time."""
    waiting = False
    for lane in range(LANES):
        moved, block.todo[lane] = block.todo[lane], False
        if not moved:
            continue
        kept = block.grip[lane]
        if kept[FORCE] <= 0.0:
            reached[lane] = block.done[lane]
            continue
        found = block.done[lane] and find_compression(block.here, block.loads, kept, held, lane)
        if found and abs(kept[COMPRESSION] - kept[MADE_FOR]) <= CLOSE_ENOUGH:
            reached[lane] = True
        elif found and not last:
            remade(block.flap[lane], kept, held, block.free, block.inner, lane)
            block.goal[3 * LANES + lane] = kept[PUSH]
            block.todo[lane] = waiting = True
        else:
            _take_back(block.free, before[0], lane)
            _take_back(block.inner, before[1], lane)
            _take_back(block.free_u, before[2], lane)
            _take_back(block.inner_u, before[3], lane)
            _take_back(block.here, before[4], lane)
            kept[:] = before[5][lane]
    if not waiting:
        block.done[:] = reached
    return waiting


@njit(error_model="numpy")
def _take_back(array, before, lane):
    for r in range(lane, len(array), LANES):
        array[r] = before[r]


@njit(inline="always", error_model="numpy")
def advance(block, held):
    """Move the jaws of all lanes in `todo` to where they are to go, and measure what has become of the flaps.

    `done` says which got there; the others, and lanes not in `todo`, stay as they are, measures too.
    """
    forced = False
    for lane in range(LANES):
        forced = forced or (block.todo[lane] and block.grip[lane, FORCE] > 0.0)
    before, reached = _remembered(block, forced), np.zeros(LANES, np.bool_)
    for passes in range(PASSES):
        move(
            block.free,
            block.inner,
            block.free_u,
            block.inner_u,
            block.here,
            block.goal,
            block.todo,
            block.scratch,
            block.factors,
            block.loads,
            block.done,
        )
        if not forced or not _again(block, held, before, reached, passes + 1 == PASSES):
            break
    for lane in range(LANES):
        block.rod_strain[lane] = block.grip[lane, COMPRESSION]
    surfaces(block.free_u, block.inner_u, block.rod_strain, block.points)
    worst_strain(block.free, block.inner, block.free_u, block.inner_u, block.work, block.rod_strain)
    outlines(block.points, block.flap, block.sight, block.done, block.measured)
    jaws = np.empty(4)
    for lane in range(LANES):
        block.todo[lane] = False
        if block.done[lane]:
            flap, sight, out = block.flap[lane], block.sight[lane], block.measured[lane]
            measure(block.here, block.loads, block.grip[lane], held, block.rod_strain, lane, out)
            if sight[IN_SIGHT] > 0.0:
                jaws_in(block, lane, jaws)
                out[CLEARANCE] = min(out[CLEARANCE], tool_clearance(jaws, flap[JAW_WIDTH], sight))


@njit(cache=True, nogil=True, error_model="numpy")
def jaws_in(block, lane, out):
    """Lower and upper jaw of a lane, x1, y1, x2, y2, m, into out (4,)."""
    height = block.flap[lane, HEIGHT]
    x, y, theta = block.here[lane] * height, block.here[LANES + lane] * height, block.here[2 * LANES + lane]
    half = (1.0 - block.grip[lane, COMPRESSION]) * height / 2
    dx, dy = -math.sin(theta) * half, math.cos(theta) * half
    out[0], out[1], out[2], out[3] = x - dx, y - dy, x + dx, y + dy


@njit(error_model="numpy")
def _of(blocks, b, scratch, factors, work, rod_strain):
    """Block b of blocks, whose arrays have one more dimension in front, with the caller's scratch arrays."""
    return Block(
        blocks.flap[b],
        blocks.sight[b],
        blocks.free[b],
        blocks.inner[b],
        blocks.free_u[b],
        blocks.inner_u[b],
        blocks.here[b],
        blocks.goal[b],
        blocks.grip[b],
        blocks.loads[b],
        rod_strain,
        blocks.points[b],
        blocks.measured[b],
        blocks.todo[b],
        blocks.done[b],
        scratch,
        factors,
        work,
    )


@njit(error_model="numpy")
def borrowed(blocks, b):
    """Block b without scratch arrays, for what computes no equilibrium."""
    none = np.empty(0)
    return _of(blocks, b, none, none, none, none)


@njit(cache=True, nogil=True, error_model="numpy")
def advance_blocks(blocks, held, first, last):
    """`advance` blocks first to last, exclusive, where any lane is to move."""
    scratch, factors = np.empty(SCRATCH * LANES), np.empty(FACTORS * LANES)
    work, rod_strain = np.empty((4 + 4 * (FREE + INNER)) * LANES), np.empty(LANES)
    for b in range(first, last):
        waiting = False
        for l in range(LANES):
            waiting = waiting or blocks.todo[b, l]
        if waiting:
            advance(_of(blocks, b, scratch, factors, work, rod_strain), held)


def new_blocks(count: int) -> Block:
    """So many blocks without flaps: every array has one more dimension in front."""
    many: tuple[Any, ...] = tuple(np.repeat(array[None], count, axis=0) for array in new_block())
    return Block(*many)


def block_of(blocks: Block, b: int) -> Block:
    """Block b, a view."""
    return Block(*(array[b] for array in blocks))
