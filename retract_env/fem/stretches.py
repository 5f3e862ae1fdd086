"""Principal stretches: what strain is measured from."""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.fem.kernels import JIT, LANES, gather, gradient


@njit(**JIT)
def principal_stretches(u, gxy, gz, dofs, mix, out):
    """Principal stretches, ascending, where the displacement gradient is the combination mix (nr, nq) of
    those at the points; into `out` (c, nr, 3, LANES)."""
    at = np.empty((gxy.shape[1], 3, 3, LANES))
    F = np.empty((3, 3, LANES))
    ue = np.empty((dofs.shape[1], LANES))
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        for q in range(gxy.shape[1]):
            gradient(ue, gxy[c, q], gz[c, q], at[q])
        for r in range(mix.shape[0]):
            F[:] = 0.0
            for q in range(mix.shape[1]):
                part = mix[r, q]
                if part != 0.0:
                    for i in range(3):
                        for j in range(3):
                            for l in range(LANES):
                                F[i, j, l] += part * at[q, i, j, l]
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
                # closed form for the eigenvalues of a symmetric 3x3 matrix (Smith 1961)
                mean = (c00 + c11 + c22) / 3.0
                a0 = c00 - mean
                a1 = c11 - mean
                a2 = c22 - mean
                p = np.sqrt((a0 * a0 + a1 * a1 + a2 * a2 + 2.0 * (c01 * c01 + c02 * c02 + c12 * c12)) / 6.0)
                det = a0 * (a1 * a2 - c12 * c12) - c01 * (c01 * a2 - c12 * c02) + c02 * (c01 * c12 - a1 * c02)
                turn = det / (2.0 * p * p * p) if p > 1e-100 else 0.0
                angle = np.arccos(min(1.0, max(-1.0, turn))) / 3.0
                high = mean + 2.0 * p * np.cos(angle)
                low = mean + 2.0 * p * np.cos(angle + 2.0943951023931953)
                out[c, r, 0, l] = np.sqrt(max(1.0 + low, 0.0))
                out[c, r, 1, l] = np.sqrt(max(1.0 + 3.0 * mean - high - low, 0.0))
                out[c, r, 2, l] = np.sqrt(1.0 + high)
