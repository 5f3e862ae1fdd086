"""One retraction under way: the jaws close, then move, until the task ends it or the physics cannot go on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.errors import Diverged, FlapRefused, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.base import Physics, Restorable, TissueState
from retract_env.physics.pool import PhysicsPool
from retract_env.scene import Scene
from retract_env.spring import SpringModel, by_force, expected_compression
from retract_env.task import RetractionTask, Situation, TaskConfig, actions, sound

Array = NDArray[np.float64]

MOST_GRASPS = 5
"""Stable grasps that are tried, best first, before an episode that is to begin on one is given up."""


@dataclass(frozen=True, repr=False, eq=False)
class EpisodeState:
    """Where an episode stood, for `Episode.set_state`. It can be pickled; not to be changed."""

    stated: Scene
    z: Array | None
    """(UNKNOWNS,) the draw that made of it what there is; None: it is as stated"""
    now: Situation
    history: tuple[TissueState, ...]
    grasp: Grasp | None
    diverged: bool
    moves: tuple[tuple[Array, float | None], ...]
    physics: object
    """state of a `Restorable` physics; None without one, and before the jaws closed"""


class Episode:
    """Actions to situations, through a physics.

    A copy, also a pickled one, and an episode whose state was set go on as the original does, to the last
    bit. Before its next move such an episode brings a physics of its own to where the original's stood: by
    its state where the physics has one (`Restorable`), else by making all moves again.
    """

    def __init__(self, task: RetractionTask, pool: PhysicsPool):
        self.task, self.pool = task, pool
        self.now: Situation = task.begin()
        self.history: list[TissueState] = [self.now.state]
        """states so far; progress counts the closing of the jaws as 1 and each move as 1 more"""
        self.grasp: Grasp | None = None
        """what the jaws hold, None before they closed; as it turned out, as all poses here"""
        self.diverged = False
        self._physics: Physics | None = None
        self._moves: list[tuple[Array, float | None]] = []
        """poses that the jaws were sent to since the physics' reset, each with its progress"""
        self._stood: object = None
        """the state to bring the physics to when it is needed; None: by making the moves"""

    @property
    def physics(self) -> Physics | None:
        """That of the flap between the jaws, None before they closed."""
        if self._physics is None and self.grasp is not None:
            grasp = self.grasp
            physics = self.pool.take(self.task.scene, grasp.x, self.task.stop_when, grasp.force)
            if self._stood is not None and isinstance(physics, Restorable):
                physics.set_state(self._stood)
            else:
                physics.reset()
                for move in self._moves:
                    physics.move_to(*move)
            self._physics, self._stood = physics, None
        return self._physics

    def _physics_state(self) -> object:
        if self._physics is None:
            return self._stood
        return self._physics.get_state() if isinstance(self._physics, Restorable) else None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_physics": None, "_stood": self._physics_state()}

    def get_state(self) -> EpisodeState:
        """Where the episode stands; it does not change when the episode goes on."""
        task, history, moves = self.task, tuple(self.history), tuple(self._moves)
        return EpisodeState(
            task.stated, task.z, self.now, history, self.grasp, self.diverged, moves, self._physics_state()
        )

    def set_state(self, state: EpisodeState) -> None:
        """Stand where an episode of the same task stood, on a pool of the same kind, be it in another
        process."""
        self.now, self.history = state.now, list(state.history)
        self.grasp, self.diverged = state.grasp, state.diverged
        self._physics, self._moves, self._stood = None, list(state.moves), state.physics

    def act(self, action: ArrayLike) -> None:
        """One step of the task: the grasp, then moves.

        Raises ValueError for what is no action, FlapRefused where the physics takes no such flap.
        """
        if self.now.missed:
            actions.checked(action)  # nothing is left to do
        elif self.grasp is None:
            self._close(actions.to_grasp(action, self.task.stated, self.task.config))
        else:
            self._move(actions.moved(action, self._moves[-1][0], self.task.config))
        self.now = replace(self.now, steps=self.now.steps + 1)

    def take(self, grasp: Grasp | None) -> None:
        """Close the jaws before the first step, on the spring model's best grasp where none is given.

        Raises Diverged where the tissue cannot be squeezed there, nor at the next `MOST_GRASPS` less one, or
        where the spring model knows no grasp; ValueError for a grasp off the flap, its kind FlapRefused where
        the physics takes no such flap.
        """
        stated = self.task.stated
        candidates = spring_grasps(stated)[:MOST_GRASPS] if grasp is None else [grasp]
        if not candidates:
            raise Diverged(f"scene {stated.name!r}: the spring model knows no grasp of its flap")
        for candidate in candidates:
            self.diverged = False
            self._close(candidate if grasp else held(stated, candidate, self.task.config))
            if not self.diverged:
                return
        tried = f"{len(candidates)} grasps" if len(candidates) > 1 else "the grasp"
        raise Diverged(f"scene {stated.name!r}: {tried} could not be squeezed")

    @property
    def path(self) -> JawPath | None:
        """Where the jaws have been since they touched the flap, None before: what a certifier follows."""
        if self.grasp is None:
            return None
        rest = np.array([self.grasp.x, 0.0, self.grasp.x, self.task.scene.tissue.height])
        return JawPath(np.array([rest, *(s.jaws for s in self.history if s.progress >= 1)]), "env")

    def _close(self, grasp: Grasp) -> None:
        stated, scene = self.task.stated.tissue, self.task.scene
        grasp.check_inside(stated.length, stated.height)
        off = np.zeros(3)
        if self.task.drawn is None:
            separation = scene.tissue.height - expected_compression(scene, grasp)
        else:
            found = self.task.drawn.close(grasp, stated.height - grasp.compression)
            if found is None:
                self.now = self.task.miss(self.now)
                return
            grasp, separation, off = found
            if grasp.force is not None:  # only where the search for it begins
                separation = scene.tissue.height - expected_compression(scene, grasp)
        squeezed = np.array([grasp.x, scene.tissue.height / 2, 0.0, separation])
        try:
            physics = self.pool.take(self.task.scene, grasp.x, self.task.stop_when, grasp.force)
            physics.reset()
            state = _sound(physics.move_to(squeezed, 1.0))
        except FlapRefused:
            raise
        except (Diverged, MeshError):  # there; elsewhere it may be grasped
            self.diverged = True
            return
        self.now = replace(self.now, off=off)
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
            if not sound(state) or np.array_equal(state.jaws, self.now.state.jaws):
                return
        self._accept(physics, replace(state, progress=self.history[-1].progress + 1))

    def _accept(self, physics: Physics, state: TissueState) -> None:
        self.now = self.task.hold(self.now, physics.section, state)
        self.history.append(state)


def spring_grasps(scene: Scene) -> list[Grasp]:
    """The spring model's stable grasps, best first; the planners' too."""
    return SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)


def held(scene: Scene, grasp: Grasp, config: TaskConfig) -> Grasp:
    """The spring model's grasp as the task's jaws hold: by compression, or as hard by force."""
    return by_force(scene, grasp) if config.grip == "force" else grasp


def _sound(state: TissueState) -> TissueState:
    if not sound(state):
        raise Diverged("the physics answered with what is no number")
    return state
