"""What the jaws' grip does to the tissue between them: laws fitted to squeezes on fine finite elements.

The rod knows no squeeze. How hard the tissue presses back, and how much it is strained, depends on the tissue
within a jaw's width or so: its k_eq there, the flap's ends if near, its depth, the jaws' width. Both are laws

    log (N / (E w d c)) and log (eps_1% / c) = sum of weights times features

where c is the compression over the height, w the jaws' width, d the flap's depth. `grip.json` has the
weights; `python -m benchmarks.rod_grip` makes it and says how well they fit.

While the flap moves, N changes with what the rod transmits on both sides of the jaws: tissue that is pushed
along the flap is thicker, bent tissue thinner. The same file has these weights.

Pressed tissue is pushed out of the jaws, to both sides. By how much follows from Betti's theorem: along the
flap a force F thins it by nu F / (E d), so that a pair of forces N across it lengthens it by nu N / (E d),
half on each side.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.rod.flap import DEPTH, HAS_BED, HEIGHT, JAW_WIDTH, LENGTH_M, MODULUS, POISSON
from retract_env.spring.columns import columns

Array = NDArray[np.float64]

FITTED = Path(__file__).with_name("grip.json")
PLACES, APART = 25, 0.1
"""Where k_eq is looked at: so many places, so many heights apart, around the jaws."""
DEEP = 2.0
"""Depth over height of a flap half way from narrow to deep."""
FEATURES = (
    "one", "stiffness", "c", "c^2", "free end", "fixed end", "log w", "(log w)^2", "deep nu^2", "nu^2",
    "deep log w", "log L", "c log w", "stiffness log w", "c stiffness",
)  # fmt: skip
SHAPE = 4
"""Numbers of a law before its weights: decay of the kernel over k_eq, heights; share of half a jaw's width
that counts in full; decay of what the free and the fixed end do, heights."""

# What is kept of a grip, as a row of numbers: log of the normal force over c E h d, and of eps_1% over c,
# each as p + q c + r c^2; by how much tissue is pushed out to each side, heights; c; 1 on a bed; E h d, the
# force that the jaws hold by, 0 where they hold by c; the c that the chains are made for
NORMAL, STRAIN, PUSH, COMPRESSION, ON_BED, FORCE, MADE_FOR = 0, 3, 6, 7, 8, 9, 10
GRIP = 11


def load() -> tuple[Array, Array]:
    """Both laws (2, SHAPE + features), of the normal force and of strain, and the weights of `held` (7,)."""
    data = json.loads(FITTED.read_text("utf-8"))
    laws = [[*data[name]["shape"], *data[name]["weights"]] for name in ("normal", "strain")]
    return np.array(laws), np.array(data["held"]["weights"])


@njit(cache=True, nogil=True, error_model="numpy")
def compliances(flap, vertices, offsets, moduli, x, out):
    """Compliance of the columns around x, m, over that of plain tissue, into out (PLACES,); at the flap's
    ends that of the last column goes on. flap: numbers as `retract_env.rod.flap` has them."""
    height, length = flap[HEIGHT], flap[LENGTH_M]
    at = np.empty(PLACES)
    for i in range(PLACES):
        place = x + (i - PLACES // 2) * APART * height
        at[i] = min(max(place, -length), 0.0)
    columns(length, height, flap[MODULUS], vertices, offsets, moduli, at, out)
    for i in range(PLACES):
        out[i] = flap[MODULUS] / (height * out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def features(flap, around, x, c, shape, out):
    """FEATURES of a squeeze by c at x, m, into out. around: of `compliances`."""
    height, length = flap[HEIGHT], flap[LENGTH_M]
    w, d, nu = flap[JAW_WIDTH] / height, flap[DEPTH] / height, flap[POISSON]
    total, compliance = 0.0, 0.0
    for i in range(PLACES):
        beyond = max(abs(i - PLACES // 2) * APART - shape[1] * w / 2, 0.0)
        weight = math.exp(-beyond / shape[0])
        total += weight
        compliance += weight * around[i]
    stiff = -math.log(compliance / total)
    deep = d * d / (d * d + DEEP * DEEP)
    log_w = math.log(w)
    out[0], out[1], out[2], out[3] = 1.0, stiff, c, c * c
    out[4] = math.exp(-(length + x) / height / shape[2])
    out[5] = math.exp(x / height / shape[3])
    out[6], out[7], out[8], out[9] = log_w, log_w * log_w, deep * nu * nu, nu * nu
    out[10], out[11], out[12] = deep * log_w, math.log(length / height), c * log_w
    out[13], out[14] = stiff * log_w, c * stiff


POWER_OF_C = (0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1)
"""of each feature"""
HELD = ("root", "stiff", "pushed", "free moment", "settled", "moment^2", "push")
"""Weights of what depends on the flap's motion. root, stiff: the tissue at the jaws gives as much as a length
of flap, root c - stiff heights, bends: it is held by its surfaces, but for some length not free to bend;
pushed: part of nu N / 2 by which it is pushed out of the jaws; free moment: share of the free part's moment
that reaches the jaws' tangential forces; the others: of the normal force, see `bearing`."""
ROOT, STIFF, PUSHED, FREE_MOMENT, SETTLED, THINNED, PUSHING = range(7)


@njit(cache=True, nogil=True, error_model="numpy")
def grip(flap, vertices, offsets, moduli, x, laws, out):
    """What is kept of the grip at x, m, into out (GRIP,)."""
    found, around = np.empty(laws.shape[1] - SHAPE), np.empty(PLACES)
    compliances(flap, vertices, offsets, moduli, x, around)
    for law in range(2):
        features(flap, around, x, 1.0, laws[law, :SHAPE], found)
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
    out[NORMAL] += math.log(flap[JAW_WIDTH] / flap[HEIGHT])
    out[PUSH] = out[FORCE] = 0.0
    out[ON_BED] = flap[HAS_BED]


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
def pushed_out(flap, kept, c, held):
    """By how much tissue that is squeezed by c is pushed out to each side, heights."""
    return held[PUSHED] * flap[POISSON] / 2 * c * math.exp(kept[NORMAL])


@njit(cache=True, nogil=True, error_model="numpy")
def root_of(c, held):
    """Length of flap, heights, that bends as much as the tissue at the jaws gives that are closed by c."""
    return max(held[ROOT] * c - held[STIFF], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def bearing(kept, held, inner_moment, free_moment, push):
    """Normal force, E h d, while the jaws hold the flap in some pose. kept: a row of `grip`; held: weights.

    moments, E h^2 d: that the jaws do to both parts; push, E h d: along the flap, to the part towards the
    fixed end less that to the free one. Pushed tissue is thicker, by Poisson's ratio, and bent tissue
    thinner, by its square; the grip is the firmer for it as if the jaws were closed by as much.
    """
    c = kept[COMPRESSION]
    thicker = held[THINNED] * (inner_moment * inner_moment + free_moment * free_moment) + held[PUSHING] * push
    log = kept[NORMAL] + kept[NORMAL + 1] * c + kept[NORMAL + 2] * c * c
    slope = math.exp(log) * (1.0 + c * (kept[NORMAL + 1] + 2.0 * kept[NORMAL + 2] * c))
    return c * math.exp(log) * (1.0 + held[SETTLED]) + slope * thicker
