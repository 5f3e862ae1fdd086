"""What is seen and felt of flaps that are rods: surfaces, clearance, strain, what the jaws feel."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retract_env.objectives import WORST_FRACTION
from retract_env.rod.chain import LANES, LENGTH, SLACK
from retract_env.rod.flap import FREE, INNER
from retract_env.rod.grip import COMPRESSION, FREE_MOMENT, ON_BED, bearing, squeeze
from retract_env.rod.mechanics import CONTRACT, sine_cosine, strains

COLUMNS = 2 * (FREE + INNER) + 1
"""Sections whose places are told: those at nodes and half way between them, from the free to the fixed
end."""
JAWS_COLUMN = 2 * FREE
PINCH = 0.5
"""Heights along the flap over which its thinning by the jaws falls to a half."""
THICKER = 1.0 / 12.0
"""Mean stretch of both surfaces of a freely bent section, times its curvature squared: less than its axis's,
as it is thicker on the pressed side."""
BISECTIONS = 16
BENT, DRAGGED, SHARPNESS = 2.64, 1.2, 9
"""eps_1% = (held^p + rod^p)^(1/p), with p the sharpness: the most strained tissue is that between the jaws or
that elsewhere. What is held is squeezed, bent and sheared: held^2 = squeeze^2 + (BENT M)^2 + (DRAGGED T)^2 +
..., M the larger of the moments that the jaws do to both sides, E h^2 d, and T what they drag along the flap,
E h d. (The surface of a bent flap is strained by 6 M, of which half counts.) Of the set `fit`
(benchmarks.rod_motions)."""
INTO_BED, YIELDS, RELIEVED, PRESSED = 1.55, 2.2, 0.2, 1.85
"""Jaws of which the lower one is d heights below the bed's surface press the tissue beside it onto the bed,
which the rod's bed, soft as it is, does not feel: it pushes them up with INTO_BED d / (1 + YIELDS d) E h d,
they press on the tissue between them with RELIEVED d less, and it is strained by PRESSED d. From random
motions, all of them outside the limits; it is there so that nothing is gained by pressing the jaws into the
bed."""

# What is measured, as a row of numbers
WORST, NORMAL_1, NORMAL_2, DRAG_1, DRAG_2, FRICTION_1, FRICTION_2, CLEARANCE, OVERLAP = range(9)
FIRST_HIT, LAST_HIT, HIGHEST = 9, 10, 11
MEASURED = 12
# Where one looks from, as a row of numbers, m, and the tool if it hides what is behind it
CAMERA_X, CAMERA_Y, TARGET_X, IN_SIGHT, PAD, STEM = range(6)
SIGHT = 6


@njit(cache=True, nogil=True, fastmath=CONTRACT, error_model="numpy")
def surfaces(Uf, Ui, thinned, points):
    """Lower and upper surface of each lane at COLUMNS sections into points (4 COLUMNS LANES,): x and y of the
    lower one, x and y of the upper one, heights. thinned (LANES,): compression over the height."""
    _along(Uf, FREE, 0, thinned, points)
    _along(Ui, INNER, JAWS_COLUMN, thinned, points)
    # the two parts end at the jaws, pushed apart a little: the section there is half way
    last = 3 * FREE * LANES
    Q = points[4 * JAWS_COLUMN * LANES : 4 * (JAWS_COLUMN + 1) * LANES]
    for l in range(LANES):
        x = 0.5 * (Uf[last + l] + Ui[l])
        y = 0.5 * (Uf[last + LANES + l] + Ui[LANES + l])
        s, c = sine_cosine(Ui[2 * LANES + l])
        _put(Q, l, x, y, s, c, 0.5 * (1.0 - thinned[l]))


@njit(fastmath=CONTRACT, error_model="numpy")
def _put(Q, l, x, y, s, c, half):
    """One lane's section into its rows of points: around (x, y), half of its height to each side."""
    Q[l] = x + half * s
    Q[LANES + l] = y - half * c
    Q[2 * LANES + l] = x - half * s
    Q[3 * LANES + l] = y + half * c


@njit(fastmath=CONTRACT, error_model="numpy")
def _half(ax, ay, thinned):
    """Half of the height of a section that is (ax, ay) from the jaws."""
    far = math.sqrt(ax * ax + ay * ay) * (1.0 / PINCH)
    return 0.5 - 0.5 * thinned / (1.0 + far * far)


