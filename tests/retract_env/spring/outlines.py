"""Veins as outlines, random ones, and the stiffness that brute force finds for them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from hypothesis import settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from retract_env.spring import SpringModel

Array = NDArray[np.float64]

L, H = 0.05, 0.0044  # m, the paper's flap
E, EV = 40e3, 200e3  # Pa, its tissue and veins
COLUMNS = 64  # of the lattice of random outlines: keeps edges flatter than H / (L / 64)
# The sweep may move a vertex by L / 2^41. Edges of the lattice rise at most 64 H / L, a column crosses fewer
# than 100 of them: 3e-9 H.
LATTICE_TOLERANCE = 1e-8

Outlines = list[Array]


def box(x0: float, x1: float, y0: float = 0.001, y1: float = 0.003) -> Array:
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def flap(*outlines: ArrayLike, moduli: float | Sequence[float] = EV) -> SpringModel:
    """The paper's flap with these veins."""
    each = [moduli] * len(outlines) if isinstance(moduli, int | float) else moduli
    return SpringModel.from_outlines(L, H, E, outlines, each)


def random_veins(seed: int) -> tuple[Outlines, list[float]]:
    """Concave, overlapping, touching, stiffer and softer veins; x on a lattice, some edges vertical."""
    rng = np.random.default_rng(seed)
    outlines: Outlines = []
    wanted = rng.integers(1, 9)
    while len(outlines) < wanted:
        if rng.random() < 0.3:
            columns = np.sort(rng.choice(COLUMNS + 1, 2, replace=False))
            outline = box(*(-L + L * columns / COLUMNS), *np.sort(rng.choice(9, 2, replace=False) * H / 8))
        else:  # a star about some centre
            n = rng.integers(3, 16)
            angle, reach = np.sort(rng.uniform(0, 2 * math.pi, n)), rng.uniform(0.1, 1, n)
            x = rng.uniform(-L, 0) + rng.uniform(0.05, 0.4) * L * reach * np.cos(angle)
            y = rng.uniform(0, H) + rng.uniform(0.1, 0.9) * H * reach * np.sin(angle)
            x = np.clip(np.rint((x + L) / L * COLUMNS), 0, COLUMNS) * L / COLUMNS - L
            outline = np.column_stack([x, np.clip(y, 0, H)])
        if shapely.Polygon(outline).is_valid:
            outlines.append(outline)
    return outlines, [float(m) for m in rng.choice([E / 10, E, EV, EV, 5 * EV], wanted)]


def brute_compliance(x: Array, outlines: Sequence[Array], moduli: Sequence[float]) -> Array:
    """1/k_eq by cutting vertical lines with unions of veins, the stiffest first."""
    lines = shapely.linestrings(
        np.stack([np.column_stack([x, np.full(x.size, y)]) for y in (-1.0, 1.0)], axis=1)
    )
    covered, total = np.zeros(x.size), np.zeros(x.size)
    for modulus in sorted(set(moduli), reverse=True):
        union = shapely.union_all(
            [shapely.Polygon(o) for o, m in zip(outlines, moduli, strict=True) if m >= modulus]
        )
        reach = np.asarray(shapely.length(shapely.intersection(lines, union)))
        total += (reach - covered) / modulus
        covered = reach
    return total + (H - covered) / E


scenes = st.integers(0, 2**32 - 1).map(random_veins)
few = settings(max_examples=40, deadline=None)
