"""Compiled steps of the equilibrium's solver: L-BFGS and what it does with vectors (see solver.py).

Not BLAS: OpenBLAS starts its threads for vectors as long as these, and they spin on the cores where other
candidates run; and a call of NumPy takes longer than what it does to a small flap. Vectors: u and force (n,)
over all unknowns, q and the rows of `steps` and `changes` (MEMORY, f) over the free ones, whose places in u
are `free` (f,). What is kept of an old factorisation, `steps` and `changes` too, is in the frames in which
the tissue stood then; `turn` says how far it has turned since: (at, cos, sin), places (p,) of u_x in q, of
which u_y is the next, and by what angle (p,) each.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from retract_env.fem.kernels import JIT

Turn = tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]
"""Places (p,) of u_x among the free unknowns, of which u_y is the next; cosine and sine (p,) of angles."""


@njit(**JIT)
def _dot(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(**JIT)
def turns(u, v, rest, triangles, stride, nodes, cos, sin):
    """How far the tissue around each of `nodes` (p,) turns from u to v (n,) m, into `cos` and `sin` (p,).

    rest: (k, 2) m, all nodes of the section; triangles: (m, 6), its elements; stride: unknowns of a node, of
    which the first two are u_x and u_y. The turn of a triangle is that which brings its edges nearest to
    where they are; of a node, the mean of those around it.
    """
    even = np.zeros(len(rest))
    odd = np.zeros(len(rest))
    for t in range(len(triangles)):
        a = triangles[t, 0]
        dot = 0.0
        cross = 0.0
        for k in range(1, 3):
            b = triangles[t, k]
            x = rest[b, 0] - rest[a, 0]
            y = rest[b, 1] - rest[a, 1]
            from_x = x + u[b * stride] - u[a * stride]
            from_y = y + u[b * stride + 1] - u[a * stride + 1]
            to_x = x + v[b * stride] - v[a * stride]
            to_y = y + v[b * stride + 1] - v[a * stride + 1]
            dot += from_x * to_x + from_y * to_y
            cross += from_x * to_y - from_y * to_x
        for k in range(6):
            even[triangles[t, k]] += dot
            odd[triangles[t, k]] += cross
    for i in range(len(nodes)):
        x = even[nodes[i]]
        y = odd[nodes[i]]
        size = np.sqrt(x * x + y * y)
        cos[i] = x / size
        sin[i] = y / size


@njit(**JIT)
def turned(q, turn):
    """Turn q (f,) in place, from the frames of then to those of now."""
    at, cos, sin = turn
    for i in range(len(at)):
        x = q[at[i]]
        y = q[at[i] + 1]
        q[at[i]] = cos[i] * x - sin[i] * y
        q[at[i] + 1] = sin[i] * x + cos[i] * y


@njit(**JIT)
def turned_back(q, turn):
    """The inverse of `turned`."""
    at, cos, sin = turn
    for i in range(len(at)):
        x = q[at[i]]
        y = q[at[i] + 1]
        q[at[i]] = cos[i] * x + sin[i] * y
        q[at[i] + 1] = cos[i] * y - sin[i] * x


@njit(**JIT)
def before_solving(force, free, turn, steps, changes, curvature, count, weights, q):
    """First half of Nocedal and Wright's algorithm 7.4: what the old factorisation is applied to, into q."""
    for i in range(len(free)):
        q[i] = force[free[i]]
    turned_back(q, turn)
    for k in range(count - 1, -1, -1):
        y = changes[k]
        weight = _dot(steps[k], q) / curvature[k]
        weights[k] = weight
        for i in range(len(q)):
            q[i] -= weight * y[i]


@njit(**JIT)
def after_solving(x, force, free, turn, steps, changes, curvature, count, weights):
    """Second half: x (f,), the old factorisation's solution, becomes the step; returns the force's power
    on it [J], negative where it descends."""
    for k in range(count):
        s = steps[k]
        weight = weights[k] - _dot(changes[k], x) / curvature[k]
        for i in range(len(x)):
            x[i] += weight * s[i]
    turned(x, turn)
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
def learn(step, length, before, after, free, turn, steps, changes, curvature, count):
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
    turned_back(s, turn)
    turned_back(y, turn)
    curvature[count] = product
    return count + 1
