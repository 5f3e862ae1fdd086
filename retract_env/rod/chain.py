"""A chain of rod elements: residual, tangent and Newton's step, many chains side by side.

The residual is the gradient of the energy, the tangent its second derivative: symmetric, and
block-tridiagonal with blocks of 3 x 3. One sweep from left to right assembles both and eliminates node after
node (L D L'); a second one from right to left gives Newton's step.

The right end is clamped. The left end is clamped too, or free and under a given load.

Layout. `LANES` chains that have nothing to do with each other lie side by side: row r of an array has them at
r LANES ... r LANES + LANES - 1, so that the innermost loops, over lanes, are vectorised. Whatever happens in
one lane changes no bit in another, and lanes that are done stay as they are.
"""

from __future__ import annotations

from numba import njit

from retract_env.rod.mechanics import (
    CONTRACT,
    blocked,
    energy,
    gradient,
    hessian,
    resting,
    sine_cosine,
    strains,
)

LANES = 16
"""Chains side by side. LLVM vectorises loops of fewer rounds only where it can prove that no two arrays
overlap."""

# Rows of a chain's parameters
LENGTH, WEIGHT, BED, BLOCK, SLACK, LOAD = 0, 1, 2, 3, 4, 5
"""Of an element, h; per length; stiffness of bed and block per length; b of `mechanics`; force (2) and moment
at a free end."""
STIFFNESS = 8
"""A, B, D and G of element e are in rows STIFFNESS + 4 e and following."""

# Rows of the scratch array
ENERGY, WORST, PIVOTS, SLOPE, LARGEST = 0, 1, 2, 3, 4
"""Energy; largest component of the residual; pivots that were not positive; residual times Newton's step;
largest turn of a node in it."""
LEFT, RIGHT = 5, 8
"""What holds the clamped ends: force (2) and moment on the chain."""
CARRY = 11
"""What the elements so far leave to the next node: 6 of the tangent, 3 right-hand sides, 3 residuals."""
ELEMENT = 23
"""Of the element at hand: tangent 6 + 9 + 6, residual 3 + 3."""
STEP = 50
"""Newton's step of the node at hand."""
SCRATCH = 53
"""All rows of it."""

# Rows of the factors, for each node: 3 of L, 9 of D^-1 L^-1 C, 3 right-hand sides, 3 residuals, 3 of D^-1 or,
# later, Newton's step
PER_NODE = 21

LEAST_PIVOT = 1e-8
"""Pivots of stable chains are above 1e-3. Smaller ones are turned positive, which makes the step lead down,
and the chain is not in a stable equilibrium."""


def parameters_rows(elements: int) -> int:
    """Rows of a chain's parameters."""
    return STIFFNESS + 4 * elements


def factor_rows(elements: int) -> int:
    """Rows of the factors; the last ones keep where `equilibrate` starts from."""
    return (PER_NODE + 3) * (elements + 1)


@njit(error_model="numpy")
def _rows(array, first, count):
    """Some rows of an array: indices into it are known not to be negative, which vectorised loops need."""
    return array[first * LANES : (first + count) * LANES]


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def sweep(P, U, W, Z, count, clamped):
    """Residual and eliminated tangent at U; energy, worst residual, pivots and the clamped ends' reactions.

    P, U: rows of parameters and of 3 (count + 1) unknowns, x, y, theta a node; W, Z: scratch rows and
    factors, which come out; count: elements; clamped: whether the left end is.
    """
    for r in range(CARRY + 12):
        if r != SLOPE and r != LARGEST:
            for l in range(LANES):
                W[r * LANES + l] = 0.0
    if not clamped:
        for k in range(3):
            for l in range(LANES):
                load = P[(LOAD + k) * LANES + l]
                W[(CARRY + 6 + k) * LANES + l] = load
                W[(CARRY + 9 + k) * LANES + l] = -load
                W[ENERGY * LANES + l] -= load * U[k * LANES + l]
    for e in range(count):
        _element(P, U, W, e)
        if e == 0 and clamped:
            for k in range(6):
                for l in range(LANES):
                    W[(CARRY + k) * LANES + l] = W[(ELEMENT + 15 + k) * LANES + l]
            for k in range(3):
                for l in range(LANES):
                    f = W[(ELEMENT + 24 + k) * LANES + l]
                    W[(LEFT + k) * LANES + l] = W[(ELEMENT + 21 + k) * LANES + l]
                    W[(CARRY + 6 + k) * LANES + l] = -f
                    W[(CARRY + 9 + k) * LANES + l] = f
        else:
            # functions of few rows each: LLVM does not vectorise loops that touch too many
            _push(P, U, W, e)
            _factorise(W, Z, e)
            _pass_on(W, Z, e)
    for k in range(3):
        for l in range(LANES):
            W[(RIGHT + k) * LANES + l] = W[(CARRY + 9 + k) * LANES + l]


