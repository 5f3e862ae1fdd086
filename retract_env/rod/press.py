"""Jaws that press with a given force, as a gripper can: the compression of a lane is then found, not given.

The grip's law says how hard tissue presses back that is closed by c while the rod transmits some loads, so c
follows from the force once the loads are known (`find_compression`). The loads depend on c only through what
is pushed out of the jaws and how soft the tissue at their edge is: c changes by thousandths in a move, and
the chains follow it in a second, short Newton's method.
"""

from __future__ import annotations

import math

from numba import njit

from retract_env.rod.flap import rerooted
from retract_env.rod.grip import COMPRESSION, FORCE, MADE_FOR, PUSH, SETTLED, pushed_out, root_of, squeeze
from retract_env.rod.measures import pressing

FARTHEST_OPEN, FIRMEST = -0.2, 0.6
"""Least and greatest compression, over the height, at which a force is looked for: tissue that is pushed
along the flap is thicker than at rest, and a grip by force lets it be; squeezes much firmer no law was fitted
to."""
CLOSE_ENOUGH = 1e-4
"""Compression, over the height, by which the chains may be off from the one that is found. It changes that
one by 3e-7, and what is pushed out of the jaws by 0.1 micrometres."""
PASSES = 8
"""Equilibria of the chains in one move, at most; one or two are the rule."""
ITERATIONS, EXACT = 60, 1e-12
"""Of the search for one compression, which ends where the force is met to this part."""


@njit(cache=True, nogil=True, error_model="numpy")
def first_compression(kept, held, force):
    """Compression at which a flap that lies on its bed presses with a force, E h d; kept: a row of `grip`."""
    low, high = 0.0, FIRMEST
    for _ in range(ITERATIONS):
        c = 0.5 * (low + high)
        if squeeze(kept, c)[0] * (1.0 + held[SETTLED]) < force:
            low = c
        else:
            high = c
    return 0.5 * (low + high)


@njit(cache=True, nogil=True, error_model="numpy")
def find_compression(pose, loads, kept, held, lane):
    """Have the compression of a lane be the one at which it presses with its force under these loads; False
    where there is none.

    pose, loads, kept, held: as of `measures.measure`. Regula falsi (Illinois) from a secant around the last.
    """
    force, begin = kept[FORCE], kept[COMPRESSION]
    a, step = begin, 1e-3
    fa = pressing(pose, loads, kept, held, lane) - force
    if abs(fa) <= EXACT * force:
        return True
    b, fb = a, fa
    # from the last compression on, in growing steps, until the force is passed
    while (fa > 0.0) == (fb > 0.0):
        a, fa = b, fb
        if not FARTHEST_OPEN < b < FIRMEST:
            kept[COMPRESSION] = begin
            return False
        b = b + step if fb < 0.0 else b - step
        kept[COMPRESSION] = b
        fb = pressing(pose, loads, kept, held, lane) - force
        if not math.isfinite(fb):
            kept[COMPRESSION] = begin
            return False
        step *= 2.0
    for _ in range(ITERATIONS):
        c = b - fb * (b - a) / (fb - fa)
        kept[COMPRESSION] = c
        fc = pressing(pose, loads, kept, held, lane) - force
        if abs(fc) <= EXACT * force or c in (a, b):
            break
        if (fc > 0.0) == (fb > 0.0):
            fa *= 0.5
        else:
            a, fa = b, fb
        b, fb = c, fc
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def remade(flap, kept, held, free, inner, lane):
    """Have the chains of a lane be those of its compression, and say what is pushed out of the jaws."""
    c = kept[COMPRESSION]
    before, after = root_of(kept[MADE_FOR], held), root_of(c, held)
    if before != after:
        rerooted(before, after, free, inner, lane)
    kept[PUSH], kept[MADE_FOR] = pushed_out(flap, kept, c, held), c