@njit(fastmath=CONTRACT, error_model="numpy")
def _along(U, count, first, thinned, points):
    """One chain's sections, from column `first` on; between nodes the axis is a cubic."""
    x_jaws = U[3 * count * LANES : 3 * count * LANES + 2 * LANES] if first == 0 else U[: 2 * LANES]
    for node in range(count + 1):
        V = U[3 * node * LANES : 3 * node * LANES + 3 * LANES]
        Q = points[4 * (first + 2 * node) * LANES : 4 * (first + 2 * node) * LANES + 4 * LANES]
        for l in range(LANES):
            s, c = sine_cosine(V[2 * LANES + l])
            x, y = V[l], V[LANES + l]
            _put(Q, l, x, y, s, c, _half(x - x_jaws[l], y - x_jaws[LANES + l], thinned[l]))
    for node in range(count):
        V = U[3 * node * LANES : 3 * node * LANES + 6 * LANES]
        Q = points[4 * (first + 2 * node + 1) * LANES : 4 * (first + 2 * node + 1) * LANES + 4 * LANES]
        for l in range(LANES):
            t0, t1 = V[2 * LANES + l], V[5 * LANES + l]
            dx, dy = V[3 * LANES + l] - V[l], V[4 * LANES + l] - V[LANES + l]
            length = math.sqrt(dx * dx + dy * dy)
            s, c = sine_cosine(0.5 * (t0 + t1))
            # Hermite's cubic with the sections' directions at both ends bulges by this much, to second order
            bulge = 0.125 * length * (t1 - t0)
            x = 0.5 * (V[l] + V[3 * LANES + l]) + bulge * s
            y = 0.5 * (V[LANES + l] + V[4 * LANES + l]) - bulge * c
            _put(Q, l, x, y, s, c, _half(x - x_jaws[l], y - x_jaws[LANES + l], thinned[l]))


@njit(cache=True, nogil=True, fastmath=CONTRACT, error_model="numpy")
def worst_strain(free, inner, Uf, Ui, work, out):
    """eps_1% of each lane's rod, squeeze apart, into out (LANES,): the mean strain of the 1 % of volume that
    is strained most.

    In an element the strain goes linearly over the height. The mean of what lies above a level t, over that
    share of the volume, is the least over t of t + (mean of what exceeds t) / share; the best t is found by
    bisection. work: at least (4 (FREE + INNER) + 4) LANES numbers.
    """
    low, high, total = work[:LANES], work[LANES : 2 * LANES], work[2 * LANES : 3 * LANES]
    for l in range(LANES):
        low[l] = high[l] = 0.0
        total[l] = FREE * free[LENGTH * LANES + l] + INNER * inner[LENGTH * LANES + l]
    ends = work[4 * LANES :]
    _extremes(free, Uf, FREE, ends, high)
    _extremes(inner, Ui, INNER, ends[3 * FREE * LANES :], high)
    share, above = work[3 * LANES : 4 * LANES], out
    for _ in range(BISECTIONS):
        for l in range(LANES):
            above[l] = 0.5 * (low[l] + high[l])
            share[l] = 0.0
        for e in range(FREE + INNER):
            V = ends[3 * e * LANES : 3 * e * LANES + 3 * LANES]
            for l in range(LANES):
                t, a, b = above[l], V[l], V[LANES + l]
                over = max(b - t, 0.0) - max(a - t, 0.0) + max(-a - t, 0.0) - max(-b - t, 0.0)
                share[l] += V[2 * LANES + l] * over / (b - a)
        for l in range(LANES):
            more = share[l] > WORST_FRACTION * total[l]
            low[l] = above[l] if more else low[l]
            high[l] = high[l] if more else above[l]
    for l in range(LANES):
        above[l] = 0.5 * (low[l] + high[l])
        share[l] = 0.0
    for e in range(FREE + INNER):
        V = ends[3 * e * LANES : 3 * e * LANES + 3 * LANES]
        for l in range(LANES):
            t, a, b = above[l], V[l], V[LANES + l]
            p, q, r, s = max(b - t, 0.0), max(a - t, 0.0), max(-a - t, 0.0), max(-b - t, 0.0)
            share[l] += V[2 * LANES + l] * (p * p - q * q + r * r - s * s) / (2.0 * (b - a))
    for l in range(LANES):
        out[l] = above[l] + share[l] / (WORST_FRACTION * total[l])


@njit(fastmath=CONTRACT, error_model="numpy")
def _extremes(P, U, count, ends, high):
    """Least and greatest strain over each element's height and its length into ends; the largest into
    high."""
    for e in range(count):
        V = U[3 * e * LANES : 3 * e * LANES + 6 * LANES]
        Q = ends[3 * e * LANES : 3 * e * LANES + 3 * LANES]
        for l in range(LANES):
            length = P[LENGTH * LANES + l]
            per = 1.0 / length
            s, c = sine_cosine(0.5 * (V[2 * LANES + l] + V[5 * LANES + l]))
            dx, dy = (V[3 * LANES + l] - V[l]) * per, (V[4 * LANES + l] - V[LANES + l]) * per
            bend = abs(V[5 * LANES + l] - V[2 * LANES + l]) * per
            stretch = strains(dx, dy, s, c)[0] - (P[SLACK * LANES + l] - THICKER) * bend * bend
            half = 0.5 * bend + 1e-9  # never without width
            Q[l] = stretch - half
            Q[LANES + l] = stretch + half
            Q[2 * LANES + l] = length
            high[l] = max(high[l], abs(stretch) + half)


