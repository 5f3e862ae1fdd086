"""Compiled kernels: energy, residual and tangent of the logarithmic neo-Hookean solid.

The material is W(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2, whose first Piola-Kirchhoff stress
is P = mu F + (lambda ln J - mu) F^-T. With the spatial gradients g = F^-T G of the shape functions its
tangent is, between shape function a in direction i and b in direction k,

    mu (G_a . G_b) delta_ik + lambda g_a[i] g_b[k] + (mu - lambda ln J) g_a[k] g_b[i],

so no fourth-order tensor is ever formed, and the mu term, which does not depend on the state, is computed
once.

One element has `na` shape functions for u_x and for u_y and `nz` for u_z (see elements.py), hence 2 na + nz
unknowns in the order x..., y..., z.... Elements lie LANES side by side in the last axis, which every inner
loop runs over: that is what lets the compiler use vector instructions (3.5 times faster than element by
element). Arrays of a block of c chunks:

    gxy (c, nq, 3, na, LANES), gz (c, nq, 3, nz, LANES)   reference gradients [1/m]
    weight (c, nq, LANES)                                 rest volumes [m^3], 0 in lanes that only fill up
    mu, lam (c, LANES)                                    Lame's parameters [Pa]
    dofs (c, 2 na + nz, LANES)                            positions in the vector of all unknowns
"""

from __future__ import annotations

import numpy as np
from numba import njit

LANES = 32
JIT = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


@njit(**JIT)
def gather(u, dofs, ue):
    """The values of u (n,) at an element's unknowns `dofs` (m, LANES), into `ue`."""
    for a in range(dofs.shape[0]):
        for l in range(LANES):
            ue[a, l] = u[dofs[a, l]]


@njit(**JIT)
def add_forces(re, dofs, out):
    """Add an element's forces `re` (m, LANES) to `out` (n,) at its unknowns."""
    for a in range(dofs.shape[0]):
        for l in range(LANES):
            out[dofs[a, l]] += re[a, l]


@njit(**JIT)
def gradient(ue, gx, gz, F):
    """Displacement gradient (3, 3, LANES) at one point."""
    na = gx.shape[1]
    nz = gz.shape[1]
    for j in range(3):
        fx = F[0, j]
        fy = F[1, j]
        fz = F[2, j]
        for l in range(LANES):
            fx[l] = 0.0
            fy[l] = 0.0
            fz[l] = 0.0
        for a in range(na):
            g = gx[j, a]
            x = ue[a]
            y = ue[na + a]
            for l in range(LANES):
                fx[l] += x[l] * g[l]
                fy[l] += y[l] * g[l]
        for a in range(nz):
            g = gz[j, a]
            z = ue[2 * na + a]
            for l in range(LANES):
                fz[l] += z[l] * g[l]


@njit(**JIT)
def deformation(ue, gx, gz, F, H, J):
    """F = 1 + grad u, H = F^-T and J = det F; returns whether no element is inverted."""
    gradient(ue, gx, gz, F)
    sound = True
    for l in range(LANES):
        a = F[0, 0, l] + 1.0
        b = F[0, 1, l]
        c = F[0, 2, l]
        d = F[1, 0, l]
        e = F[1, 1, l] + 1.0
        f = F[1, 2, l]
        g = F[2, 0, l]
        h = F[2, 1, l]
        k = F[2, 2, l] + 1.0
        F[0, 0, l] = a
        F[1, 1, l] = e
        F[2, 2, l] = k
        j = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
        r = 1.0 / j
        J[l] = j
        sound = sound and j > 0.0
        H[0, 0, l] = (e * k - f * h) * r
        H[0, 1, l] = (f * g - d * k) * r
        H[0, 2, l] = (d * h - e * g) * r
        H[1, 0, l] = (c * h - b * k) * r
        H[1, 1, l] = (a * k - c * g) * r
        H[1, 2, l] = (b * g - a * h) * r
        H[2, 0, l] = (b * f - c * e) * r
        H[2, 1, l] = (c * d - a * f) * r
        H[2, 2, l] = (a * e - b * d) * r
    return sound