@njit(fastmath=CONTRACT, error_model="numpy")
def _element(P, U, W, e):
    """Tangent and residual of one element, weight included."""
    S, V = _rows(P, STIFFNESS + 4 * e, 4), _rows(U, 3 * e, 6)
    for l in range(LANES):
        length, weight, b = P[LENGTH * LANES + l], P[WEIGHT * LANES + l], P[SLACK * LANES + l]
        A, B, D, G = S[l], S[l + LANES], S[l + 2 * LANES], S[l + 3 * LANES]
        x0, y0, t0 = V[l], V[l + LANES], V[l + 2 * LANES]
        x1, y1, t1 = V[l + 3 * LANES], V[l + 4 * LANES], V[l + 5 * LANES]
        per = 1.0 / length
        s, c = sine_cosine(0.5 * (t0 + t1))
        stretch, shear = strains((x1 - x0) * per, (y1 - y0) * per, s, c)
        bend = (t1 - t0) * per
        fx, fy, turn, M = gradient(stretch, shear, bend, s, c, A, B, D, G, b)
        xx, xy, yy, xt, yt, tt, xk, yk, tk, kk = hessian(stretch, shear, bend, s, c, A, B, D, G, b)
        W[ENERGY * LANES + l] += length * (
            energy(stretch, shear, bend, A, B, D, G, b) + 0.5 * weight * (y0 + y1)
        )
        w = ELEMENT * LANES + l
        xx, xy, yy, xt, yt = xx * per, xy * per, yy * per, 0.5 * xt, 0.5 * yt
        xk, yk, tt, kk = xk * per, yk * per, 0.25 * length * tt, kk * per
        # first node with itself: xx xy xt yy yt tt
        W[w] = xx
        W[w + LANES] = xy
        W[w + 2 * LANES] = xk - xt
        W[w + 3 * LANES] = yy
        W[w + 4 * LANES] = yk - yt
        W[w + 5 * LANES] = tt - tk + kk
        # first node (rows) with the second
        W[w + 6 * LANES] = -xx
        W[w + 7 * LANES] = -xy
        W[w + 8 * LANES] = -xk - xt
        W[w + 9 * LANES] = -xy
        W[w + 10 * LANES] = -yy
        W[w + 11 * LANES] = -yk - yt
        W[w + 12 * LANES] = xt - xk
        W[w + 13 * LANES] = yt - yk
        W[w + 14 * LANES] = tt - kk
        # second node with itself
        W[w + 15 * LANES] = xx
        W[w + 16 * LANES] = xy
        W[w + 17 * LANES] = xk + xt
        W[w + 18 * LANES] = yy
        W[w + 19 * LANES] = yk + yt
        W[w + 20 * LANES] = tt + tk + kk
        half = 0.5 * length
        W[w + 21 * LANES] = -fx
        W[w + 22 * LANES] = half * weight - fy
        W[w + 23 * LANES] = half * turn - M
        W[w + 24 * LANES] = fx
        W[w + 25 * LANES] = half * weight + fy
        W[w + 26 * LANES] = half * turn + M


@njit(fastmath=CONTRACT, error_model="numpy")
def _push(P, U, W, node):
    """Add what bed and block do to a node to the element at hand, its second one."""
    share = 0.5 if node == 0 else 1.0  # of an element's length that belongs to the node
    V = _rows(U, 3 * node, 3)
    near = 0
    for l in range(LANES):
        near += 1 if V[l] > -0.5 else 0
    for l in range(LANES):
        length, w = share * P[LENGTH * LANES + l], ELEMENT * LANES + l
        s, c = sine_cosine(V[l + 2 * LANES])
        pushed, gy, gt, yy, yt, tt = resting(V[l + LANES], s, c, P[BED * LANES + l])
        W[ENERGY * LANES + l] += length * pushed
        W[w + 3 * LANES] += length * yy
        W[w + 4 * LANES] += length * yt
        W[w + 5 * LANES] += length * tt
        W[w + 22 * LANES] += length * gy
        W[w + 23 * LANES] += length * gt
    if near == 0:
        return
    for l in range(LANES):
        length, w = share * P[LENGTH * LANES + l], ELEMENT * LANES + l
        s, c = sine_cosine(V[l + 2 * LANES])
        pushed, gx, gy, gt, xx, yy, xt, yt, tt = blocked(V[l], V[l + LANES], s, c, P[BLOCK * LANES + l])
        W[ENERGY * LANES + l] += length * pushed
        W[w] += length * xx
        W[w + 2 * LANES] += length * xt
        W[w + 3 * LANES] += length * yy
        W[w + 4 * LANES] += length * yt
        W[w + 5 * LANES] += length * tt
        W[w + 21 * LANES] += length * gx
        W[w + 22 * LANES] += length * gy
        W[w + 23 * LANES] += length * gt


