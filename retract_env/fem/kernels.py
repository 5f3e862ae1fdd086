"""Compiled kernels: energy, residual, tangent and strain of the logarithmic neo-Hookean solid.

The material is W(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2, whose first Piola-Kirchhoff stress is
P = mu F + (lambda ln J - mu) F^-T. With the spatial gradients g = F^-T G of the shape functions its tangent is,
between shape function a in direction i and b in direction k,

    mu (G_a . G_b) delta_ik + lambda g_a[i] g_b[k] + (mu - lambda ln J) g_a[k] g_b[i],

so no fourth-order tensor is ever formed. The mu term does not depend on the state.

One element has `na` shape functions for u_x and for u_y and `nz` for u_z (see elements.py), hence 2 na + nz unknowns in the order
x..., y..., z.... Arrays of an element block: gxy (ne, nq, 3, na) and gz (ne, nq, 3, nz) reference gradients [1/m], weight (ne, nq)
rest volumes [m^3], mu and lam (ne,) [Pa], dofs (ne, 2 na + nz) positions in the vector of all unknowns. The number of points nq is a multiple of
three: the tangent takes three points at a time, which lets the compiler keep its inner loop in vector registers (2.5 times faster).
"""

from __future__ import annotations

import numpy as np
from numba import njit

JIT = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}


@njit(inline="always", **JIT)
def _deformation_gradient(u, gx, gz, na, nz, F):
    """F = 1 + sum u grad N at one point; returns J = det F."""
    for j in range(3):
        fx = 0.0
        fy = 0.0
        fz = 0.0
        for a in range(na):
            fx += u[a] * gx[j, a]
            fy += u[na + a] * gx[j, a]
        for a in range(nz):
            fz += u[2 * na + a] * gz[j, a]
        F[0, j] = fx
        F[1, j] = fy
        F[2, j] = fz
    F[0, 0] += 1.0
    F[1, 1] += 1.0
    F[2, 2] += 1.0
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit(inline="always", **JIT)
def _inverse_transpose(F, J, H):
    """H = F^-T, so that g[i] = sum_j H[i, j] G[j]."""
    r = 1.0 / J
    H[0, 0] = (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1]) * r
    H[0, 1] = (F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2]) * r
    H[0, 2] = (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0]) * r
    H[1, 0] = (F[0, 2] * F[2, 1] - F[0, 1] * F[2, 2]) * r
    H[1, 1] = (F[0, 0] * F[2, 2] - F[0, 2] * F[2, 0]) * r
    H[1, 2] = (F[0, 1] * F[2, 0] - F[0, 0] * F[2, 1]) * r
    H[2, 0] = (F[0, 1] * F[1, 2] - F[0, 2] * F[1, 1]) * r
    H[2, 1] = (F[0, 2] * F[1, 0] - F[0, 0] * F[1, 2]) * r
    H[2, 2] = (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]) * r


@njit(**JIT)
def residual(u, gxy, gz, weight, mu, lam, dofs, out):
    """Add the internal forces [N] to `out` (n,); returns the energy [J], inf where an element is inverted."""
    ne, nq, _, na = gxy.shape
    nz = gz.shape[3]
    F = np.empty((3, 3))
    H = np.empty((3, 3))
    ue = np.empty(2 * na + nz)
    re = np.empty(2 * na + nz)
    energy = 0.0
    for e in range(ne):
        for a in range(ue.size):
            ue[a] = u[dofs[e, a]]
            re[a] = 0.0
        for q in range(nq):
            gx = gxy[e, q]
            gw = gz[e, q]
            J = _deformation_gradient(ue, gx, gw, na, nz, F)
            if not J > 0.0:
                return np.inf
            _inverse_transpose(F, J, H)
            log_j = np.log(J)
            w = weight[e, q]
            square = 0.0
            for i in range(3):
                for j in range(3):
                    square += F[i, j] * F[i, j]
            energy += w * (0.5 * mu[e] * (square - 3.0) - mu[e] * log_j + 0.5 * lam[e] * log_j * log_j)
            wm = w * mu[e]
            wp = w * (lam[e] * log_j - mu[e])
            for i in range(3):
                for j in range(3):
                    F[i, j] = wm * F[i, j] + wp * H[i, j]
            for a in range(na):
                re[a] += F[0, 0] * gx[0, a] + F[0, 1] * gx[1, a] + F[0, 2] * gx[2, a]
                re[na + a] += F[1, 0] * gx[0, a] + F[1, 1] * gx[1, a] + F[1, 2] * gx[2, a]
            for a in range(nz):
                re[2 * na + a] += F[2, 0] * gw[0, a] + F[2, 1] * gw[1, a] + F[2, 2] * gw[2, a]
        for a in range(re.size):
            out[dofs[e, a]] += re[a]
    return energy


