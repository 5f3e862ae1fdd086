"""Grasps by brute-force finite elements: what the spring model replaces. Sec. V-A, after D-Space.

Opposite pairs of jaws, side by side along the flap, each press it by the same distance; linear elasticity
says how stiff the flap is there and how far it can be closed before its strain reaches the limit. All pairs
share one mesh and one factorisation: a pair is one right-hand side.

A jaw presses evenly over its width and depth, and closes by its mean displacement. The rigid patches of the
certifier need a mesh of their own for each grasp; single nodes would do with one, but their stiffness falls
without end as the mesh is refined. Neither gravity nor the bed take part.

The jaws are closed by the energy balance of Eq. 5, U_L = k (delta_L - delta)^2 / 2 against U_n = k_n delta^2
/ 2, now with the finite elements' k and with delta_L, the closing at which eps_1% reaches the limit, in place
of eps_L h.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.fem.elements import quadratic_depth, symmetric_depth
from retract_env.fem.linear import cholesky
from retract_env.fem.model import FlapModel
from retract_env.fem.prism import Prism, level_count
from retract_env.grasp import Grasp
from retract_env.mesh import Resolution, jaw_range, section_mesh
from retract_env.objectives import worst_mean
from retract_env.scene import Scene
from retract_env.spring import optimal_compression

Array = NDArray[np.float64]

PAIRS, NODES = 160, 10_000
"""Pairs of jaws, and about how many nodes the mesh has, both as in Sec. V-A."""
SMALL = 1e-6
"""Part of the height by which the jaws close: so little that strains are linear in it, to the same part."""
MOST_COMPRESSION = 0.9
"""Over the height: jaws do not meet."""
RIPPLE = 0.01
"""A minimum counts where it lies below the maxima beside it by this part of them; the mesh makes shallower
ones."""


@dataclass(frozen=True)
class Closure:
    """What pairs of jaws find, free end first."""

    x: Array
    """(p,) m"""
    k: Array
    """(p,) Pa/m, stiffness per area of a jaw, to be compared with k_eq of Eq. 2"""
    strain: Array
    """(p,) 1/m, eps_1% for each metre by which the jaws close"""
    nodes: int

    def farthest(self, strain_limit: float) -> Array:
        """(p,) m, delta_L: how far the jaws close until eps_1% reaches the limit."""
        return strain_limit / self.strain


def brute_force(scene: Scene, pairs: int = PAIRS, nodes: int = NODES) -> Closure:
    """Press the flap with every pair of jaws.

    pairs: how many, evenly from the free to the fixed end, jaws whole on the flap; nodes: of the mesh over
    half the depth, about. Raises MeshError, and ValueError for less than 3 pairs or 100 nodes.
    """
    if pairs < 3:
        raise ValueError(f"pairs = {pairs}, allowed 3 or more")
    if nodes < 100:
        raise ValueError(f"nodes = {nodes}, allowed 100 or more")
    tissue, width = scene.tissue, scene.jaws.width
    section = section_mesh(scene, None, _resolution(scene, nodes))
    model = FlapModel(scene, section, None)
    x = np.linspace(*jaw_range(tissue.length, width), pairs)
    assembly = model.assembly
    factor = cholesky(assembly.indptr, assembly.indices)
    factor.factorize(assembly.tangent(np.zeros(assembly.size)))
    load = _pressed(model, scene, x)
    moved = factor.solve(load)
    # one newton on each jaw is half a newton on this half of the flap
    compliance = 2 * np.einsum("ip,ip->p", load, moved)
    weights = np.concatenate([block.measured.ravel() for block in assembly.blocks])
    closing = SMALL * tissue.height
    u = np.zeros(assembly.size)
    worst = np.empty(pairs)
    for i in range(pairs):
        u[assembly.free] = closing / compliance[i] * moved[:, i]
        strains = [s.ravel() for s in assembly.strains(u)]
        worst[i] = worst_mean(np.concatenate(strains), weights) / closing
    area = width * (scene.jaws.depth or tissue.depth)
    return Closure(x, 1 / (compliance * area), worst, len(section.points) * model.prism.levels)


def closure_grasps(scene: Scene, found: Closure | None = None, samples: int = 10) -> list[Grasp]:
    """Stable grasps on the stiffness that brute force finds, highest score U_n first, then by x.

    Where there is none, `samples` grasps stand evenly along the flap, as with the spring model.
    """
    found = brute_force(scene) if found is None else found
    at, k_n = stable_pairs(found)
    if not len(at):
        at = np.unique(np.linspace(0, len(found.x) - 1, samples).round().astype(int))
        k_n = found.k[at]
    farthest = found.farthest(scene.limits.strain)[at]
    delta = optimal_compression(found.k[at], k_n, 1.0, 1.0) * farthest
    delta = np.minimum(delta, MOST_COMPRESSION * scene.tissue.height)
    rows = zip(found.x[at].tolist(), delta.tolist(), (k_n * delta**2 / 2).tolist(), strict=True)
    return sorted((Grasp(*row) for row in rows), key=lambda grasp: (-grasp.score, grasp.x))


def stable_pairs(found: Closure) -> tuple[NDArray[np.intp], Array]:
    """Pairs (s,) at minima of the stiffness, and k_n (s,), Pa/m, the lower of the maxima beside each.

    As with the spring model, the free end is a maximum where the stiffness grows towards it, and the fixed
    end a wall. The ends themselves are no minima.
    """
    from scipy.signal import find_peaks  # takes longer to import than all of this package

    k = found.k
    deep = RIPPLE * float(np.median(k))
    minima, maxima = (find_peaks(sign * k, prominence=deep)[0] for sign in (-1, 1))
    k_n = []
    for i in minima:
        left, right = maxima[maxima < i], maxima[maxima > i]
        k_n.append(min(k[left[-1]] if len(left) else k[0], k[right[0]] if len(right) else math.inf))
    return minima, np.array(k_n)


def _resolution(scene: Scene, nodes: int) -> Resolution:
    """Elements of one size all over, for that many nodes over half the depth."""
    tissue = scene.tissue
    # quadratic triangles have two nodes each
    area = tissue.length * tissue.height / (nodes / level_count(scene) / 2)
    size = math.sqrt(4 * area / math.sqrt(3))
    return Resolution("closure", patch=1, edge=1.0, growth=0.5, bulk=size / tissue.height)


def _pressed(model: FlapModel, scene: Scene, x: Array) -> Array:
    """(n, p) N, loads on the free unknowns when jaws at x (p,) m press with half a newton each, evenly."""
    section, width = model.section, scene.jaws.width
    across = _jaw_share(model.prism, scene)
    number = np.full(model.prism.size, -1)
    number[model.free] = np.arange(len(model.free))
    load = np.zeros((len(model.free), len(x)))
    points = np.array([-1.0, 1.0]) / math.sqrt(3)
    y = section.points[:, 1]
    for level, push in ((0.0, 1.0), (scene.tissue.height, -1.0)):
        edges = section.boundary[np.isclose(y[section.boundary], level, atol=1e-9).all(axis=1)]
        begin, end = section.points[edges[:, 0], 0], section.points[edges[:, 2], 0]
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        a = np.clip(x - width / 2, low[:, None], high[:, None])  # (e, p), the part of an edge below a jaw
        b = np.clip(x + width / 2, low[:, None], high[:, None])
        share = np.zeros((len(edges), len(x), 3))
        for point in points:
            at = (a + b) / 2 + point * (b - a) / 2
            s = 2 * (at - begin[:, None]) / (end - begin)[:, None] - 1
            shape = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=-1)
            share += shape * ((b - a) / 2)[..., None]
        for corner in range(3):
            for depth, part in enumerate(across):
                rows = number[model.prism.y(edges[:, corner], np.array([depth]))]
                kept = rows >= 0  # what presses on the fixed end moves nothing
                np.add.at(load, rows[kept], push * part * share[kept, :, corner] / (2 * width))
    return load


def _jaw_share(prism: Prism, scene: Scene) -> Array:
    """(levels,) part of a jaw's force that each level of nodes takes; they add up to 1."""
    half = (scene.jaws.depth or scene.tissue.depth) / 2
    share = np.zeros(prism.levels)
    for layer, end in enumerate(prism.breaks[1:]):
        if end <= half * (1 + 1e-9):
            thickness = float(end - prism.breaks[layer])
            basis, *_, weights = symmetric_depth(thickness) if layer == 0 else quadratic_depth(thickness)
            levels = np.arange(2) if layer == 0 else np.arange(3) + 2 * layer - 1
            share[levels] += weights @ basis
    return share / half
