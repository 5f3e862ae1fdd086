"""The flap's motion along a plan, in three dimensions: followed once more, step by step.

A certificate tells how much is strained at each of its steps but not where every node is; the page needs
both. On finite elements the steps are the certificate's own; the rod, which is quick, follows what else was
tried and the flaps as they may turn out to be.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.pictures.page.surface import Surface, surface_of
from baselines.pictures.steps import drawn_out, shown_frames
from retract_env.drawing.gauges import needed_friction
from retract_env.errors import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.objectives import verdict
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene

if TYPE_CHECKING:
    from planners.certify import Certificate

Array = NDArray[np.float64]

SQUEEZE = 0.15
"""Part of the slider in which the jaws close, so that plans close together and lift together."""
DEPTH_ROWS = 3
"""Rows of vertices over the layer next to the plane of symmetry, in which the flap's sides curve."""
APART = 0.05
"""Part of its limit by which strain may differ from what a certificate says of the same step. Two ways to an
equilibrium end within 0.1 % of each other; beside a jaw's edge two equilibria may be some per cent apart."""


class NotFollowed(ValueError):
    """The motion cannot be shown; the message is one line."""


@dataclass(frozen=True)
class Motion:
    """A flap between two jaws, step by step."""

    surface: Surface
    z: Array
    """(l,) m, levels of the depth at rest, from the plane of symmetry to the flap's end"""
    shapes: Array
    """(t, l, n, 3) m, where on each level is what moves the surface's vertices"""
    strain: Array
    """(t, v) at the vertices"""
    shown: tuple[int, ...]
    """the steps that those are, among the following"""
    progress: Array
    """(s,) waypoints"""
    jaws: Array
    """(s, 4) m"""
    worst: Array
    """(s,) eps_1%"""
    friction: Array
    """(s,) needed; nan before the jaws are closed"""
    clearance: Array
    """(s,) m"""
    reason: str
    """how it ended"""

    @property
    def time(self) -> Array:
        """(s,) where on the slider each step is, 0 to 1; what ends while the jaws close stands still then."""
        lifted = max(float(self.progress[-1]) - 1, 1e-9)
        lifting = SQUEEZE + (1 - SQUEEZE) * (self.progress - 1) / lifted
        return np.where(self.progress <= 1, SQUEEZE * self.progress, lifting)


def followed(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    on_step: Callable[[], None] = lambda: None,
) -> Motion:
    """The motion that a certificate is about.

    on_step: called after each step. Raises NotFollowed where the plan does something else than the
    certificate says, and MeshError.
    """
    history = certificate.history
    progress = [float(p) for p in history["progress"]]
    physics = FemPhysics(scene, grasp.x, certificate.mesh["resolution"], force=grasp.force)
    model, keep = physics.model, set(shown_frames(drawn_out(progress)))
    surface, shapes, strains = surface_of(physics.section), [], []
    limit = certificate.strain_limit
    for k, at in enumerate(progress):
        try:
            state = physics.reset() if k == 0 else physics.move_to(path.pose_at(at), at)
        except (Diverged, ValueError) as problem:
            raise NotFollowed(f"the certificate is not of this plan: step {k}: {problem}") from None
        if at == 1:
            physics.turn()
        said = float(history["strain"][k])
        if abs(state.worst_strain - said) > APART * limit:
            raise NotFollowed(
                f"the certificate is not of this plan: at step {k} it says strain {said:.4f}, "
                f"which comes to {state.worst_strain:.4f}"
            )
        on_step()
        if k in keep:
            shapes.append(np.stack([surface.moved(level) for level in model.solid(physics.displacements)]))
            strains.append(surface.strains(state.strain))
    friction = np.array([max(map(float, pair)) for pair in history["friction"]])
    friction[np.array(progress) < 1] = math.nan
    return Motion(
        surface=surface,
        z=model.prism.z,
        shapes=np.array(shapes),
        strain=np.array(strains),
        shown=tuple(sorted(keep)),
        progress=np.array(progress),
        jaws=np.array(history["jaws"], float),
        worst=np.array(history["strain"], float),
        friction=friction,
        clearance=np.array(history["clearance"], float),
        reason=certificate.reason,
    )


def followed_by_rod(scene: Scene, grasp: Grasp, path: JawPath) -> Motion | None:
    """The same by the rod, to the first broken limit, to success or the path's end; None where it finds no
    equilibrium even with the jaws closed, or does not know the tissue's law."""
    from retract_env.physics.rod import RodPhysics

    if not scene.neo_hookean:
        return None
    physics = RodPhysics(scene, grasp.x, force=grasp.force)
    states: list[TissueState] = []
    reason, limits = "not_visible", scene.limits
    for at in (0.0, 0.5, *range(1, path.last + 1)):
        try:
            states.append(physics.reset() if at == 0 else physics.move_to(path.pose_at(at), float(at)))
        except Diverged:
            reason = "diverged"
            break
        state = states[-1]
        found = verdict(
            state.worst_strain, needed_friction(state) if at >= 1 else 0.0, state.clearance, limits.strain,
            limits.friction, limits.clearance, state.overlap,
        )  # fmt: skip
        if found is not None and at >= 1:
            reason = found
            break
    if len(states) < 3:
        return None
    surface, half = surface_of(physics.section), scene.tissue.depth / 2
    progress = np.array([state.progress for state in states])
    shown = shown_frames(drawn_out(progress))
    shapes = []
    for k in shown:
        points = np.asarray(states[k].points)
        shapes.append(surface.moved(np.column_stack([points, np.full(len(points), half)]))[None])
    return Motion(
        surface=surface,
        z=np.array([half]),
        shapes=np.array(shapes),
        strain=np.array([surface.strains(np.asarray(states[k].strain)) for k in shown]),
        shown=tuple(shown),
        progress=progress,
        jaws=np.array([state.jaws for state in states]),
        worst=np.array([state.worst_strain for state in states]),
        friction=np.array([needed_friction(s) for s in states]),
        clearance=np.array([state.clearance for state in states]),
        reason=reason,
    )


def depth_rows(z: ArrayLike) -> tuple[Array, Array]:
    """Weights (r, l) of the levels in each row of vertices over half the depth, for what moves in the plane
    and for what moves along z.

    z: (l,) m. In the layer next to the plane of symmetry the elements' shape is (1 - s^2, s^2) in the plane
    and s along z; one level alone is the same over all the depth.
    """
    count = len(np.asarray(z))
    if count == 1:
        return np.ones((2, 1)), np.array([[0.0], [1.0]])
    s = np.linspace(0, 1, DEPTH_ROWS)
    plane, along = np.zeros((DEPTH_ROWS, count)), np.zeros((DEPTH_ROWS, count))
    plane[:, 0], plane[:, 1], along[:, 1] = 1 - s**2, s**2, s
    rest = np.eye(count)[2:]
    return np.concatenate([plane, rest]), np.concatenate([along, rest])