@njit(**JIT)
def tangent_times(u, v, gxy, gz, weight, mu, lam, dofs, out):
    """Add the tangent at u applied to v [N] to `out` (n,), without assembling it."""
    ne, nq, _, na = gxy.shape
    nz = gz.shape[3]
    F = np.empty((3, 3))
    H = np.empty((3, 3))
    D = np.empty((3, 3))
    M = np.empty((3, 3))
    nd = 2 * na + nz
    ue = np.empty(nd)
    ve = np.empty(nd)
    for e in range(ne):
        still = True
        for a in range(nd):
            ue[a] = u[dofs[e, a]]
            ve[a] = v[dofs[e, a]]
            still = still and ve[a] == 0.0
        if still:
            continue
        for q in range(nq):
            gx = gxy[e, q]
            gw = gz[e, q]
            J = _deformation_gradient(ue, gx, gw, na, nz, F)
            _deformation_gradient(ve, gx, gw, na, nz, D)
            for i in range(3):
                D[i, i] -= 1.0
            _inverse_transpose(F, J, H)
            trace = 0.0
            for i in range(3):
                for j in range(3):
                    trace += H[i, j] * D[i, j]
                    s = 0.0
                    for k in range(3):
                        s += D[k, i] * H[k, j]
                    M[i, j] = s  # D^T F^-T
            w = weight[e, q]
            c = w * (mu[e] - lam[e] * np.log(J))
            for i in range(3):
                for j in range(3):
                    s = 0.0
                    for k in range(3):
                        s += H[i, k] * M[k, j]
                    F[i, j] = w * (mu[e] * D[i, j] + lam[e] * trace * H[i, j]) + c * s
            for a in range(na):
                out[dofs[e, a]] += F[0, 0] * gx[0, a] + F[0, 1] * gx[1, a] + F[0, 2] * gx[2, a]
                out[dofs[e, na + a]] += F[1, 0] * gx[0, a] + F[1, 1] * gx[1, a] + F[1, 2] * gx[2, a]
            for a in range(nz):
                out[dofs[e, 2 * na + a]] += F[2, 0] * gw[0, a] + F[2, 1] * gw[1, a] + F[2, 2] * gw[2, a]


