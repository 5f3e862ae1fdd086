"""One retraction under way: the jaws close, then move, until the task ends it or the physics cannot go on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath, to_pose
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.pool import PhysicsPool
from retract_env.scene import Scene
from retract_env.spring import SpringModel
from retract_env.task import RetractionTask, Situation, actions, sound

Array = NDArray[np.float64]

MOST_GRASPS = 5
"""Stable grasps that are tried, best first, before an episode that is to begin on one is given up."""


class Episode:
    """Actions to situations, through a physics.

    A copy, also a pickled one, goes on as the original does, to the last bit: it knows the moves made so far
    and makes them again on a physics of its own before the next one.
    """

    def __init__(self, task: RetractionTask, pool: PhysicsPool):
        self.task, self.pool = task, pool
        self.now: Situation = task.begin()
        self.history: list[TissueState] = [self.now.state]
        """states so far; progress counts the closing of the jaws as 1 and each move as 1 more"""
        self.grasp: Grasp | None = None
        """what the jaws hold, None before they closed"""
        self.diverged = False
        self._physics: Physics | None = None
        self._moves: list[tuple[Array, float | None]] = []
        """poses that the jaws were sent to since the physics' reset, each with its progress"""

    @property
    def physics(self) -> Physics | None:
        """That of the flap between the jaws, None before they closed."""
        if self._physics is None and self.grasp is not None:
            physics = self.pool.take(self.task.scene, self.grasp.x, self.task.stop_when)
            physics.reset()
            for move in self._moves:
                physics.move_to(*move)
            self._physics = physics
        return self._physics

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_physics": None}

    def act(self, action: ArrayLike) -> None:
        """One step of the task: the grasp, then moves. Raises ValueError for what is no action."""
        if self.grasp is None:
            self._close(actions.to_grasp(action, self.task.scene, self.task.config))
        else:
            self._move(actions.moved(action, to_pose(self.now.state.jaws), self.task.config))
        self.now = replace(self.now, steps=self.now.steps + 1)

    def take(self, grasp: Grasp | None) -> None:
        """Close the jaws before the first step, on the spring model's best grasp where none is given.

        Raises Diverged where the tissue cannot be squeezed there, nor at the next `MOST_GRASPS` less one,
        ValueError for a grasp off the flap.
        """
        candidates = spring_grasps(self.task.scene)[:MOST_GRASPS] if grasp is None else [grasp]
        for candidate in candidates:
            self.diverged = False
            self._close(candidate)
            if not self.diverged:
                return
        tried = f"{len(candidates)} grasps" if len(candidates) > 1 else "the grasp"
        raise Diverged(f"scene {self.task.scene.name!r}: {tried} could not be squeezed")

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
            physics = self.pool.take(self.task.scene, grasp.x, self.task.stop_when)
            physics.reset()
            state = _sound(physics.move_to(squeezed, 1.0))
        except (Diverged, MeshError):
            self.diverged = True
            return
        self.grasp, self._physics, self._moves = grasp, physics, [(squeezed, 1.0)]
        self._accept(physics, state)

    def _move(self, pose: Array) -> None:
        physics = self.physics
        assert physics is not None
        try:
            state = _sound(physics.move_to(pose))
            self._moves.append((pose, None))
        except Diverged:
            self.diverged = True
            state = physics.state()
            if np.array_equal(state.jaws, self.now.state.jaws):
                return
        self._accept(physics, replace(state, progress=self.history[-1].progress + 1))

    def _accept(self, physics: Physics, state: TissueState) -> None:
        self.now = self.task.hold(self.now, physics.section, state)
        self.history.append(state)


def spring_grasps(scene: Scene) -> list[Grasp]:
    """The spring model's stable grasps, best first; the planners' too."""
    return SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)


def _sound(state: TissueState) -> TissueState:
    if not sound(state):
        raise Diverged("the physics answered with what is no number")
    return state