@njit(**JIT)
def divergence(P, gx, gz, re):
    """Add sum_j P[i, j] G_a[j] to the element forces (2 na + nz, LANES)."""
    na = gx.shape[1]
    nz = gz.shape[1]
    for j in range(3):
        px = P[0, j]
        py = P[1, j]
        pz = P[2, j]
        for a in range(na):
            g = gx[j, a]
            x = re[a]
            y = re[na + a]
            for l in range(LANES):
                x[l] += px[l] * g[l]
                y[l] += py[l] * g[l]
        for a in range(nz):
            g = gz[j, a]
            z = re[2 * na + a]
            for l in range(LANES):
                z[l] += pz[l] * g[l]


@njit(**JIT)
def residual(u, gxy, gz, weight, mu, lam, dofs, out):
    """Add the internal forces [N] to `out` (n,); returns the energy [J], inf where an element is inverted."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    J = np.empty(LANES)
    ue = np.empty((nd, LANES))
    re = np.empty((nd, LANES))
    energy = 0.0
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        re[:] = 0.0
        m = mu[c]
        k = lam[c]
        for q in range(gxy.shape[1]):
            if not deformation(ue, gxy[c, q], gz[c, q], F, H, J):
                return np.inf
            w = weight[c, q]
            for l in range(LANES):
                log_j = np.log(J[l])
                square = 0.0
                for i in range(3):
                    for j in range(3):
                        square += F[i, j, l] * F[i, j, l]
                energy += w[l] * (0.5 * m[l] * (square - 3.0) - m[l] * log_j + 0.5 * k[l] * log_j * log_j)
                J[l] = w[l] * (k[l] * log_j - m[l])
            for i in range(3):
                for j in range(3):
                    f = F[i, j]
                    h = H[i, j]
                    for l in range(LANES):
                        f[l] = w[l] * m[l] * f[l] + J[l] * h[l]
            divergence(F, gxy[c, q], gz[c, q], re)
        add_forces(re, dofs[c], out)
    return energy


@njit(**JIT)
def tangent_times(u, v, gxy, gz, weight, mu, lam, dofs, out):
    """Add the tangent at u applied to v [N] to `out` (n,), without assembling it."""
    nd = dofs.shape[1]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    D = np.empty((3, 3, LANES))
    J = np.empty(LANES)
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
            deformation(ue, gxy[c, q], gz[c, q], F, H, J)
            gradient(ve, gxy[c, q], gz[c, q], D)
            for l in range(LANES):
                trace = 0.0
                for i in range(3):
                    for j in range(3):
                        trace += H[i, j, l] * D[i, j, l]
                        s = 0.0
                        for k in range(3):
                            s += D[k, i, l] * H[k, j, l]
                        M[i, j] = s  # D^T F^-T
                w = weight[c, q, l]
                m = w * mu[c, l]
                b = w * lam[c, l]
                d = m - b * np.log(J[l])
                for i in range(3):
                    for j in range(3):
                        s = 0.0
                        for k in range(3):
                            s += H[i, k, l] * M[k, j]
                        F[i, j, l] = m * D[i, j, l] + b * trace * H[i, j, l] + d * s
            divergence(F, gxy[c, q], gz[c, q], re)
        add_forces(re, dofs[c], out)


@njit(**JIT)
def gram(g, weight, mu, out):
    """The constant part of the tangent, sum_q weight mu G_a . G_b, into `out` (c, na, na, LANES)."""
    for c in range(g.shape[0]):
        out[c] = 0.0
        for q in range(g.shape[1]):
            for j in range(3):
                for a in range(g.shape[3]):
                    for b in range(a, g.shape[3]):
                        for l in range(LANES):
                            out[c, a, b, l] += (
                                weight[c, q, l] * mu[c, l] * g[c, q, j, a, l] * g[c, q, j, b, l]
                            )


@njit(**JIT)
def tangent(u, gxy, gz, weight, mu, lam, dofs, gram_xy, gram_z, target, values):
    """Add the element tangents [N/m] to `values`, the entries of the sparse upper triangle.

    target: (c, m, LANES) int32, where each entry of an element's upper triangle goes (see assembly.py),
    -1 for nowhere.
    """
    nq, na = gxy.shape[1], gxy.shape[3]
    nz = gz.shape[3]
    F = np.empty((3, 3, LANES))
    H = np.empty((3, 3, LANES))
    J = np.empty(LANES)
    ue = np.empty((dofs.shape[1], LANES))
    sxy = np.empty((nq, 3, na, LANES))  # spatial gradients
    sz = np.empty((nq, 3, nz, LANES))
    wl = np.empty((nq, LANES))
    wc = np.empty((nq, LANES))
    rows = np.empty((na, LANES))
    for c in range(gxy.shape[0]):
        gather(u, dofs[c], ue)
        for q in range(nq):
            deformation(ue, gxy[c, q], gz[c, q], F, H, J)
            for l in range(LANES):
                w = weight[c, q, l]
                wl[q, l] = w * lam[c, l]
                wc[q, l] = w * mu[c, l] - wl[q, l] * np.log(J[l])
            push(H, gxy[c, q], sxy[q])
            push(H, gz[c, q], sz[q])
        slot = 0
        for i in range(3):
            si = sxy if i < 2 else sz
            constant = gram_xy[c] if i < 2 else gram_z[c]
            slot = couple_same(si, i, wl, wc, constant, rows, target[c], slot, values)
            for k in range(i + 1, 3):
                sk = sxy if k < 2 else sz
                slot = couple_other(si, sk, i, k, wl, wc, rows, target[c], slot, values)


@njit(**JIT)
def couple_same(s, i, wl, wc, constant, rows, target, slot, values):
    """Tangent between the unknowns of one direction i; returns the next slot."""
    first = np.empty(LANES)
    for a in range(s.shape[2]):
        for b in range(a, s.shape[2]):
            row = rows[b]
            g = constant[a, b]
            for l in range(LANES):
                row[l] = g[l]
        for q in range(s.shape[0]):
            x = s[q, i, a]
            p = wl[q]
            r = wc[q]
            for l in range(LANES):
                first[l] = (p[l] + r[l]) * x[l]
            for b in range(a, s.shape[2]):
                row = rows[b]
                y = s[q, i, b]
                for l in range(LANES):
                    row[l] += first[l] * y[l]
        slot = _scatter(rows, a, s.shape[2], target, slot, values)
    return slot


@njit(**JIT)
def couple_other(si, sk, i, k, wl, wc, rows, target, slot, values):
    """Tangent between the unknowns of direction i and those of direction k; returns the next slot."""
    first = np.empty(LANES)
    second = np.empty(LANES)
    for a in range(si.shape[2]):
        for b in range(sk.shape[2]):
            row = rows[b]
            for l in range(LANES):
                row[l] = 0.0
        for q in range(si.shape[0]):
            x = si[q, i, a]
            y = si[q, k, a]
            p = wl[q]
            r = wc[q]
            for l in range(LANES):
                first[l] = p[l] * x[l]
                second[l] = r[l] * y[l]
            for b in range(sk.shape[2]):
                row = rows[b]
                z = sk[q, k, b]
                t = sk[q, i, b]
                for l in range(LANES):
                    row[l] += first[l] * z[l] + second[l] * t[l]
        slot = _scatter(rows, 0, sk.shape[2], target, slot, values)
    return slot


@njit(**JIT)
def _scatter(rows, begin, end, target, slot, values):
    for b in range(begin, end):
        for l in range(LANES):
            where = target[slot, l]
            if where >= 0:
                values[where] += rows[b, l]
        slot += 1
    return slot


@njit(**JIT)
def push(H, g, out):
    """Spatial gradients g[i] = sum_j H[i, j] G[j] of one point, (3, n, LANES)."""
    for i in range(3):
        h0 = H[i, 0]
        h1 = H[i, 1]
        h2 = H[i, 2]
        for a in range(g.shape[1]):
            g0 = g[0, a]
            g1 = g[1, a]
            g2 = g[2, a]
            s = out[i, a]
            for l in range(LANES):
                s[l] = h0[l] * g0[l] + h1[l] * g1[l] + h2[l] * g2[l]
