"""What a flap's outline hides and touches: clearance, how far it is inside the fixed block, which bed it
hides.

For all lanes of a block at once, as it takes longer than an equilibrium to do it lane by lane.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retract_env.objectives import IN_BLOCK
from retract_env.rod.chain import LANES
from retract_env.rod.flap import HEIGHT
from retract_env.rod.measures import (
    CAMERA_X,
    CAMERA_Y,
    CLEARANCE,
    COLUMNS,
    FIRST_HIT,
    HIGHEST,
    LAST_HIT,
    OVERLAP,
    TARGET_X,
)

_HEIGHT, _CAMERA_X, _CAMERA_Y, _TARGET, _ACROSS, _UP, _LOWEST, _DEEPEST, _FIRST, _LAST, _HIGHEST = range(11)
"""Rows of the scratch array."""


# No fastmath: where rays meet the bed has to be rounded as `objectives.bed_hits` rounds it.
@njit(cache=True, nogil=True, error_model="numpy")
def outlines(points, flap, sight, done, measured):
    """Clearance, overlap, and which bed each lane in done hides, into its row of measured (LANES, MEASURED).

    points: of `surfaces`; flap (LANES, NUMBERS), sight (LANES, SIGHT). The bed from FIRST_HIT to LAST_HIT is
    hidden, as the outline is closed, unless some of it, HIGHEST, is as high as the camera.
    """
    W = np.empty(11 * LANES)
    for l in range(LANES):
        dx, dy = sight[l, CAMERA_X] - sight[l, TARGET_X], sight[l, CAMERA_Y]
        W[_HEIGHT * LANES + l], W[_TARGET * LANES + l] = flap[l, HEIGHT], sight[l, TARGET_X]
        W[_CAMERA_X * LANES + l], W[_CAMERA_Y * LANES + l] = sight[l, CAMERA_X], sight[l, CAMERA_Y]
        W[_ACROSS * LANES + l], W[_UP * LANES + l] = dx, dy
        W[_LOWEST * LANES + l] = W[_FIRST * LANES + l] = np.inf
        W[_DEEPEST * LANES + l] = W[_LAST * LANES + l] = W[_HIGHEST * LANES + l] = -np.inf
    for column in range(COLUMNS):
        Q = points[4 * column * LANES : 4 * column * LANES + 4 * LANES]
        _look(Q[: 2 * LANES], W)
        _look(Q[2 * LANES :], W)
        if column == 0 or column == COLUMNS - 1:
            _look_between(Q, W)
    for l in range(LANES):
        if done[l]:
            out = measured[l]
            long = math.sqrt(W[_ACROSS * LANES + l] ** 2 + W[_UP * LANES + l] ** 2)
            out[CLEARANCE] = W[_LOWEST * LANES + l] / long
            out[OVERLAP] = 1.0 if W[_DEEPEST * LANES + l] > IN_BLOCK else 0.0
            out[FIRST_HIT], out[LAST_HIT] = W[_FIRST * LANES + l], W[_LAST * LANES + l]
            out[HIGHEST] = W[_HIGHEST * LANES + l]


@njit(error_model="numpy")
def _look(P, W):
    """Look at one point of each lane, P: a row of x and one of y, heights."""
    for l in range(LANES):
        x, y = P[l] * W[_HEIGHT * LANES + l], P[LANES + l] * W[_HEIGHT * LANES + l]
        W[_DEEPEST * LANES + l] = max(W[_DEEPEST * LANES + l], min(P[l], 1.0 - P[LANES + l]))
        over = (x - W[_TARGET * LANES + l]) * W[_UP * LANES + l] - y * W[_ACROSS * LANES + l]
        W[_LOWEST * LANES + l] = min(W[_LOWEST * LANES + l], over)
        drop = W[_CAMERA_Y * LANES + l] - max(y, 0.0)
        hit = W[_CAMERA_X * LANES + l] + (x - W[_CAMERA_X * LANES + l]) * W[_CAMERA_Y * LANES + l] / drop
        W[_FIRST * LANES + l] = min(W[_FIRST * LANES + l], hit)
        W[_LAST * LANES + l] = max(W[_LAST * LANES + l], hit)
        W[_HIGHEST * LANES + l] = max(W[_HIGHEST * LANES + l], y)


@njit(error_model="numpy")
def _look_between(Q, W):
    """Look at the middle of a section, which belongs to the outline at both ends of the flap."""
    for l in range(LANES):
        h = W[_HEIGHT * LANES + l]
        x = (Q[l] * h + Q[2 * LANES + l] * h) / 2
        y = (Q[LANES + l] * h + Q[3 * LANES + l] * h) / 2
        drop = W[_CAMERA_Y * LANES + l] - max(y, 0.0)
        hit = W[_CAMERA_X * LANES + l] + (x - W[_CAMERA_X * LANES + l]) * W[_CAMERA_Y * LANES + l] / drop
        W[_FIRST * LANES + l] = min(W[_FIRST * LANES + l], hit)
        W[_LAST * LANES + l] = max(W[_LAST * LANES + l], hit)
