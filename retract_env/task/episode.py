"""One retraction under way: the jaws close, then move, until the task ends it or the physics cannot go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath, to_pose
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.registry import PhysicsPool
from retract_env.scene import Scene
from retract_env.spring import SpringModel
from retract_env.task import RetractionTask, Situation, actions, sound

Array = NDArray[np.float64]


class Episode:
    """Actions to situations, through a physics."""

    def __init__(self, task: RetractionTask, pool: PhysicsPool):
        self.task, self.pool = task, pool
        self.now: Situation = task.begin()
        self.history: list[TissueState] = [self.now.state]
        """states so far; progress counts the closing of the jaws as 1 and each move as 1 more"""
        self.grasp: Grasp | None = None
        """what the jaws hold, None before they closed"""
        self.diverged = False
        self.physics: Physics | None = None

    def act(self, action: ArrayLike) -> None:
        """One step of the task: the grasp, then moves. Raises ValueError for what is no action."""
        if self.grasp is None:
            self._close(actions.to_grasp(action, self.task.scene))
        else:
            self._move(actions.to_pose(action, to_pose(self.now.state.jaws)))
        self.now = replace(self.now, steps=self.now.steps + 1)

    def take(self, grasp: Grasp | None) -> None:
        """Close the jaws before the first step, on the spring model's best grasp where none is given.

        Raises Diverged where the tissue cannot be squeezed there, ValueError for a grasp off the flap.
        """
        for candidate in spring_grasps(self.task.scene) if grasp is None else [grasp]:
            self.diverged = False
            self._close(candidate)
            if not self.diverged:
                return
        raise Diverged(f"no grasp of scene {self.task.scene.name!r} could be squeezed")

    @property
    def path(self) -> JawPath | None:
        """Where the jaws have been since they touched the flap, None before: what a certifier follows."""
        if self.grasp is None:
            return None
        rest = np.array([self.grasp.x, 0.0, self.grasp.x, self.task.scene.tissue.height])
        return JawPath(np.array([rest, *(s.jaws for s in self.history if s.progress >= 1)]), "env")

    def _close(self, grasp: Grasp) -> None:
        tissue = self.task.scene.tissue
        grasp.check_inside(tissue.length, tissue.height)
        squeezed = np.array([grasp.x, tissue.height / 2, 0.0, tissue.height - grasp.compression])
        try:
            self.physics = self.pool.take(self.task.scene, grasp.x)
            self.physics.reset()
            state = _sound(self.physics.move_to(squeezed, 1.0))
        except (Diverged, MeshError):
            self.physics, self.diverged = None, True
            return
        self.grasp = grasp
        self._accept(state)

    def _move(self, pose: Array) -> None:
        assert self.physics is not None
        try:
            state = _sound(self.physics.move_to(pose))
        except Diverged:
            self.diverged = True
            state = self.physics.state()
            if np.array_equal(state.jaws, self.now.state.jaws):
                return
        self._accept(replace(state, progress=self.history[-1].progress + 1))

    def _accept(self, state: TissueState) -> None:
        assert self.physics is not None
        self.now = self.task.hold(self.now, self.physics.section, state)
        self.history.append(state)


def spring_grasps(scene: Scene) -> list[Grasp]:
    """The spring model's stable grasps, best first; the planners' too."""
    return SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)


def _sound(state: TissueState) -> TissueState:
    if not sound(state):
        raise Diverged("the physics answered with what is no number")
    return state