@njit(cache=True, nogil=True, error_model="numpy")
def pressing(pose, loads, kept, held, lane):
    """Mean normal force of both jaws of one lane, E h d; arguments as of `measure`."""
    c, s = math.cos(pose[2 * LANES + lane]), math.sin(pose[2 * LANES + lane])
    free_along = c * loads[lane] + s * loads[LANES + lane]
    inner_along = c * loads[3 * LANES + lane] + s * loads[4 * LANES + lane]
    mean = bearing(kept, held, loads[5 * LANES + lane], loads[2 * LANES + lane], inner_along - free_along)
    return mean - RELIEVED * _below_bed(pose, kept, c, lane)


@njit(error_model="numpy")
def _below_bed(pose, kept, c, lane):
    """How far the lower jaw is below the bed's surface, heights; c: cosine of the jaws' angle."""
    return max(0.5 * (1.0 - kept[COMPRESSION]) * c - pose[LANES + lane], 0.0) * kept[ON_BED]


@njit(cache=True, nogil=True, error_model="numpy")
def measure(pose, loads, kept, held, rod_strain, lane, out):
    """What one lane's jaws feel, and its eps_1%, into out (MEASURED,).

    pose: rows x, y, theta and push; loads: of `move`; kept, held: its grip and the weights of `bearing`;
    rod_strain (LANES,): of `worst_strain`. Forces come in E h d. The moment that the jaws carry by their
    tangential forces is that about the middle between them.
    """
    c, s = math.cos(pose[2 * LANES + lane]), math.sin(pose[2 * LANES + lane])
    compression, push = kept[COMPRESSION], pose[3 * LANES + lane]
    free_x, free_y, free_m = loads[lane], loads[LANES + lane], loads[2 * LANES + lane]
    inner_x, inner_y, inner_m = loads[3 * LANES + lane], loads[4 * LANES + lane], loads[5 * LANES + lane]
    free_along, inner_along = c * free_x + s * free_y, c * inner_x + s * inner_y
    free_across, inner_across = c * free_y - s * free_x, c * inner_y - s * inner_x
    pressed = squeeze(kept, compression)[1]
    mean, low = pressing(pose, loads, kept, held, lane), _below_bed(pose, kept, c, lane)
    lift, drag = free_across + inner_across, free_along + inner_along
    lift -= INTO_BED * low / (1.0 + YIELDS * low)
    moment = held[FREE_MOMENT] * free_m + inner_m + push * (inner_across - free_across)
    couple = moment / (1.0 - compression)
    out[NORMAL_1], out[NORMAL_2] = mean + 0.5 * lift, mean - 0.5 * lift
    out[DRAG_1], out[DRAG_2] = 0.5 * drag + couple, 0.5 * drag - couple
    for jaw in range(2):
        normal = out[NORMAL_1 + jaw]
        out[FRICTION_1 + jaw] = abs(out[DRAG_1 + jaw]) / normal if normal > 0.0 else np.inf
    bent = BENT * max(abs(inner_m), abs(free_m))
    sheared, below = DRAGGED * drag, PRESSED * low
    a = math.sqrt(pressed * pressed + bent * bent + sheared * sheared + below * below)
    b = rod_strain[lane]
    # over the larger of the two: absurd strains, also infinite ones, do not overflow
    most = max(a, b)
    out[WORST] = most
    if 0.0 < most < np.inf:
        out[WORST] *= ((a / most) ** SHARPNESS + (b / most) ** SHARPNESS) ** (1.0 / SHARPNESS)


@njit(cache=True, nogil=True, error_model="numpy")
def above(sight, x, y):
    """How far (x, y), m, is above the line of sight; negative on the camera's side of it."""
    dx, dy = sight[CAMERA_X] - sight[TARGET_X], sight[CAMERA_Y]
    return ((x - sight[TARGET_X]) * dy - y * dx) / math.sqrt(dx * dx + dy * dy)


@njit(cache=True, nogil=True, error_model="numpy")
def tool_clearance(jaws, width, sight):
    """Clearance, m, of the gripper's pads and stems, for jaws (4,) m; as `physics.measures.tool_outline`
    draws them. width: m, of the jaws."""
    long = math.hypot(jaws[2] - jaws[0], jaws[3] - jaws[1])
    ax, ay = (jaws[2] - jaws[0]) / long, (jaws[3] - jaws[1]) / long
    pad, stem = sight[PAD], sight[PAD] + sight[STEM]
    lowest = np.inf
    for jaw in range(2):
        x, y, away = jaws[2 * jaw], jaws[2 * jaw + 1], 2.0 * jaw - 1.0
        for side in (-1.0, 1.0):
            for half, far in ((width / 2, 0.0), (width / 2, pad), (pad / 4, pad), (pad / 4, stem)):
                px = x + side * half * ay + away * far * ax
                py = y - side * half * ax + away * far * ay
                lowest = min(lowest, above(sight, px, py))
    return lowest
