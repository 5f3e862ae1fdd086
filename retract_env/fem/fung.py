"""Compiled kernels: what Fung's law adds to the neo-Hookean solid of `kernels`.

The law is an exponential of the whole neo-Hookean energy W0, so that what that leaves free of stress stays
so: W = mu/(2 b) (exp(2 b W0 / mu) - 1). With e = exp(2 b W0 / mu) its stress is e P0. To the energy W - W0 is
added, to the stress (e - 1) P0, and to the tangent, between shape function a in direction i and b in k, with
K = P0 G and g = F^-T G,

    (e - 1) (mu (G_a . G_b) delta_ik + lambda g_a[i] g_b[k] + (mu - lambda ln J) g_a[k] g_b[i])
    + 2 b/mu e K_a[i] K_b[k].

Arrays as in `kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.fem.kernels import (
    JIT,
    LANES,
    add_forces,
    couple_other,
    couple_same,
    deformation,
    divergence,
    gather,
    gradient,
    gram,
    push,
)


@njit(**JIT)
def _stressed(ue, gx, gz, mu, lam, F, H, J, Q):
    """H = F^-T, F becomes P0 and J its logarithm, and Q = 2 W0 / mu, at one point."""
    deformation(ue, gx, gz, F, H, J)
    for l in range(LANES):
        J[l] = np.log(J[l])
        ratio = lam[l] / mu[l] if mu[l] > 0.0 else 0.0  # 0 in lanes that only fill up
        Q[l] = -3.0 - 2.0 * J[l] + ratio * J[l] * J[l]
    for i in range(3):
        for j in range(3):
            f = F[i, j]
            h = H[i, j]
            for l in range(LANES):
                Q[l] += f[l] * f[l]
                f[l] = mu[l] * (f[l] - h[l]) + lam[l] * J[l] * h[l]


@njit(**JIT)
def residual(u, gxy, gz, weight, mu, lam, dofs, b, out):
    """Add the added forces [N] to `out` (n,); returns the added energy [J]. No element is inverted at u."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    J = np.empty(LANES)
    Q = np.empty(LANES)
    ue = np.empty((nd, LANES))
    re = np.empty((nd, LANES))
    energy = 0.0
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        re[:] = 0.0
        for q in range(gxy.shape[1]):
            _stressed(ue, gxy[c, q], gz[c, q], mu[c], lam[c], F, H, J, Q)
            w = weight[c, q]
            for l in range(LANES):
                more = np.expm1(b * Q[l])
                energy += 0.5 * w[l] * mu[c, l] * (more / b - Q[l])
                Q[l] = w[l] * more
            for i in range(3):
                for j in range(3):
                    f = F[i, j]
                    for l in range(LANES):
                        f[l] *= Q[l]
            divergence(F, gxy[c, q], gz[c, q], re)
        add_forces(re, dofs[c], out)
    return energy


@njit(**JIT)
def tangent_times(u, v, gxy, gz, weight, mu, lam, dofs, b, out):
    """Add the added tangent at u applied to v [N] to `out` (n,)."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    D = np.empty((3, 3, LANES))
    J = np.empty(LANES)
    Q = np.empty(LANES)
    ue = np.empty((nd, LANES))
    ve = np.empty((nd, LANES))
    re = np.empty((nd, LANES))
    M = np.empty((3, 3))
    for c in range(gxy.shape[0]):
        gather(v, dofs[c], ve)
        if not ve.any():
            continue
        gather(u, dofs[c], ue)
        re[:] = 0.0
        for q in range(gxy.shape[1]):
            _stressed(ue, gxy[c, q], gz[c, q], mu[c], lam[c], F, H, J, Q)
            gradient(ve, gxy[c, q], gz[c, q], D)
            for l in range(LANES):
                rate = 0.0
                trace = 0.0
                for i in range(3):
                    for j in range(3):
                        rate += F[i, j, l] * D[i, j, l]
                        trace += H[i, j, l] * D[i, j, l]
                        s = 0.0
                        for k in range(3):
                            s += D[k, i, l] * H[k, j, l]
                        M[i, j] = s  # D^T F^-T
                w = weight[c, q, l]
                more = np.expm1(b * Q[l])
                m = w * more * mu[c, l]
                k_ = w * more * lam[c, l]
                d = m - k_ * J[l]
                rate *= 2.0 * b * w * (more + 1.0) / mu[c, l] if mu[c, l] > 0.0 else 0.0
                for i in range(3):
                    for j in range(3):
                        s = 0.0
                        for k in range(3):
                            s += H[i, k, l] * M[k, j]
                        F[i, j, l] = m * D[i, j, l] + k_ * trace * H[i, j, l] + d * s + rate * F[i, j, l]
            divergence(F, gxy[c, q], gz[c, q], re)
        add_forces(re, dofs[c], out)


@njit(**JIT)
def tangent(u, gxy, gz, weight, mu, lam, dofs, b, target, values):
    """Add the added element tangents [N/m] to `values`, see `kernels.tangent`."""
    nq, na = gxy.shape[1], gxy.shape[3]
    nz = gz.shape[3]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    J = np.empty(LANES)
    Q = np.empty(LANES)
    ue = np.empty((dofs.shape[1], LANES))
    spatial_xy = np.empty((nq, 3, na, LANES))  # g
    spatial_z = np.empty((nq, 3, nz, LANES))
    stressed_xy = np.empty((nq, 3, na, LANES))  # K
    stressed_z = np.empty((nq, 3, nz, LANES))
    grown = np.empty((1, nq, LANES))
    wl = np.empty((nq, LANES))
    wc = np.empty((nq, LANES))
    slope = np.empty((nq, LANES))
    none = np.zeros((nq, LANES))
    nothing = np.zeros((na, na, LANES))
    gram_xy = np.empty((1, na, na, LANES))
    gram_z = np.empty((1, nz, nz, LANES))
    rows = np.empty((na, LANES))
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        for q in range(nq):
            _stressed(ue, gxy[c, q], gz[c, q], mu[c], lam[c], F, H, J, Q)
            for l in range(LANES):
                w = weight[c, q, l]
                more = w * np.expm1(b * Q[l])
                grown[0, q, l] = more
                wl[q, l] = more * lam[c, l]
                wc[q, l] = more * mu[c, l] - wl[q, l] * J[l]
                slope[q, l] = 2.0 * b * (w + more) / mu[c, l] if mu[c, l] > 0.0 else 0.0
            push(H, gxy[c, q], spatial_xy[q])
            push(H, gz[c, q], spatial_z[q])
            push(F, gxy[c, q], stressed_xy[q])
            push(F, gz[c, q], stressed_z[q])
        gram(gxy[c : c + 1], grown, mu[c : c + 1], gram_xy)
        gram(gz[c : c + 1], grown, mu[c : c + 1], gram_z)
        slot = 0
        for i in range(3):
            spatial = spatial_xy if i < 2 else spatial_z
            stressed = stressed_xy if i < 2 else stressed_z
            of_state = gram_xy[0] if i < 2 else gram_z[0]
            couple_same(spatial, i, wl, wc, of_state, rows, target[c], slot, values)
            slot = couple_same(stressed, i, slope, none, nothing, rows, target[c], slot, values)
            for k in range(i + 1, 3):
                other = spatial_xy if k < 2 else spatial_z
                couple_other(spatial, other, i, k, wl, wc, rows, target[c], slot, values)
                other = stressed_xy if k < 2 else stressed_z
                slot = couple_other(stressed, other, i, k, slope, none, rows, target[c], slot, values)
