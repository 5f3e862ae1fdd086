"""How a flap comes to rest under its weight: at once, or, where no first guess leads there, part by part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.solver import Equilibrium

Array = NDArray[np.float64]

FIRST_PART, SMALLEST_PART = 0.25, 1 / 4096
"""Of the weight: what is tried first, and below what no part is cut any further; the softest tissue under the
strongest gravity tears under less than a hundredth."""


def come_to_rest(equilibrium: Equilibrium, most: int) -> tuple[Array, Array, float]:
    """Displacements (n,) m and forces (n,) N that hold them, under that part of the weight which could be
    given, 1 for all of it.

    most: iterations for the search part by part.
    """
    model, counts = equilibrium.model, equilibrium.counts
    try:
        return *equilibrium.solve(model.at_rest()), 1.0
    except Diverged:
        pass
    last = counts["iterations"] + most
    u = np.zeros(model.prism.size)
    force, done, part = np.zeros_like(u), 0.0, FIRST_PART
    try:
        while done < 1.0 and part >= SMALLEST_PART and counts["iterations"] <= last:
            share = min(done + part, 1.0)
            model.weigh(share)
            try:
                u, force = equilibrium.solve(u)
            except Diverged:
                part /= 2
                equilibrium.forget()
            else:
                done = share
                part *= 2
    finally:
        model.weigh(1.0)
    return u, force, done
