"""The stiffness along a flap as a plan's picture shows it.

Apart from what draws, so that whoever has planned need not import Matplotlib for it, nor whoever draws the
spring model, which is compiled code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from planners.base import Candidate, Plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StiffnessCurve:
    """Stiffness k_eq of Eq. 2 along the flap, and the ranked grasps on it."""

    x: Array
    """(n,) m"""
    k: Array
    """(n,) Pa/m"""
    grasps: tuple[tuple[int, float, float], ...]
    """rank, 0 for one that was not among the candidates; x in m; k_eq there"""


def stiffness_curve(plan: Plan) -> StiffnessCurve:
    """The curve that a plan's picture shows."""
    from retract_env.spring import SpringModel

    tissue, chosen = plan.scene.tissue, plan.grasp.x
    model = SpringModel(tissue)
    knots = np.asarray(model.knots)
    step = 1e-9 * tissue.length  # k_eq jumps at vertical edges: sample both sides
    x = np.unique(np.concatenate((np.linspace(-tissue.length, 0.0, 801), knots - step, knots, knots + step)))
    x = x[(x >= -tissue.length) & (x <= 0.0)]
    grasps = ranked(plan.candidates)
    if all(abs(at - chosen) > 1e-9 for _, at in grasps):
        grasps.append((0, chosen))
    known = tuple((rank, at, float(model.k_eq(np.array([at]))[0])) for rank, at in grasps)
    return StiffnessCurve(x, np.asarray(model.k_eq(x)), known)


def ranked(candidates: Sequence[Candidate]) -> list[tuple[int, float]]:
    """Rank from 1 and x in m of each grasp, best first as the candidates come; one x counts once."""
    seen: dict[float, int] = {}
    for candidate in candidates:
        seen.setdefault(round(candidate.grasp.x, 9), len(seen) + 1)
    return [(rank, x) for x, rank in seen.items()]
