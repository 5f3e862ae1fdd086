"""Principal stretches: what strain is measured from.

They come from the eigenvalues of a symmetric 3x3 matrix in closed form (Smith 1961), which asks for cos and
sin of a third of an angle of known cosine t. With s = sqrt((1 + t) / 2), the cosine of half that angle, the
cosine of its third and its sine over sqrt(1 - s) have no singularity from s = 0 to 1, only at s = -1:
polynomials of degree `DEGREE` give both to rounding, and unlike arccos they leave the loop to vector
instructions.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.fem.kernels import JIT, LANES, gather, gradient

DEGREE = 20
"""The singularity is far enough for an error of 6^-DEGREE."""


def _powers(values):
    """Coefficients of the polynomial in 2 s - 1 through values (DEGREE + 1,) at `_at`."""
    fit = np.polynomial.Chebyshev.fit(2 * _at - 1, values, DEGREE, domain=[-1, 1])
    return fit.convert(kind=np.polynomial.Polynomial).coef


_quarter = (np.arange(DEGREE + 1) + 0.5) * np.pi / (2 * DEGREE + 2)
_at = np.cos(_quarter) ** 2  # Chebyshev's points on [0, 1]
_third = 2 / 3 * np.arccos(_at)
COS_THIRD = _powers(np.cos(_third))
SIN_THIRD = _powers(np.sin(_third) / np.sin(_quarter))


@njit(**JIT)
def principal_stretches(u, gxy, gz, dofs, mix, out):
    """Principal stretches, ascending, where the displacement gradient is the combination mix (nr, nq) of
    those at the points; into `out` (c, nr, 3, LANES)."""
    at = np.empty((gxy.shape[1], 3, 3, LANES))
    flat = np.empty(9 * LANES)
    F = flat.reshape((3, 3, LANES))
    mean = np.empty(LANES)
    size = np.empty(LANES)
    y = np.empty(LANES)
    cos = np.empty(LANES)
    sin = np.empty(LANES)
    ue = np.empty((dofs.shape[1], LANES))
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        for q in range(gxy.shape[1]):
            gradient(ue, gxy[c, q], gz[c, q], at[q])
        for r in range(mix.shape[0]):
            flat[:] = 0.0
            for q in range(mix.shape[1]):
                part = mix[r, q]
                if part != 0.0:
                    add = at[q].ravel()
                    for l in range(9 * LANES):
                        flat[l] += part * add[l]
            low, middle, high = out[c, r]
            for l in range(LANES):
                # C - 1 = H + H^T + H^T H with the displacement gradient H: small strains lose no digits
                c00 = 2.0 * F[0, 0, l] + F[0, 0, l] ** 2 + F[1, 0, l] ** 2 + F[2, 0, l] ** 2
                c11 = 2.0 * F[1, 1, l] + F[0, 1, l] ** 2 + F[1, 1, l] ** 2 + F[2, 1, l] ** 2
                c22 = 2.0 * F[2, 2, l] + F[0, 2, l] ** 2 + F[1, 2, l] ** 2 + F[2, 2, l] ** 2
                c01 = (
                    F[0, 1, l]
                    + F[1, 0, l]
                    + F[0, 0, l] * F[0, 1, l]
                    + F[1, 0, l] * F[1, 1, l]
                    + F[2, 0, l] * F[2, 1, l]
                )
                c02 = (
                    F[0, 2, l]
                    + F[2, 0, l]
                    + F[0, 0, l] * F[0, 2, l]
                    + F[1, 0, l] * F[1, 2, l]
                    + F[2, 0, l] * F[2, 2, l]
                )
                c12 = (
                    F[1, 2, l]
                    + F[2, 1, l]
                    + F[0, 1, l] * F[0, 2, l]
                    + F[1, 1, l] * F[1, 2, l]
                    + F[2, 1, l] * F[2, 2, l]
                )
                m = (c00 + c11 + c22) / 3.0
                a0 = c00 - m
                a1 = c11 - m
                a2 = c22 - m
                p = np.sqrt((a0 * a0 + a1 * a1 + a2 * a2 + 2.0 * (c01 * c01 + c02 * c02 + c12 * c12)) / 6.0)
                det = a0 * (a1 * a2 - c12 * c12) - c01 * (c01 * a2 - c12 * c02) + c02 * (c01 * c12 - a1 * c02)
                mean[l] = m
                size[l] = p
                y[l] = det / (2.0 * p * p * p + 1e-300)
            _thirds(y, cos, sin)
            for l in range(LANES):
                most = mean[l] + 2.0 * size[l] * cos[l]
                least = mean[l] - size[l] * (cos[l] + 1.7320508075688772 * sin[l])
                size[l] = 1.0 + most
                cos[l] = max(1.0 + 3.0 * mean[l] - most - least, 0.0)
                sin[l] = max(1.0 + least, 0.0)
            for l in range(LANES):
                high[l] = np.sqrt(size[l])
                middle[l] = np.sqrt(cos[l])
                low[l] = np.sqrt(sin[l])


@njit(**JIT)
def greatest_strains(stretch, out):
    """max |stretch - 1| of principal stretches (c, nr, 3, LANES) in ascending order, into `out` (m, nr)."""
    for e in range(out.shape[0]):
        c = e // LANES
        l = e % LANES
        for r in range(out.shape[1]):
            out[e, r] = max(abs(stretch[c, r, 2, l] - 1.0), abs(stretch[c, r, 0, l] - 1.0))


@njit(**JIT)
def _thirds(t, cos, sin):
    """Cos and sin of a third of the angles whose cosines are t, which is overwritten; loops that one vector
    instruction can run, each."""
    for l in range(LANES):
        x = min(1.0, max(-1.0, t[l]))
        s = np.sqrt(0.5 + 0.5 * x)
        cos[l] = COS_THIRD[DEGREE]
        sin[l] = SIN_THIRD[DEGREE]
        t[l] = 2.0 * s - 1.0
    for k in range(DEGREE - 1, -1, -1):
        a = COS_THIRD[k]
        b = SIN_THIRD[k]
        for l in range(LANES):
            cos[l] = cos[l] * t[l] + a
            sin[l] = sin[l] * t[l] + b
    for l in range(LANES):
        sin[l] *= np.sqrt(0.5 - 0.5 * t[l])
