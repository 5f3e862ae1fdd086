"""What the jaws' grip does to the tissue between them: laws fitted to squeezes on fine finite elements.

The rod knows no squeeze. How hard the tissue presses back, and how much it is strained, depends on the tissue
within a jaw's width or so: its k_eq there, the flap's ends if near, its depth and the jaws' width. Both are laws

    log (N / (E w d c)) and log (eps_1% / c) = sum of weights times features

where c is the compression over the height, w the jaws' width, d the flap's depth. `grip.json` has the weights;
`python -m benchmarks.rod_grip` makes it and says how well they fit.

While the flap moves, N changes with what the rod transmits on both sides of the jaws: tissue that is bent, or
pushed along the flap, is thicker. The same file has these weights.

Pressed tissue is pushed out of the jaws, to both sides. By how much follows from Betti's theorem: along the
flap a force F thins it by nu F / (E d), so that a pair of forces N across it lengthens it by nu N / (E d), half on
each side.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.rod.flap import DEPTH, HEIGHT, JAW_WIDTH, LENGTH_M, MODULUS, POISSON
from retract_env.spring.columns import columns

Array = NDArray[np.float64]

FITTED = Path(__file__).with_name("grip.json")
PLACES, APART = 25, 0.1
"""Where k_eq is looked at: so many places, so many heights apart, around the jaws."""
DEEP = 2.0
"""Depth over height of a flap half way from narrow to deep."""
FEATURES = (
    "one", "stiffness", "c", "c^2", "free end", "fixed end", "log w", "(log w)^2", "deep", "deep nu^2", "nu^2",
    "deep log w", "log L", "stiffness^2", "c log w", "stiffness log w", "c deep", "stiffness deep", "c stiffness",
)  # fmt: skip
SHAPE = 4
"""Numbers of a law before its weights: decay of the kernel over k_eq, heights; share of half a jaw's width that
counts in full; decay of what the free and the fixed end do, heights."""

# What is kept of a grip, as a row of numbers: log of the normal force over c E h d, and of eps_1% over c, each
# as p + q c + r c^2; w; nu / 2; c
NORMAL, STRAIN, WIDTH, PUSH, COMPRESSION = 0, 3, 6, 7, 8
GRIP = 9


def load() -> tuple[Array, Array]:
    """Both laws (2, SHAPE + features), of the normal force and of strain, and the weights of `held` (7,)."""
    data = json.loads(FITTED.read_text("utf-8"))
    laws = [[*data[name]["shape"], *data[name]["weights"]] for name in ("normal", "strain")]
    return np.array(laws), np.array(data["held"]["weights"])


@njit(cache=True, nogil=True, error_model="numpy")
def features(flap, vertices, offsets, moduli, x, c, shape, out):
    """FEATURES of a squeeze by c at x, m, into out. flap: numbers as `retract_env.rod.flap` has them."""
    height, length = flap[HEIGHT], flap[LENGTH_M]
    w, d, nu = flap[JAW_WIDTH] / height, flap[DEPTH] / height, flap[POISSON]
    at, stiffness = np.empty(PLACES), np.empty(PLACES)
    for i in range(PLACES):
        place = x + (i - PLACES // 2) * APART * height
        at[i] = min(max(place, -length), 0.0)
    columns(length, height, flap[MODULUS], vertices, offsets, moduli, at, stiffness)
    total, compliance = 0.0, 0.0
    for i in range(PLACES):
        beyond = max(abs(i - PLACES // 2) * APART - shape[1] * w / 2, 0.0)
        weight = math.exp(-beyond / shape[0])
        total += weight
        compliance += weight * flap[MODULUS] / (height * stiffness[i])
    stiff = -math.log(compliance / total)
    deep = d * d / (d * d + DEEP * DEEP)
    log_w = math.log(w)
    out[0], out[1], out[2], out[3] = 1.0, stiff, c, c * c
    out[4] = math.exp(-(length + x) / height / shape[2])
    out[5] = math.exp(x / height / shape[3])
    out[6], out[7], out[8], out[9], out[10] = log_w, log_w * log_w, deep, deep * nu * nu, nu * nu
    out[11], out[12], out[13], out[14] = deep * log_w, math.log(length / height), stiff * stiff, c * log_w
    out[15], out[16], out[17], out[18] = stiff * log_w, c * deep, stiff * deep, c * stiff


POWER_OF_C = (0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 1)
"""of each feature"""
HELD = ("root", "moment", "settled", "inner moment^2", "free moment^2", "inner push", "free push")
"""Weights of what depends on the flap's motion. root: length of flap, over c heights, that bends as much as the
tissue at the jaws gives; moment: share of the moment that the jaws' tangential forces carry, a whole height
apart less c; the others: of the change of the normal force, see `bearing`."""
ROOT, MOMENT, SETTLED = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def grip(flap, vertices, offsets, moduli, x, laws, out):
    """What is kept of the grip at x, m, into out (GRIP,)."""
    found = np.empty(laws.shape[1] - SHAPE)
    for law in range(2):
        features(flap, vertices, offsets, moduli, x, 1.0, laws[law, :SHAPE], found)
        a, b, c = 0.0, 0.0, 0.0
        for i in range(len(found)):
            term = laws[law, SHAPE + i] * found[i]
            if POWER_OF_C[i] == 0:
                a += term
            elif POWER_OF_C[i] == 1:
                b += term
            else:
                c += term
        out[3 * law], out[3 * law + 1], out[3 * law + 2] = a, b, c
    w = flap[JAW_WIDTH] / flap[HEIGHT]
    out[NORMAL] += math.log(w)
    out[WIDTH] = w
    out[PUSH] = flap[POISSON] / 2


@njit(cache=True, nogil=True, error_model="numpy")
def squeeze(kept, c):
    """Normal force, E h d, and eps_1% of the flap squeezed by c on its bed. kept: a row of `grip`."""
    if c <= 0.0:
        return 0.0, 0.0
    return (
        c * math.exp(kept[NORMAL] + kept[NORMAL + 1] * c + kept[NORMAL + 2] * c * c),
        c * math.exp(kept[STRAIN] + kept[STRAIN + 1] * c + kept[STRAIN + 2] * c * c),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def bearing(kept, held, squeezed, inner_moment, free_moment, inner_push, free_push):
    """Normal force, E h d, while the jaws hold the flap in some pose. held: the weights.

    squeezed: that of the squeeze; moments, E h^2 d, and pushes along the flap, E h d, that the jaws do to the part
    towards the fixed end and to the free part.
    """
    change = (
        held[SETTLED + 1] * inner_moment * inner_moment
        + held[SETTLED + 2] * free_moment * free_moment
        + held[SETTLED + 3] * inner_push
        + held[SETTLED + 4] * free_push
    )
    return squeezed * (1.0 + held[SETTLED]) + kept[WIDTH] * change
