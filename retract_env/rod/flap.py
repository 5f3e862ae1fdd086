"""A flap between two jaws as two chains: the part from the jaws to the fixed end, and the free part.

The jaws clamp the axis at the middle of the grasp. Given their pose, neither part knows of the other.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.rod.chain import (
    BED,
    BLOCK,
    LANES,
    LEFT,
    LENGTH,
    LOAD,
    RIGHT,
    SLACK,
    STIFFNESS,
    WEIGHT,
    factor_rows,
    parameters_rows,
)
from retract_env.rod.equilibrium import equilibrate
from retract_env.rod.sections import SHEAR, SLICES, moments

FREE, INNER = 10, 16
"""Elements of the free part, and of the part between the jaws and the fixed end."""
BED_STIFFNESS, BLOCK_STIFFNESS = 0.3, 2.0
"""E d per length of flap: what the tissue between axis and surface gives. The block's is that of half the
height; the bed's is softer, which is found sooner and changes no lifted flap."""
SHORTEST = 0.02
"""Least length of the free part, heights: a grasp at the free end leaves a stub, where otherwise nothing
were."""
STRETCHED_ROOT = 0.13
"""Length of flap, heights, that stretches as much as the tissue that the jaws hold by its surfaces gives. Of
the set `fit` (benchmarks.rod_motions); 0.12 to 0.14 do as well."""
SLACKENS = 0.74
"""Share of the slack of a bent section (`mechanics`) that a flap has: jaws and fixed end hold its thickness.
Of the set `fit`; 0.7 to 0.78 do as well."""
PLANE = 3.0
"""Depth over height at which half of the way is made from a narrow flap, whose fibres contract freely, to a
deep one, whose fibres cannot contract along the depth."""

# What a flap is, as a row of numbers; lengths in m, stresses in Pa
LENGTH_M, HEIGHT, DEPTH, MODULUS, POISSON, SPECIFIC_WEIGHT, JAW_WIDTH, HAS_BED = range(8)
NUMBERS = 8

FREE_PARAMETERS, INNER_PARAMETERS = parameters_rows(FREE), parameters_rows(INNER)
FREE_UNKNOWNS, INNER_UNKNOWNS = 3 * (FREE + 1), 3 * (INNER + 1)
FACTORS = factor_rows(max(FREE, INNER))


@njit(cache=True, nogil=True, error_model="numpy")
def build(flap, vertices, offsets, moduli, x, root, free, inner, lane):
    """Parameters of both chains of a flap grasped at x, m, into one lane of free and inner.

    flap: its numbers; vertices, offsets, moduli: of its veins, as `moments` has them; root: length of flap,
    heights, that bends as much as the tissue at the jaws gives, which hold it by its surfaces.
    """
    height = flap[HEIGHT]
    weight = flap[SPECIFIC_WEIGHT] * height / flap[MODULUS]
    bed = BED_STIFFNESS if flap[HAS_BED] > 0 else 0.0
    left = min(-flap[LENGTH_M], x - SHORTEST * height)
    _chain(flap, vertices, offsets, moduli, left, x, FREE, weight, bed, free, lane, FREE - 1, root)
    _chain(flap, vertices, offsets, moduli, x, 0.0, INNER, weight, bed, inner, lane, 0, root)


@njit(error_model="numpy")
def _chain(flap, vertices, offsets, moduli, left, right, count, weight, bed, P, lane, held, root):
    height, modulus, poisson = flap[HEIGHT], flap[MODULUS], flap[POISSON]
    step = (right - left) / (count * SLICES)
    integrals = np.empty((3, count * SLICES))
    moments(left + step / 2, step, height / 2, modulus, vertices, offsets, moduli, integrals)
    ratio = flap[DEPTH] / height
    deep = ratio * ratio / (ratio * ratio + PLANE * PLANE)
    stiffer = 1.0 / (1.0 - deep * poisson * poisson)
    P[LENGTH * LANES + lane] = (right - left) / count / height
    P[WEIGHT * LANES + lane] = weight
    P[BED * LANES + lane] = bed
    P[BLOCK * LANES + lane] = BLOCK_STIFFNESS
    P[SLACK * LANES + lane] = SLACKENS * (1.0 + 1.5 * poisson) / 12.0
    for k in range(3):
        P[(LOAD + k) * LANES + lane] = 0.0
    # one division a number: there are hundreds of slices
    by_area = 1.0 / (modulus * height)
    by_first, by_second = by_area / height, by_area / (height * height)
    give = 2.0 * (1.0 + poisson) / SHEAR
    for e in range(count):
        stretch, couple, bend, shear = 0.0, 0.0, 0.0, 0.0
        for i in range(e * SLICES, (e + 1) * SLICES):
            area, first = integrals[0, i] * by_area, integrals[1, i] * by_first
            second = integrals[2, i] * by_second
            share = 1.0 / (area * second - first * first)
            stretch += second * share
            couple += first * share
            bend += area * share
            shear += give / area
        stretch, couple, bend, shear = stretch / SLICES, couple / SLICES, bend / SLICES, shear / SLICES
        if e == held:
            stretch *= 1.0 + STRETCHED_ROOT / P[LENGTH * LANES + lane]
            bend *= 1.0 + root / P[LENGTH * LANES + lane]
        determinant = stretch * bend - couple * couple
        p = (STIFFNESS + 4 * e) * LANES + lane
        P[p] = stiffer * bend / determinant
        P[p + LANES] = -stiffer * couple / determinant
        P[p + 2 * LANES] = stiffer * stretch / determinant
        P[p + 3 * LANES] = 1.0 / shear


