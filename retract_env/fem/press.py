"""Jaws that press with a given force, as a gripper can: their separation is one unknown more."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.model import FlapModel
from retract_env.fem.solver import Equilibrium
from retract_env.grasp import to_jaws

Array = NDArray[np.float64]

FORCE_TOLERANCE = 5e-4
"""Jaws that hold by force press with it to this part; Newton's tolerance alone is worth about as much."""
MOST_PRESSES = 10
"""Equilibria in search of one separation. One or two are the rule."""
NEAREST = 0.05
"""Heights; jaws that are to come nearer than this have met."""


def pressing(model: FlapModel, force: Array, pose: Array) -> float:
    """N, the mean of both jaws' normal reactions: the force conjugate to their separation.

    force: (n,) N, that holds the prescribed nodes, with the jaws at a pose (4,) x, y, theta, separation.
    """
    lower, upper = model.reactions(force)
    sine, cosine = math.sin(pose[2]), math.cos(pose[2])
    return float((cosine * (upper[1] - lower[1]) - sine * (upper[0] - lower[0])) / 2)


def closing(equilibrium: Equilibrium, u: Array, pose: Array) -> tuple[float, Array]:
    """First-order change of the pressing force, N/m, and of the shape, (n,), with the separation, at an
    equilibrium u (n,) m."""
    model, moved = equilibrium.model, u.copy()
    height = model.scene.tissue.height
    model.place_jaws(moved, to_jaws(np.append(pose[:3], pose[3] + height)))
    way = equilibrium.step(u, moved - u) / height
    # the energy's second derivative, over the whole depth; an error of the way counts by its square
    return -2 * float(np.einsum("i,i", way, model.tangent_times(u, way))), way


def equilibrate(
    equilibrium: Equilibrium, u: Array, pose: Array, level: float | None, before: Array | None = None
) -> tuple[Array, Array, Array]:
    """Equilibrium near u (n,) m, the forces (n,) N that hold the prescribed nodes, and the jaws' pose (4,).

    u: with the jaws at that pose. level: N, with which they press, at a separation near that of the pose;
    None: they stay there; before: as of `Equilibrium.solve`. Newton's method for the separation, then
    secants. Raises Diverged.
    """
    u, force = equilibrium.solve(u, before)
    if level is None:
        return u, force, pose
    model, slope, way = equilibrium.model, math.nan, u
    pressed = pressing(model, force, pose)
    for _ in range(MOST_PRESSES):
        if abs(level - pressed) <= FORCE_TOLERANCE * level:
            return u, force, pose
        if math.isnan(slope):
            slope, way = closing(equilibrium, u, pose)
        step = (level - pressed) / slope
        if not pose[3] + step > NEAREST * model.scene.tissue.height:
            raise Diverged(f"the jaws meet before they press with {1e3 * level:.4g} mN")
        earlier, was, pose = u, pressed, np.append(pose[:3], pose[3] + step)
        u = u + step * way
        model.place_jaws(u, to_jaws(pose))
        u, force = equilibrium.solve(u)
        pressed = pressing(model, force, pose)
        found = (pressed - was) / step
        # of tiny steps the solver's own error is the larger part
        if found < 0 and abs(pressed - was) > 10 * FORCE_TOLERANCE * level:
            slope, way = found, (u - earlier) / step
    raise Diverged(
        f"no separation in {MOST_PRESSES} equilibria at which the jaws press with {1e3 * level:.4g} mN"
    )
