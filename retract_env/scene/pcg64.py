"""NumPy's PCG64 generator, compiled: the very numbers that a `numpy.random.Generator` would draw.

The state is a row of six uint64: state (high and low half), increment (likewise), whether half of a draw is
kept for the next 32-bit number, and that half. Batches hold one row for each flap, (n, 6), so that flaps are
drawn side by side without the interpreter, each from its own seed.

PCG64 is O'Neill's XSL-RR 128/64 (2014). Every kernel changes its row as NumPy changes its own state.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.compilation import forget_old

forget_old()

State = NDArray[np.uint64]
"""(6,), changed in place."""

WORDS = 6
_HIGH, _LOW, _STEP_HIGH, _STEP_LOW, _HAS_HALF, _HALF = range(WORDS)
_MASK = (1 << 64) - 1
FACTOR = 0x2360ED051FC65DA44385DF649FCCF645
"""of each step: state = state * FACTOR + increment, modulo 2^128"""
_FACTOR_HIGH, _FACTOR_LOW = np.uint64(FACTOR >> 64), np.uint64(FACTOR & _MASK)
_LOWER_HALF, _ALL = np.uint64(0xFFFFFFFF), np.uint64(_MASK)
_0, _1, _11, _32, _58, _63, _64 = (np.uint64(k) for k in (0, 1, 11, 32, 58, 63, 64))


def state_of(rng: np.random.Generator) -> State:
    """(6,) where rng stands. Of another bit generator than PCG64: a PCG64 seeded from its next numbers."""
    source = rng.bit_generator
    if not isinstance(source, np.random.PCG64):
        source = np.random.PCG64(rng.integers(2**32, size=4, dtype=np.uint64))
    state = source.state
    words = [state["state"][name] >> shift & _MASK for name in ("state", "inc") for shift in (64, 0)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], dtype=np.uint64)


def give_back(rng: np.random.Generator, row: State) -> None:
    """Let rng go on from row (6,). Another bit generator than PCG64 has gone on already, in `state_of`."""
    if not isinstance(rng.bit_generator, np.random.PCG64):
        return
    words = row.tolist()
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {
            "state": words[_HIGH] << 64 | words[_LOW],
            "inc": words[_STEP_HIGH] << 64 | words[_STEP_LOW],
        },
        "has_uint32": words[_HAS_HALF],
        "uinteger": words[_HALF],
    }


# No fastmath below: every number has to be rounded as NumPy rounds it.
@njit(cache=True, nogil=True)
def _high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """Upper 64 bits of a * b."""
    a_low, a_high, b_low, b_high = a & _LOWER_HALF, a >> _32, b & _LOWER_HALF, b >> _32
    middle = a_high * b_low + (a_low * b_low >> _32)
    other = a_low * b_high + (middle & _LOWER_HALF)
    return a_high * b_high + (middle >> _32) + (other >> _32)


@njit(cache=True, nogil=True)
def next_uint64(row: State) -> np.uint64:
    """The next 64 random bits."""
    high, low = row[_HIGH], row[_LOW]
    high = high * _FACTOR_LOW + low * _FACTOR_HIGH + _high_product(low, _FACTOR_LOW)
    low *= _FACTOR_LOW
    low += row[_STEP_LOW]
    high += row[_STEP_HIGH]
    if low < row[_STEP_LOW]:  # carry
        high += _1
    row[_HIGH], row[_LOW] = high, low
    mixed, turn = high ^ low, high >> _58
    found: np.uint64 = (mixed >> turn) | (mixed << ((_64 - turn) & _63))
    return found


@njit(cache=True, nogil=True)
def next_uint32(row: State) -> np.uint64:
    """Below 2^32. Two come from one draw of 64 bits, the lower half first."""
    if row[_HAS_HALF]:
        row[_HAS_HALF] = _0
        found: np.uint64 = row[_HALF]
        return found
    both = next_uint64(row)
    row[_HAS_HALF], row[_HALF] = _1, both >> _32
    lower: np.uint64 = both & _LOWER_HALF
    return lower


@njit(cache=True, nogil=True)
def random(row: State) -> float:
    """In [0, 1), a multiple of 2^-53."""
    return np.int64(next_uint64(row) >> _11) * (1.0 / 9007199254740992.0)


@njit(cache=True, nogil=True)
def uniform(row: State, low: float, high: float) -> float:
    """The next number, uniform in [low, high)."""
    return float(low + (high - low) * random(row))


@njit(cache=True, nogil=True)
def integers(row: State, low: np.int64, high: np.int64) -> np.int64:
    """Whole number from low to high, both ends included, by Lemire's method (2019)."""
    span = np.uint64(high) - np.uint64(low)
    if span == _0:
        return low
    if span == _ALL:
        return low + np.int64(next_uint64(row))
    if span == _LOWER_HALF:
        return low + np.int64(next_uint32(row))
    wanted = span + _1
    if span < _LOWER_HALF:
        product = next_uint32(row) * wanted
        if (product & _LOWER_HALF) < wanted:
            least = (_LOWER_HALF - span) % wanted
            while (product & _LOWER_HALF) < least:
                product = next_uint32(row) * wanted
        return low + np.int64(product >> _32)
    drawn = next_uint64(row)
    if drawn * wanted < wanted:
        least = (_ALL - span) % wanted
        while drawn * wanted < least:
            drawn = next_uint64(row)
    return low + np.int64(_high_product(drawn, wanted))
