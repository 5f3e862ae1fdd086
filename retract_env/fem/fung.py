"""Compiled kernels: what Fung's law adds to the neo-Hookean solid of `kernels`.

With I = tr F^T F - 3 - 2 ln J, which is 0 at rest and greater elsewhere, and e = exp(b I) the added energy is
mu/2 ((e - 1)/b - I), its stress mu (e - 1) (F - F^-T), and its tangent, between shape function a in direction
i and b in direction k, with K = (F - F^-T) G and g = F^-T G,

    mu (e - 1) ((G_a . G_b) delta_ik + g_a[k] g_b[i]) + 2 b mu e K_a[i] K_b[k].

Arrays as in `kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from retract_env.fem.kernels import (
    JIT,
    LANES,
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
def _strained(ue, gx, gz, F, H, I):
    """H = F^-T, F becomes F - F^-T, and I, at one point."""
    deformation(ue, gx, gz, F, H, I)
    for l in range(LANES):
        I[l] = -3.0 - 2.0 * np.log(I[l])
    for i in range(3):
        for j in range(3):
            f = F[i, j]
            h = H[i, j]
            for l in range(LANES):
                I[l] += f[l] * f[l]
                f[l] -= h[l]


@njit(**JIT)
def residual(u, gxy, gz, weight, mu, lam, dofs, stiffening, out):  # noqa: ARG001
    """Add the added forces [N] to `out` (n,); returns the added energy [J]. No element is inverted at u."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    I = np.empty(LANES)
    ue = np.empty((nd, LANES))
    re = np.empty((nd, LANES))
    energy = 0.0
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        re[:] = 0.0
        for q in range(gxy.shape[1]):
            _strained(ue, gxy[c, q], gz[c, q], F, H, I)
            for l in range(LANES):
                m = weight[c, q, l] * mu[c, l]
                more = np.expm1(stiffening * I[l])
                energy += 0.5 * m * (more / stiffening - I[l])
                I[l] = m * more
            for i in range(3):
                for j in range(3):
                    f = F[i, j]
                    for l in range(LANES):
                        f[l] *= I[l]
            divergence(F, gxy[c, q], gz[c, q], re)
        for a in range(nd):
            for l in range(LANES):
                out[dofs[c, a, l]] += re[a, l]
    return energy


@njit(**JIT)
def tangent_times(u, v, gxy, gz, weight, mu, lam, dofs, stiffening, out):  # noqa: ARG001
    """Add the added tangent at u applied to v [N] to `out` (n,)."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    D = np.empty((3, 3, LANES))
    I = np.empty(LANES)
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
            _strained(ue, gxy[c, q], gz[c, q], F, H, I)
            gradient(ve, gxy[c, q], gz[c, q], D)
            for l in range(LANES):
                rate = 0.0
                for i in range(3):
                    for j in range(3):
                        rate += F[i, j, l] * D[i, j, l]
                        s = 0.0
                        for k in range(3):
                            s += D[k, i, l] * H[k, j, l]
                        M[i, j] = s  # D^T F^-T
                m = weight[c, q, l] * mu[c, l]
                more = m * np.expm1(stiffening * I[l])
                rate *= 2.0 * stiffening * (m + more)
                for i in range(3):
                    for j in range(3):
                        s = D[i, j, l]
                        for k in range(3):
                            s += H[i, k, l] * M[k, j]
                        F[i, j, l] = more * s + rate * F[i, j, l]
            divergence(F, gxy[c, q], gz[c, q], re)
        for a in range(nd):
            for l in range(LANES):
                out[dofs[c, a, l]] += re[a, l]


@njit(**JIT)
def tangent(u, gxy, gz, weight, mu, lam, dofs, stiffening, target, values):  # noqa: ARG001
    """Add the added element tangents [N/m] to `values`, see `kernels.tangent`."""
    nq, na = gxy.shape[1], gxy.shape[3]
    nz = gz.shape[3]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    I = np.empty(LANES)
    ue = np.empty((dofs.shape[1], LANES))
    spatial_xy = np.empty((nq, 3, na, LANES))  # g
    spatial_z = np.empty((nq, 3, nz, LANES))
    strained_xy = np.empty((nq, 3, na, LANES))  # K
    strained_z = np.empty((nq, 3, nz, LANES))
    grown = np.empty((1, nq, LANES))
    more = np.empty((nq, LANES))
    slope = np.empty((nq, LANES))
    none = np.zeros((nq, LANES))
    nothing = np.zeros((na, na, LANES))
    gram_xy = np.empty((1, na, na, LANES))
    gram_z = np.empty((1, nz, nz, LANES))
    rows = np.empty((na, LANES))
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        for q in range(nq):
            _strained(ue, gxy[c, q], gz[c, q], F, H, I)
            for l in range(LANES):
                w = weight[c, q, l]
                grown[0, q, l] = w * np.expm1(stiffening * I[l])
                more[q, l] = grown[0, q, l] * mu[c, l]
                slope[q, l] = 2.0 * stiffening * (w * mu[c, l] + more[q, l])
            push(H, gxy[c, q], spatial_xy[q])
            push(H, gz[c, q], spatial_z[q])
            push(F, gxy[c, q], strained_xy[q])
            push(F, gz[c, q], strained_z[q])
        gram(gxy[c : c + 1], grown, mu[c : c + 1], gram_xy)
        gram(gz[c : c + 1], grown, mu[c : c + 1], gram_z)
        slot = 0
        for i in range(3):
            spatial = spatial_xy if i < 2 else spatial_z
            strained = strained_xy if i < 2 else strained_z
            constant = gram_xy[0] if i < 2 else gram_z[0]
            couple_same(spatial, i, none, more, constant, rows, target[c], slot, values)
            slot = couple_same(strained, i, slope, none, nothing, rows, target[c], slot, values)
            for k in range(i + 1, 3):
                other = spatial_xy if k < 2 else spatial_z
                couple_other(spatial, other, i, k, none, more, rows, target[c], slot, values)
                other = strained_xy if k < 2 else strained_z
                slot = couple_other(strained, other, i, k, slope, none, rows, target[c], slot, values)
