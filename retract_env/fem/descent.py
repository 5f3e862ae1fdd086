"""Compiled steps of the equilibrium's solver: L-BFGS and what it does with vectors (see solver.py).

Not BLAS: OpenBLAS starts its threads for vectors as long as these, and they spin on the cores where other
candidates run; and a call of NumPy takes longer than what it does to a small flap. Vectors: u and force (n,)
over all unknowns, q and the rows of `steps` and `changes` (MEMORY, f) over the free ones, whose places in u
are `free` (f,).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.fem.kernels import JIT


@njit(**JIT)
def _dot(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(**JIT)
def before_solving(force, free, steps, changes, curvature, count, weights, q):
    """First half of Nocedal and Wright's algorithm 7.4: what the old factorisation is applied to, into q."""
    for i in range(len(free)):
        q[i] = force[free[i]]
    for k in range(count - 1, -1, -1):
        y = changes[k]
        weight = _dot(steps[k], q) / curvature[k]
        weights[k] = weight
        for i in range(len(q)):
            q[i] -= weight * y[i]


@njit(**JIT)
def after_solving(x, force, free, steps, changes, curvature, count, weights):
    """Second half: x (f,), the old factorisation's solution, becomes the step; returns the force's power
    on it [J], negative where it descends."""
    for k in range(count):
        s = steps[k]
        weight = weights[k] - _dot(changes[k], x) / curvature[k]
        for i in range(len(x)):
            x[i] += weight * s[i]
    slope = 0.0
    for i in range(len(x)):
        x[i] = -x[i]
        slope += force[free[i]] * x[i]
    return slope


@njit(**JIT)
def moved(u, free, step, length):
    """u after a part of a step."""
    out = u.copy()
    for i in range(len(free)):
        out[free[i]] += length * step[i]
    return out


@njit(**JIT)
def norm(force, free):
    """Of the forces on free unknowns [N]."""
    total = 0.0
    for i in range(len(free)):
        total += force[free[i]] * force[free[i]]
    return np.sqrt(total)


@njit(**JIT)
def learn(step, length, before, after, free, steps, changes, curvature, count):
    """Keep a step and the change of force that it made, the oldest one going where there is no room; returns
    how many are kept. One along which the energy is not convex is of no use."""
    product = 0.0
    for i in range(len(free)):
        product += length * step[i] * (after[free[i]] - before[free[i]])
    if not product > 0.0:
        return count
    if count == len(curvature):
        for k in range(1, count):
            steps[k - 1] = steps[k]
            changes[k - 1] = changes[k]
            curvature[k - 1] = curvature[k]
        count -= 1
    s = steps[count]
    y = changes[count]
    for i in range(len(free)):
        s[i] = length * step[i]
        y[i] = after[free[i]] - before[free[i]]
    curvature[count] = product
    return count + 1
