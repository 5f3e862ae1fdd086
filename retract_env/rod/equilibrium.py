"""Chains brought into stable equilibrium: Newton's method, then with a line search, or not at all.

Lanes are as in `retract_env.rod.chain`: what happens in one changes no bit in another, and lanes that are
done stay as they are.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retract_env.rod.chain import (
    ENERGY,
    LANES,
    LARGEST,
    PER_NODE,
    PIVOTS,
    SLOPE,
    WORST,
    newton_step,
    sweep,
    total_energy,
)
from retract_env.rod.mechanics import CONTRACT

TOLERANCE = 1e-10
"""Largest component of the residual, E h d, with which a chain is in equilibrium: 0.1 nN for the paper's
flap."""
MOST_TURN = 0.4
"""rad, of a node in one step."""
PLAIN, DAMPED = 14, 80
"""Newton iterations without and with a line search before a chain is given up."""
SUFFICIENT = 1e-4
"""Share of the descent that the slope promises which a damped step has to make (Armijo)."""
HALVINGS = 25


@njit(cache=True, error_model="numpy")
def equilibrate(P, U, W, Z, count, clamped, todo, done):
    """Bring the chains of the lanes in `todo` into stable equilibrium, from U; done (LANES,) says which are.

    Newton's method, its steps cut to `MOST_TURN`; where that does not lead there, again from the start with a
    line search on the energy. Lanes that are not to be done keep their U and come out not done; those that
    fail hold no equilibrium. W then has the reactions of the lanes that are done.
    """
    rows = 3 * (count + 1)
    start = PER_NODE * (count + 1) * LANES
    for r in range(rows * LANES):
        Z[start + r] = U[r]
    done[:] = False
    left = np.empty(LANES, np.bool_)
    left[:] = todo
    first = 1 if clamped else 0
    pace = np.empty(LANES)
    for _ in range(PLAIN):
        sweep(P, U, W, Z, count, clamped)
        if not _settle(W, left, done):
            return
        newton_step(W, Z, count, clamped)
        _set_pace(W, left, pace)
        _move(U, Z, U, pace, first, count)
    for l in range(LANES):
        if left[l]:
            for r in range(rows):
                U[r * LANES + l] = Z[start + r * LANES + l]
    _descend(P, U, W, Z, count, clamped, left, done)


@njit(cache=True, error_model="numpy")
def _descend(P, U, W, Z, count, clamped, left, done):
    """`equilibrate` with a line search: each step lowers the energy."""
    first = 1 if clamped else 0
    pace, settled, reached = np.empty(LANES), np.empty(LANES, np.bool_), np.empty(LANES)
    trial = np.empty_like(U)
    for _ in range(DAMPED):
        sweep(P, U, W, Z, count, clamped)
        if not _settle(W, left, done):
            return
        newton_step(W, Z, count, clamped)
        _set_pace(W, left, pace)
        for l in range(LANES):
            settled[l] = not left[l]
        for _ in range(HALVINGS):
            _move(U, Z, trial, pace, first, count)
            total_energy(P, trial, count, clamped, reached)
            waiting = False
            for l in range(LANES):
                if not settled[l]:
                    before, slope = W[ENERGY * LANES + l], W[SLOPE * LANES + l]
                    # near the minimum the energy changes by less than it is rounded
                    rounding = 1e-14 * (abs(before) + 1e-3)
                    if reached[l] <= before + SUFFICIENT * pace[l] * slope + rounding:
                        settled[l] = True
                    else:
                        pace[l] *= 0.5
                        waiting = True
            if not waiting:
                break
        _move(U, Z, U, pace, first, count)


@njit(error_model="numpy")
def _set_pace(W, left, pace):
    """How much of Newton's step each lane takes: none that is not left, and none turns by too much."""
    for l in range(LANES):
        largest = W[LARGEST * LANES + l]
        pace[l] = 0.0 if not left[l] else min(1.0, MOST_TURN / largest) if largest > 0.0 else 1.0


@njit(error_model="numpy")
def _settle(W, left, done):
    """Note which lanes are in equilibrium; whether others are left."""
    waiting = False
    for l in range(LANES):
        if left[l]:
            # the greatest of numbers passes over those that are none, but a sum keeps them
            finite = math.isfinite(W[ENERGY * LANES + l])
            if finite and W[WORST * LANES + l] <= TOLERANCE and W[PIVOTS * LANES + l] == 0.0:
                done[l] = True
                left[l] = False
            else:
                waiting = True
    return waiting


@njit(fastmath=CONTRACT, error_model="numpy")
def _move(U, Z, out, pace, first, count):
    """U and the step, as far as each lane's pace has it, into out."""
    for node in range(first, count):
        for k in range(3):
            for l in range(LANES):
                u = (3 * node + k) * LANES + l
                moved = U[u] + pace[l] * Z[(PER_NODE * node + 18 + k) * LANES + l]
                out[u] = moved if pace[l] > 0.0 else U[u]
    for k in range(3):
        for l in range(LANES):
            out[3 * count * LANES + k * LANES + l] = U[3 * count * LANES + k * LANES + l]
            if first == 1:
                out[k * LANES + l] = U[k * LANES + l]
