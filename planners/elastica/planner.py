"""The rod's optimum made to hold on finite elements: `elastica` as a planner.

The rod knows neither the jaws' patches nor how the grip changes while the flap bends. So each optimum is
tried on a coarse mesh, and the differences in the jaws' forces, pose by pose, are added to the friction cones
of the next one: modifier adaptation of zeroth order (Marchetti, Chachuat, Bonvin 2009). One or two
corrections do. Strain is not corrected: the rod's is as good as a fine mesh's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.base import Contestant, Proposals, Verdict
from planners.certify import Retraction
from planners.effort import retract
from planners.elastica.grip import measured_grip
from planners.elastica.program import INCREMENTS, KIND, POSES, RESERVE, Unsolved, jaw_path, solve
from retract_env.grasp import Grasp, JawPath, to_pose
from retract_env.physics.base import TissueState
from retract_env.scene import Scene

Array = NDArray[np.float64]

TRIED_ON = "coarse"
ROUNDS = 3
"""Optima for one grasp, at most; the coarse trial of each corrects the next."""
ENOUGH = (1 + RESERVE) / 2
"""Part of the friction limit that a trial may need; finer meshes need up to 4 % more."""
FIRMER = 1.05
"""By how much the jaws close further where the judge saw them slip, at most MOST_FIRMER times."""
MOST_FIRMER = 3


def optimise(
    scene: Scene, grasp: Grasp, on_increment: Callable[[], None] = lambda: None
) -> tuple[Grasp, JawPath]:
    """Grip and path of least strain at one grasp, whose compression only says where the grip is measured.

    on_increment: called at each increment on the finite elements and before each program; what it raises ends
    the work. Raises Unsolved, and Diverged, MeshError or TooCostly where the finite elements cannot squeeze
    or follow the flap there.
    """
    grip = measured_grip(scene, grasp, on_increment)
    lenient = scene.limits.model_copy(update={"strain": 0.99, "friction": 5.0})
    optimum, correction = None, None
    tried: list[tuple[bool, float, Grasp, JawPath]] = []
    for _ in range(ROUNDS):
        on_increment()
        try:
            optimum = solve(scene, grasp, grip, correction, optimum)
        except Unsolved:
            if not tried:
                raise
            break
        held, path = Grasp(grasp.x, optimum.compression, grasp.score), jaw_path(scene, optimum)
        trial = Retraction(scene, held, path, TRIED_ON, lenient)
        retract(trial, on_increment)
        tried.append((trial.reason != "ok", trial.required_friction, held, path))
        if trial.reason == "ok" and trial.required_friction <= ENOUGH * scene.limits.friction:
            break
        if all(frame.progress < 1 for frame in trial.frames):  # lost before the jaws were closed
            break
        correction = jaw_forces(trial.frames) - optimum.forces
    return min(tried, key=lambda t: t[:2])[2:]


def jaw_forces(frames: Sequence[TissueState]) -> Array:
    """(4, POSES) N, of the jaws on the tissue, tangential and normal, as `Optimum.forces`.

    frames: along a path of `elastica.program.jaw_path`. For each jaw and pose the frame counts, of those
    around it, whose friction is greatest; poses that were not reached are like the last frame.
    """
    moved = [f for f in frames if f.progress >= 1]
    progress, friction = np.array([f.progress for f in moved]), np.array([f.required_friction for f in moved])
    theta = to_pose(np.array([f.jaws for f in moved]))[:, 2]
    along = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    reactions, normals = np.array([f.reactions for f in moved]), np.array([f.normals for f in moved])
    tangential = -np.einsum("fjk,fk->fj", reactions, along)
    pressing = -np.einsum("fjk,fjk->fj", reactions, normals)
    forces = np.empty((4, POSES))
    for k, at in enumerate(1 + INCREMENTS * np.arange(1, POSES + 1)):
        near = np.flatnonzero(np.abs(progress - min(at, progress[-1])) <= INCREMENTS / 2)
        worst = near[friction[near].argmax(axis=0)]
        forces[:2, k], forces[2:, k] = tangential[worst, [0, 1]], pressing[worst, [0, 1]]
    return forces


class Elastica(Contestant):
    """Hands in the optimum at a grasp; where the judge sees the jaws slip, again with them closed a little
    further. The path that it begins with is not followed."""

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath):
        super().__init__(grasp, path)
        self.scene = scene

    def propose(self, on_increment: Callable[[], None]) -> Proposals:
        """Optimise, then close further while that slips."""
        try:
            grasp, path = optimise(self.scene, self.grasp, on_increment)
        except Unsolved as problem:
            return Verdict(f"unsolved ({problem})")
        verdict = yield grasp, path
        for _ in range(MOST_FIRMER):
            if verdict.reason != "slip":
                return None
            grasp = Grasp(grasp.x, FIRMER * grasp.compression, grasp.score)
            poses = path.poses.copy()
            poses[1:, 3] = self.scene.tissue.height - grasp.compression
            path = JawPath.from_poses(poses, KIND)
            verdict = yield grasp, path
        return None