@njit(**JIT)
def tangent(u, gxy, gz, weight, mu, lam, dofs, target, values):
    """Add the element tangents [N/m] to `values`, the entries of the sparse upper triangle.

    target: (ne, m) int32, where each entry of an element's upper block triangle goes (see assembly.py), -1 for nowhere.
    """
    ne, nq, _, na = gxy.shape
    nz = gz.shape[3]
    F = np.empty((3, 3))
    H = np.empty((3, 3))
    ue = np.empty(2 * na + nz)
    g = np.zeros((nq, 3, na))  # spatial gradients; for u_z only the first nz columns of g3 are used
    g3 = np.zeros((nq, 3, na))
    wl = np.empty(nq)
    wc = np.empty(nq)
    wm = np.empty(nq)
    row = np.empty(na)
    for e in range(ne):
        for a in range(ue.size):
            ue[a] = u[dofs[e, a]]
        for q in range(nq):
            gx = gxy[e, q]
            gw = gz[e, q]
            J = _deformation_gradient(ue, gx, gw, na, nz, F)
            _inverse_transpose(F, J, H)
            w = weight[e, q]
            wm[q] = w * mu[e]
            wl[q] = w * lam[e]
            wc[q] = w * (mu[e] - lam[e] * np.log(J))
            for i in range(3):
                for a in range(na):
                    g[q, i, a] = H[i, 0] * gx[0, a] + H[i, 1] * gx[1, a] + H[i, 2] * gx[2, a]
                for a in range(nz):
                    g3[q, i, a] = H[i, 0] * gw[0, a] + H[i, 1] * gw[1, a] + H[i, 2] * gw[2, a]
        slot = 0
        for i in range(3):
            gi = g if i < 2 else g3
            ni = na if i < 2 else nz
            for k in range(i, 3):
                gk = g if k < 2 else g3
                nk = na if k < 2 else nz
                for a in range(ni):
                    for b in range(nk):
                        row[b] = 0.0
                    for q in range(0, nq, 3):
                        c0 = wl[q] * gi[q, i, a]
                        c1 = wl[q + 1] * gi[q + 1, i, a]
                        c2 = wl[q + 2] * gi[q + 2, i, a]
                        d0 = wc[q] * gi[q, k, a]
                        d1 = wc[q + 1] * gi[q + 1, k, a]
                        d2 = wc[q + 2] * gi[q + 2, k, a]
                        for b in range(nk):
                            row[b] += (
                                c0 * gk[q, k, b] + d0 * gk[q, i, b]
                                + c1 * gk[q + 1, k, b] + d1 * gk[q + 1, i, b]
                                + c2 * gk[q + 2, k, b] + d2 * gk[q + 2, i, b]
                            )  # fmt: skip
                    if i == k:
                        G = gxy[e] if i < 2 else gz[e]
                        for q in range(nq):
                            c0 = wm[q] * G[q, 0, a]
                            c1 = wm[q] * G[q, 1, a]
                            c2 = wm[q] * G[q, 2, a]
                            for b in range(nk):
                                row[b] += c0 * G[q, 0, b] + c1 * G[q, 1, b] + c2 * G[q, 2, b]
                    for b in range(a if i == k else 0, nk):
                        t = target[e, slot]
                        slot += 1
                        if t >= 0:
                            values[t] += row[b]


@njit(**JIT)
def principal_stretches(u, gxy, gz, dofs, out):
    """Principal stretches at each point, ascending, into `out` (ne, nq, 3)."""
    ne, nq, _, na = gxy.shape
    nz = gz.shape[3]
    F = np.empty((3, 3))
    ue = np.empty(2 * na + nz)
    for e in range(ne):
        for a in range(ue.size):
            ue[a] = u[dofs[e, a]]
        for q in range(nq):
            _deformation_gradient(ue, gxy[e, q], gz[e, q], na, nz, F)
            c00 = F[0, 0] ** 2 + F[1, 0] ** 2 + F[2, 0] ** 2
            c11 = F[0, 1] ** 2 + F[1, 1] ** 2 + F[2, 1] ** 2
            c22 = F[0, 2] ** 2 + F[1, 2] ** 2 + F[2, 2] ** 2
            c01 = F[0, 0] * F[0, 1] + F[1, 0] * F[1, 1] + F[2, 0] * F[2, 1]
            c02 = F[0, 0] * F[0, 2] + F[1, 0] * F[1, 2] + F[2, 0] * F[2, 2]
            c12 = F[0, 1] * F[0, 2] + F[1, 1] * F[1, 2] + F[2, 1] * F[2, 2]
            # closed form for the eigenvalues of a symmetric 3x3 matrix (Smith 1961)
            mean = (c00 + c11 + c22) / 3.0
            a0 = c00 - mean
            a1 = c11 - mean
            a2 = c22 - mean
            p = np.sqrt((a0 * a0 + a1 * a1 + a2 * a2 + 2.0 * (c01 * c01 + c02 * c02 + c12 * c12)) / 6.0)
            if p < 1e-14:
                for i in range(3):
                    out[e, q, i] = np.sqrt(mean)
                continue
            det = a0 * (a1 * a2 - c12 * c12) - c01 * (c01 * a2 - c12 * c02) + c02 * (c01 * c12 - a1 * c02)
            r = min(1.0, max(-1.0, det / (2.0 * p * p * p)))
            angle = np.arccos(r) / 3.0
            high = mean + 2.0 * p * np.cos(angle)
            low = mean + 2.0 * p * np.cos(angle + 2.0943951023931953)
            out[e, q, 0] = np.sqrt(max(low, 0.0))
            out[e, q, 1] = np.sqrt(max(3.0 * mean - high - low, 0.0))
            out[e, q, 2] = np.sqrt(high)