@njit(fastmath=CONTRACT, error_model="numpy")
def _factorise(W, Z, node):
    """The node's pivots and right-hand side, once all that acts on it is known."""
    F = _rows(Z, PER_NODE * node, PER_NODE)
    for l in range(LANES):
        w, k = ELEMENT * LANES + l, CARRY * LANES + l
        d11, d12, d13 = W[k] + W[w], W[k + LANES] + W[w + LANES], W[k + 2 * LANES] + W[w + 2 * LANES]
        d22, d23 = W[k + 3 * LANES] + W[w + 3 * LANES], W[k + 4 * LANES] + W[w + 4 * LANES]
        d33 = W[k + 5 * LANES] + W[w + 5 * LANES]
        f1, f2, f3 = W[w + 21 * LANES], W[w + 22 * LANES], W[w + 23 * LANES]
        g1, g2, g3 = W[k + 9 * LANES] + f1, W[k + 10 * LANES] + f2, W[k + 11 * LANES] + f3
        r1, r2, r3 = W[k + 6 * LANES] - f1, W[k + 7 * LANES] - f2, W[k + 8 * LANES] - f3
        W[WORST * LANES + l] = max(W[WORST * LANES + l], max(abs(g1), max(abs(g2), abs(g3))))
        changed = 0.0 if d11 > LEAST_PIVOT else 1.0
        d11 = max(abs(d11), LEAST_PIVOT)
        i1 = 1.0 / d11
        l21, l31 = d12 * i1, d13 * i1
        d22 -= l21 * d12
        changed += 0.0 if d22 > LEAST_PIVOT else 1.0
        d22 = max(abs(d22), LEAST_PIVOT)
        i2 = 1.0 / d22
        u23 = d23 - l21 * d13
        l32 = u23 * i2
        d33 -= l31 * d13 + l32 * u23
        changed += 0.0 if d33 > LEAST_PIVOT else 1.0
        d33 = max(abs(d33), LEAST_PIVOT)
        i3 = 1.0 / d33
        W[PIVOTS * LANES + l] += changed

        r2 -= l21 * r1
        r3 -= l31 * r1 + l32 * r2
        F[l] = l21
        F[l + LANES] = l31
        F[l + 2 * LANES] = l32
        F[l + 12 * LANES] = r1 * i1
        F[l + 13 * LANES] = r2 * i2
        F[l + 14 * LANES] = r3 * i3
        F[l + 15 * LANES] = g1
        F[l + 16 * LANES] = g2
        F[l + 17 * LANES] = g3
        F[l + 18 * LANES] = i1
        F[l + 19 * LANES] = i2
        F[l + 20 * LANES] = i3


