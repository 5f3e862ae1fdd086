"""What is observed, rewarded and judged, as compiled formulas on plain numbers, for many flaps at once.

`RetractionTask` and `objectives` say the same for one flap, as a reader wants to read it. Here is what a
batch of environments computes instead; tests hold both together, to the last bit. `observe` and `keypoints`
serve both.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

KEYPOINTS = 10
"""Points of each surface that are observed, from the free end on, equally far apart at rest."""
FORCES = 4
"""Numbers that the force sensors in both jaws say."""
STIFFNESS_SAMPLES = 50
"""Places along the flap, in the middle of as many equal parts of it, where k_eq is observed."""

# What has become of a state
GOES_ON, STRAIN, SLIP, RELEASE, CONTACT, DIVERGED, OK = range(7)
FAILURES = ("", "strain", "slip", "release", "contact", "diverged")

# A limit each, of a row of three
STRAIN_LIMIT, FRICTION_LIMIT, CLEARANCE_LIMIT = range(3)

TERMS = ("exposure", "clearance", "strain", "friction", "success", "failure")
"""of the reward, as `Weights` has them"""


SLENDER = 0.088
"""Height over length of the paper's flap, for which the task's ranges of compression and force are."""


# No fastmath: every number has to be rounded as NumPy rounds it.
@njit(cache=True, nogil=True, error_model="numpy")
def between(at, station):
    """Between which two of `at` (n,) ascending a station is: the first one, and how far on to the next; 0
    beyond the ends."""
    last = len(at) - 1
    if station <= at[0]:
        return 0, 0.0
    if station >= at[last]:
        return last, 0.0
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if at[middle] <= station:
            low = middle
        else:
            high = middle
    return low, (station - at[low]) / (at[high] - at[low])


@njit(cache=True, nogil=True, error_model="numpy")
def station(k, length):
    """Where keypoint k is along a flap at rest, m."""
    return -length * (1 - k / KEYPOINTS)


@njit(cache=True, nogil=True, error_model="numpy")
def keypoints(at, surface, length, out):
    """Where a surface's keypoints are now, x y x y, into out (2 KEYPOINTS,), m.

    at, surface: (n,), (n, 2) m, its nodes along the flap at rest, ascending, and now.
    """
    last = len(at) - 1
    for k in range(KEYPOINTS):
        low, share = between(at, station(k, length))
        for axis in range(2):
            here, next_one = surface[low, axis], surface[min(low + 1, last), axis]
            out[2 * k + axis] = here + share * (next_one - here)


@njit(cache=True, nogil=True, error_model="numpy")
def observe(
    holding,
    time_left,
    jaws,
    length,
    height,
    points,
    sight,
    k_eq,
    strain,
    most_strain,
    friction_1,
    friction_2,
    most_friction,
    clearance,
    exposure,
    limits,
    forces,
    off,
    low,
    high,
    out,
):
    """The observation, as LAYOUT describes it, into out (SIZE,) float32.

    jaws: (4,) m, where they are; length, height: m, of the flap as it is stated; points: (4 KEYPOINTS,) m,
    keypoints of the lower, then of the upper surface; sight: (3,) target, slope, nearness; k_eq:
    (STIFFNESS_SAMPLES,), modulus / height; limits: (3,); forces: FORCES numbers, E w d; off: (3,) m, by how
    much the jaws are off in x and in y from where they were sent to, and have closed further: what is
    observed is where they were sent to; low, high: bounds (SIZE,) float32.
    """
    dx, dy = jaws[2] - jaws[0], jaws[3] - jaws[1]
    separation = math.sqrt(dx * dx + dy * dy)
    i = 0
    for value in (
        1.0 if holding else 0.0,
        time_left,
        ((jaws[0] + jaws[2]) / 2 - off[0]) / length,
        ((jaws[1] + jaws[3]) / 2 - off[1]) / length,
        -dx / separation if separation > 0 else 0.0,
        dy / separation if separation > 0 else 1.0,
        (separation + off[2]) / height,
    ):
        out[i] = min(max(value, low[i]), high[i])
        i += 1
    for k in range(4 * KEYPOINTS):
        out[i] = min(max(points[k] / length, low[i]), high[i])
        i += 1
    for k in range(3):
        out[i] = min(max(sight[k], low[i]), high[i])
        i += 1
    for k in range(STIFFNESS_SAMPLES):
        out[i] = min(max(k_eq[k], low[i]), high[i])
        i += 1
    for value in (
        strain / limits[STRAIN_LIMIT],
        most_strain / limits[STRAIN_LIMIT],
        friction_1 / limits[FRICTION_LIMIT],
        friction_2 / limits[FRICTION_LIMIT],
        most_friction / limits[FRICTION_LIMIT],
        clearance / length,
        exposure,
    ):
        out[i] = min(max(value, low[i]), high[i])
        i += 1
    for value in forces:
        out[i] = min(max(value, low[i]), high[i])
        i += 1


@njit(cache=True, nogil=True, error_model="numpy")
def sensed(reactions, jaws, unit):
    """What sensors in the jaws feel, FORCES numbers, over a unit, N.

    reactions: of the tissue on the lower and on the upper jaw, x, y, x, y, N; jaws: (4,) m. Of the lower,
    then of the upper jaw: with what it presses, and with what it drags the tissue along the flap, towards the
    fixed end where the jaws stand upright.
    """
    x1, y1, x2, y2 = reactions
    ax, ay = jaws[2] - jaws[0], jaws[3] - jaws[1]
    long = math.sqrt(ax * ax + ay * ay)
    ax, ay = (ax / long, ay / long) if long > 0 else (0.0, 1.0)
    return (
        -(x1 * ax + y1 * ay) / unit,
        -(x1 * ay - y1 * ax) / unit,
        (x2 * ax + y2 * ay) / unit,
        -(x2 * ay - y2 * ax) / unit,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def exposed_beside(first, last, target, near):
    """Fraction of the bed from x = near to the target, m, that is seen where what is between first and last
    is hidden."""
    low, high = min(max(first, near), target), min(max(last, near), target)
    seen = 0.0
    if low > near:
        seen += low - near
    if target > high:
        seen += target - high
    return min(1.0, seen / (target - near))


@njit(cache=True, nogil=True, error_model="numpy")
def exposed_above(lower, upper, camera_x, camera_y, target, near):
    """`objectives.exposure` past a flap, of which part may be as high as the camera: every edge by itself.

    lower, upper: (n, 2) m, both surfaces from the free to the fixed end.
    """
    n = len(lower)
    ring = np.empty((2 * n + 3, 2))
    for i in range(n):
        ring[i] = lower[i]
        ring[n + 1 + i] = upper[n - 1 - i]
    for k in range(2):
        ring[n, k] = (lower[n - 1, k] + upper[n - 1, k]) / 2
        ring[2 * n + 1, k] = (lower[0, k] + upper[0, k]) / 2
        ring[2 * n + 2, k] = lower[0, k]
    edges = np.empty((2 * n + 2, 2, 2))
    for i in range(2 * n + 2):
        edges[i, 0], edges[i, 1] = ring[i], ring[i + 1]
    return exposed_past(edges, camera_x, camera_y, target, near)


@njit(cache=True, nogil=True, error_model="numpy")
def exposed_past(outline, camera_x, camera_y, target, near):
    """`objectives.exposure` past pieces of an outline (n, k, 2) m, k points in a row each."""
    pieces, points = outline.shape[0], outline.shape[1]
    begins, ends = np.empty(pieces * (points - 1)), np.empty(pieces * (points - 1))
    count = 0
    for piece in range(pieces):
        for k in range(points - 1):
            px, py = outline[piece, k, 0], outline[piece, k, 1]
            qx, qy = outline[piece, k + 1, 0], outline[piece, k + 1, 1]
            a, b = _hit(px, py, camera_x, camera_y), _hit(qx, qy, camera_x, camera_y)
            if math.isinf(a) and math.isinf(b):
                continue
            if math.isinf(a) or math.isinf(b):
                # on its way up past the camera, an edge leaves on the side where it is level with it
                level = px + (qx - px) * (camera_y - py) / (qy - py)
                away = math.copysign(np.inf, level - camera_x)
                a, b = away if math.isinf(a) else a, away if math.isinf(b) else b
            a, b = min(max(a, near), target), min(max(b, near), target)
            # put in its place among those so far; NumPy's sort would take seconds to compile
            place, begin, end = count, min(a, b), max(a, b)
            while place > 0 and begins[place - 1] > begin:
                begins[place], ends[place] = begins[place - 1], ends[place - 1]
                place -= 1
            begins[place], ends[place] = begin, end
            count += 1
    seen, hidden_to = 0.0, near
    for i in range(count):
        if begins[i] > hidden_to:
            seen += begins[i] - hidden_to
        hidden_to = max(hidden_to, ends[i])
    if target > hidden_to:
        seen += target - hidden_to
    return min(1.0, seen / (target - near))


@njit(cache=True, nogil=True, error_model="numpy")
def _hit(x, y, camera_x, camera_y):
    drop, aside = camera_y - max(y, 0.0), x - camera_x
    return camera_x + aside * camera_y / drop if drop > 0 else math.copysign(np.inf, aside)


@njit(cache=True, nogil=True, error_model="numpy")
def verdict(strain, friction, clearance, limits, overlap):
    """What has become of a state, as `objectives.verdict`: a code."""
    if strain > limits[STRAIN_LIMIT]:
        return STRAIN
    if math.isinf(friction):
        return RELEASE
    if friction > limits[FRICTION_LIMIT]:
        return SLIP
    if overlap:
        return CONTACT
    return OK if clearance >= limits[CLEARANCE_LIMIT] else GOES_ON


@njit(cache=True, nogil=True, error_model="numpy")
def grip_range(light, firm, length, height):
    """The lightest grip of a flap, and the factor from there to a firmness of 1 in [0, 1].

    light, firm: those of the task, over the flap's height or over E w d. What bends a flap grows with the
    square of its height over its length, and what holds it has to grow as much: so does the lightest grip,
    and flaps that differ in this alone want about the same action. The firmest is the task's for all.
    """
    slender = height / length / SLENDER
    lightest = min(light * slender * slender, max(light, firm / 2))
    return lightest, firm / min(light, lightest)


@njit(cache=True, nogil=True, error_model="numpy")
def way(clearance, outset, asked):
    """Part of the way from the clearance at rest to what the scene asks for, in [0, 1]."""
    return min(max(1 - (clearance - asked) / (outset - asked), 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def rest_clearance(length, height, camera_x, camera_y, target):
    """Clearance, m, of the flap before it is touched, as `objectives.clearance` has it."""
    long = math.hypot(camera_x - target, camera_y)
    dx, dy = (camera_x - target) / long, camera_y / long
    lowest = np.inf
    for x in (-length, -length / 2, 0.0):
        for y in (0.0, height / 2, height):
            lowest = min(lowest, (x - target) * dy - y * dx)
    return lowest
