"""Retractions on the rod, thousands of them: a plan on flaps as they may be, and many plans on one flap."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env import scenarios
from retract_env.physics.rod import flap_numbers, laws, sight_numbers
from retract_env.rod.flap import HEIGHT, JAW_WIDTH, MODULUS, POISSON, SPECIFIC_WEIGHT
from retract_env.rod.follow import Followed, Retractions, follow
from retract_env.rod.measures import CAMERA_X, TARGET_X
from retract_env.scene import UNKNOWNS, Scene
from retract_env.spring.columns import veins_of
from retract_env.threads import cores

Array = NDArray[np.float64]

ARRAYS = ("flap", "sight", "factors", "friction", "shift", "closing", "z")
"""Of `Flaps`, a row a flap."""


class Flaps:
    """One scene's flap as it may be: k of them."""

    def __init__(self, scene: Scene, z: ArrayLike | None = None):
        """z: (k, UNKNOWNS) draws; None: the scene itself alone."""
        self.scene = scene
        self.veins = veins_of(scene.tissue)
        flap, sight = flap_numbers(scene), sight_numbers(scene)
        if z is None:
            self.flap, self.sight, self.factors = flap[None], sight[None], np.ones((1, 2))
            self.friction = np.array([scene.limits.friction])
            self.shift, self.closing = np.zeros(1), np.zeros(1)
            self.z = np.zeros((1, len(UNKNOWNS)))
            return
        drawn = scenarios.turned_out(scene, z)
        k = len(drawn)
        self.flap, self.sight = np.tile(flap, (k, 1)), np.tile(sight, (k, 1))
        self.flap[:, HEIGHT] = drawn[:, scenarios.HEIGHT]
        self.flap[:, MODULUS] = drawn[:, scenarios.MODULUS]
        self.flap[:, POISSON] = drawn[:, scenarios.POISSON]
        self.flap[:, SPECIFIC_WEIGHT] = drawn[:, scenarios.DENSITY] * drawn[:, scenarios.GRAVITY]
        self.flap[:, JAW_WIDTH] = drawn[:, scenarios.JAW_WIDTH]
        self.sight[:, CAMERA_X] = drawn[:, scenarios.CAMERA_X]
        self.sight[:, TARGET_X] = drawn[:, scenarios.TARGET_X]
        self.factors = drawn[:, [scenarios.THICKER, scenarios.STIFFER]]
        self.friction = drawn[:, scenarios.FRICTION]
        self.shift, self.closing = drawn[:, scenarios.SHIFT], drawn[:, scenarios.CLOSER]
        self.z = np.atleast_2d(np.asarray(z, float))

    def __len__(self) -> int:
        return len(self.flap)

    def joined(self, other: Flaps) -> Flaps:
        """These and others of the same scene."""
        out = Flaps(self.scene)
        for name in ARRAYS:
            setattr(out, name, np.concatenate([getattr(self, name), getattr(other, name)]))
        return out

    def chosen(self, rows: ArrayLike) -> Flaps:
        """Some of them."""
        out = Flaps(self.scene)
        for name in ARRAYS:
            setattr(out, name, getattr(self, name)[np.asarray(rows)])
        return out

    def pressing(self, force: ArrayLike) -> Array:
        """(k, m) N, with which jaws turn out to press that are told to press with forces (m,), N; 0 for those
        that are told none, -1 for those that turn out to press with none."""
        told = np.asarray(force, float)
        factor = [scenarios.values(self.scene, self.z, f).force for f in told.tolist()]
        pressed = told * np.stack(factor, axis=-1)
        return np.where((told > 0) & (pressed <= 0), -1.0, pressed)

    def follow(
        self, x: ArrayLike, poses: ArrayLike, goal: float = math.inf, force: ArrayLike | None = None
    ) -> Followed:
        """Follow m plans on each of the k flaps: row i * m + j is plan j on flap i.

        x: (m,) m, where they grasp; poses: (m, t, 4) x, y, theta and separation, m, as the plan has them;
        goal: m, the clearance with which a retraction is over; force: (m,) N, of grips by force, 0
        for others. Where jaws turn out to press with nothing the flap is lost.
        """
        x, poses = np.asarray(x, float), np.asarray(poses, float)
        k, (m, t, _) = len(self), poses.shape
        height = self.flap[:, HEIGHT]
        width = self.flap[:, JAW_WIDTH, None]
        at = scenarios.shifted.py_func(x, self.shift[:, None], self.scene.tissue.length, width)
        all_poses = np.empty((k, m, t, 4))
        all_poses[:] = poses
        all_poses[..., 0] += (at - x)[..., None]
        all_poses[..., 1] += ((height - self.scene.tissue.height) / 2)[:, None, None]
        separation = poses[..., 3] - self.closing[:, None, None]
        all_poses[..., 3] = 1 - separation / height[:, None, None]
        pressed = np.zeros((k, m)) if force is None else self.pressing(force)
        return follow(
            Retractions(
                np.repeat(self.flap, m, axis=0),
                np.repeat(self.sight, m, axis=0),
                *self.veins,
                np.repeat(self.factors, m, axis=0),
                at.ravel(),
                all_poses.reshape(k * m, t, 4),
                pressed.ravel(),
                np.full(k * m, goal),
            ),
            *laws(),
            cores(),
        )