@njit(fastmath=CONTRACT, error_model="numpy")
def _pass_on(W, Z, node):
    """Take a node out of the equations of the next one."""
    F = _rows(Z, PER_NODE * node, PER_NODE)
    for l in range(LANES):
        w, k = ELEMENT * LANES + l, CARRY * LANES + l
        l21, l31, l32 = F[l], F[l + LANES], F[l + 2 * LANES]
        r1, r2, r3 = F[l + 12 * LANES], F[l + 13 * LANES], F[l + 14 * LANES]
        i1, i2, i3 = F[l + 18 * LANES], F[l + 19 * LANES], F[l + 20 * LANES]
        w11, w12, w13 = W[w + 6 * LANES], W[w + 7 * LANES], W[w + 8 * LANES]
        w21 = W[w + 9 * LANES] - l21 * w11
        w22 = W[w + 10 * LANES] - l21 * w12
        w23 = W[w + 11 * LANES] - l21 * w13
        w31 = W[w + 12 * LANES] - l31 * w11 - l32 * w21
        w32 = W[w + 13 * LANES] - l31 * w12 - l32 * w22
        w33 = W[w + 14 * LANES] - l31 * w13 - l32 * w23
        z11, z12, z13 = w11 * i1, w12 * i1, w13 * i1
        z21, z22, z23 = w21 * i2, w22 * i2, w23 * i2
        z31, z32, z33 = w31 * i3, w32 * i3, w33 * i3

        W[k] = W[w + 15 * LANES] - w11 * z11 - w21 * z21 - w31 * z31
        W[k + LANES] = W[w + 16 * LANES] - w11 * z12 - w21 * z22 - w31 * z32
        W[k + 2 * LANES] = W[w + 17 * LANES] - w11 * z13 - w21 * z23 - w31 * z33
        W[k + 3 * LANES] = W[w + 18 * LANES] - w12 * z12 - w22 * z22 - w32 * z32
        W[k + 4 * LANES] = W[w + 19 * LANES] - w12 * z13 - w22 * z23 - w32 * z33
        W[k + 5 * LANES] = W[w + 20 * LANES] - w13 * z13 - w23 * z23 - w33 * z33
        h1, h2, h3 = W[w + 24 * LANES], W[w + 25 * LANES], W[w + 26 * LANES]
        W[k + 6 * LANES] = -h1 - w11 * r1 - w21 * r2 - w31 * r3
        W[k + 7 * LANES] = -h2 - w12 * r1 - w22 * r2 - w32 * r3
        W[k + 8 * LANES] = -h3 - w13 * r1 - w23 * r2 - w33 * r3
        W[k + 9 * LANES] = h1
        W[k + 10 * LANES] = h2
        W[k + 11 * LANES] = h3

        F[l + 3 * LANES] = z11
        F[l + 4 * LANES] = z12
        F[l + 5 * LANES] = z13
        F[l + 6 * LANES] = z21
        F[l + 7 * LANES] = z22
        F[l + 8 * LANES] = z23
        F[l + 9 * LANES] = z31
        F[l + 10 * LANES] = z32
        F[l + 11 * LANES] = z33


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def newton_step(W, Z, count, clamped):
    """Newton's step into each node's rows, how far it turns a node at most, how steeply it leads down."""
    for k in range(3):
        for l in range(LANES):
            W[(STEP + k) * LANES + l] = 0.0
    for l in range(LANES):
        W[LARGEST * LANES + l] = 0.0
        W[SLOPE * LANES + l] = 0.0
    for node in range(count - 1, (1 if clamped else 0) - 1, -1):
        F = _rows(Z, PER_NODE * node, PER_NODE)
        for l in range(LANES):
            a, b, c = W[STEP * LANES + l], W[(STEP + 1) * LANES + l], W[(STEP + 2) * LANES + l]
            v1 = F[l + 12 * LANES] - F[l + 3 * LANES] * a - F[l + 4 * LANES] * b - F[l + 5 * LANES] * c
            v2 = F[l + 13 * LANES] - F[l + 6 * LANES] * a - F[l + 7 * LANES] * b - F[l + 8 * LANES] * c
            v3 = F[l + 14 * LANES] - F[l + 9 * LANES] * a - F[l + 10 * LANES] * b - F[l + 11 * LANES] * c
            v2 -= F[l + 2 * LANES] * v3
            v1 -= F[l] * v2 + F[l + LANES] * v3
            F[l + 18 * LANES] = W[STEP * LANES + l] = v1
            F[l + 19 * LANES] = W[(STEP + 1) * LANES + l] = v2
            F[l + 20 * LANES] = W[(STEP + 2) * LANES + l] = v3
            W[SLOPE * LANES + l] += F[l + 15 * LANES] * v1 + F[l + 16 * LANES] * v2 + F[l + 17 * LANES] * v3
            W[LARGEST * LANES + l] = max(W[LARGEST * LANES + l], abs(v3))


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def total_energy(P, U, count, clamped, out):
    """Energy of each lane into out (LANES,), as `sweep` finds it."""
    for l in range(LANES):
        out[l] = 0.0
    if not clamped:
        for k in range(3):
            for l in range(LANES):
                out[l] -= P[(LOAD + k) * LANES + l] * U[k * LANES + l]
    for e in range(count):
        share = 0.5 if e == 0 else 1.0
        touched = 0.0 if e == 0 and clamped else share
        S, V = _rows(P, STIFFNESS + 4 * e, 4), _rows(U, 3 * e, 6)
        for l in range(LANES):
            length, weight = P[LENGTH * LANES + l], P[WEIGHT * LANES + l]
            x0, y0, t0 = V[l], V[l + LANES], V[l + 2 * LANES]
            x1, y1, t1 = V[l + 3 * LANES], V[l + 4 * LANES], V[l + 5 * LANES]
            per = 1.0 / length
            s, c = sine_cosine(0.5 * (t0 + t1))
            stretch, shear = strains((x1 - x0) * per, (y1 - y0) * per, s, c)
            A, B, D, G = S[l], S[l + LANES], S[l + 2 * LANES], S[l + 3 * LANES]
            inner = energy(stretch, shear, (t1 - t0) * per, A, B, D, G, P[SLACK * LANES + l])
            s, c = sine_cosine(t0)
            pushed = resting(y0, s, c, P[BED * LANES + l])[0] + blocked(x0, y0, s, c, P[BLOCK * LANES + l])[0]
            out[l] += length * (inner + 0.5 * weight * (y0 + y1) + touched * pushed)
