"""NumPy's normal numbers, compiled: the ziggurat method of Marsaglia and Tsang (2000) on a row of `pcg64`.

256 layers of equal area lie under exp(-x^2 / 2), numbered from the tail (0) and the top (1) down; layer i
reaches to x_i. NumPy's own reach was once computed in rounded arithmetic, so it is asked here: a generator's
state can be chosen so that its next numbers are any, and each layer's smallest step tells how wide it is.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.scene.pcg64 import FACTOR, State, next_uint64, random

_LAYERS, _STEPS = 256, 2.0**52
_0, _1, _8, _9, _255 = (np.uint64(k) for k in (0, 1, 8, 9, 255))
_MANTISSA = np.uint64(2**52 - 1)


def _asked_widths() -> NDArray[np.float64]:
    """(256,): by how much NumPy's normal numbers differ in each layer, x_i / 2^52."""
    source = np.random.PCG64(0)
    rng, turned = np.random.Generator(source), 2**128
    back = pow(FACTOR, -1, turned)
    widths = []
    for layer in range(_LAYERS):
        drawn = layer | 1 << 9  # one step to the right of 0; then 0, which accepts it in layer 1 too
        increment = -drawn * FACTOR % turned
        state = (drawn - increment) * back % turned
        source.state = {
            "bit_generator": "PCG64",
            "state": {"state": state, "inc": increment},
            "has_uint32": 0,
            "uinteger": 0,
        }
        widths.append(rng.standard_normal())
    return np.array(widths)


_WIDTH = _asked_widths()
_END = float(_WIDTH[-1] * _STEPS)  # 3.65, where the tail begins
_INVERSE_END = 1 / _END
# A step below these lies in the layer whatever its height: under the layer above. Nothing lies above the top.
_WITHIN = np.rint(np.roll(_WIDTH, 1) / _WIDTH * _STEPS).astype(np.uint64)
_WITHIN[1] = 0
_DENSITY = np.array([1.0, *(math.exp(-0.5 * (width * _STEPS) ** 2) for width in _WIDTH[1:].tolist())])


@njit(cache=True, nogil=True)
def standard_normal(row: State) -> float:
    """The next number, normal with mean 0 and deviation 1."""
    while True:
        drawn = next_uint64(row)
        layer, steps = np.int64(drawn & _255), (drawn >> _9) & _MANTISSA
        x = np.int64(steps) * _WIDTH[layer]
        if (drawn >> _8) & _1:
            x = -x
        if steps < _WITHIN[layer]:
            return float(x)
        if layer == 0:
            while True:
                beyond = -_INVERSE_END * math.log1p(-random(row))
                height = -math.log1p(-random(row))
                if height + height > beyond * beyond:
                    return -(_END + beyond) if (steps >> _8) & _1 else _END + beyond
        height = (_DENSITY[layer - 1] - _DENSITY[layer]) * random(row) + _DENSITY[layer]
        if height < math.exp(-0.5 * x * x):
            return float(x)