@njit(cache=True, nogil=True, error_model="numpy")
def rerooted(before, after, free, inner, lane):
    """Have the chains of a lane that were made for one root, heights, another: as `build` would, but for
    rounding, and without a look at the flap."""
    _reroot(before, after, free, FREE - 1, lane)
    _reroot(before, after, inner, 0, lane)


@njit(error_model="numpy")
def _reroot(before, after, P, e, lane):
    length, p = P[LENGTH * LANES + lane], (STIFFNESS + 4 * e) * LANES + lane
    a, b, c = P[p], P[p + LANES], P[p + 2 * LANES]
    per = 1.0 / (a * c - b * b)
    # back to compliances, of which the root makes that in bending larger
    stretch, couple, bend = c * per, -b * per, a * per
    bend *= (1.0 + after / length) / (1.0 + before / length)
    per = 1.0 / (stretch * bend - couple * couple)
    P[p], P[p + LANES], P[p + 2 * LANES] = bend * per, -couple * per, stretch * per


@njit(cache=True, nogil=True, error_model="numpy")
def lay_flat(P, U, count, right, lane):
    """The chain straight at rest, its right end at x = right heights."""
    length = P[LENGTH * LANES + lane]
    for node in range(count + 1):
        U[3 * node * LANES + lane] = right - (count - node) * length
        U[(3 * node + 1) * LANES + lane] = 0.5
        U[(3 * node + 2) * LANES + lane] = 0.0


SMALLEST_PART = 1.0 / 64.0
"""Part of a move below which it is not cut any further."""


@njit(inline="always", error_model="numpy")
def move(free, inner, Uf, Ui, here, goal, todo, W, Z, loads, done):
    """Move the jaws of the lanes in todo straight from here to goal, (4 LANES,) each: x, y, theta and push.

    In heights and rad; push: by how far the tissue between the jaws pushes both parts away. free, inner:
    parameters; Uf, Ui: unknowns, in equilibrium before and after; where a lane fails, also with its move cut
    into parts, they stay as they were, and so does here, which else becomes goal. loads (6 LANES,): what the
    clamp does to the free part and to the other one, force (2) and moment each. done (LANES,): which lanes
    are there.
    """
    start_f, start_i = Uf.copy(), Ui.copy()
    last_f, last_i = Uf.copy(), Ui.copy()
    at, part = np.zeros(LANES), np.ones(LANES)
    left = todo.copy()
    ok, ok_free = np.empty(LANES, np.bool_), np.empty(LANES, np.bool_)
    pose = np.empty(4)
    done[:] = False
    while True:
        for l in range(LANES):
            if left[l]:
                share = min(at[l] + part[l], 1.0)
                for k in range(4):
                    begin = here[k * LANES + l]
                    pose[k] = begin + share * (goal[k * LANES + l] - begin)
                _follow(Uf, FREE, FREE, pose, -pose[3], l)
                _follow(Ui, 0, INNER, pose, pose[3], l)
        equilibrate(free, Uf, W, Z, FREE, False, left, ok_free)
        for l in range(LANES):
            if ok_free[l]:
                for k in range(3):
                    loads[k * LANES + l] = W[(RIGHT + k) * LANES + l]
        equilibrate(inner, Ui, W, Z, INNER, True, ok_free, ok)
        waiting = False
        for l in range(LANES):
            if not left[l]:
                continue
            if ok[l]:
                for k in range(3):
                    loads[(3 + k) * LANES + l] = W[(LEFT + k) * LANES + l]
                _copy(Uf, last_f, FREE_UNKNOWNS, l)
                _copy(Ui, last_i, INNER_UNKNOWNS, l)
                at[l] = min(at[l] + part[l], 1.0)
                if at[l] == 1.0:
                    left[l] = False
                    done[l] = True
                    _copy(goal, here, 4, l)
                part[l] *= 2.0
            else:
                part[l] *= 0.5
                if part[l] < SMALLEST_PART:
                    left[l] = False
                    _copy(start_f, Uf, FREE_UNKNOWNS, l)
                    _copy(start_i, Ui, INNER_UNKNOWNS, l)
                else:
                    _copy(last_f, Uf, FREE_UNKNOWNS, l)
                    _copy(last_i, Ui, INNER_UNKNOWNS, l)
            waiting = waiting or left[l]
        if not waiting:
            return


@njit(error_model="numpy")
def _copy(source, target, rows, lane):
    for r in range(rows):
        target[r * LANES + lane] = source[r * LANES + lane]


@njit(error_model="numpy")
def _follow(U, held, count, pose, push, lane):
    """A guess at where a chain's nodes go when its clamped node `held` moves to a pose: with it, rigidly, at
    a free end; less and less towards a clamped one."""
    u = 3 * held * LANES + lane
    x, y, theta = U[u], U[u + LANES], U[u + 2 * LANES]
    turn = pose[2] - theta
    c, s = np.cos(turn), np.sin(turn)
    dx = pose[0] + push * np.cos(pose[2]) - x
    dy = pose[1] + push * np.sin(pose[2]) - y
    for node in range(count + 1):
        u = 3 * node * LANES + lane
        t = 1.0 if held == count else 1.0 - node / count
        weight = t * t * (3.0 - 2.0 * t)
        a, b = U[u] - x, U[u + LANES] - y
        U[u] += weight * (dx + (c - 1.0) * a - s * b)
        U[u + LANES] += weight * (dy + s * a + (c - 1.0) * b)
        U[u + 2 * LANES] += weight * turn
