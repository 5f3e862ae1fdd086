"""Retractions as they may turn out: a scene and a plan with what is not known drawn from the scene's prior.

A draw is a row of numbers in [-1, 1], one for each of UNKNOWNS, 0 in the middle of its range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import jaw_range
from retract_env.scene import UNKNOWNS, Limits, LineOfSight, Scene

Array = NDArray[np.float64]


def draws(count: int, seed: int) -> Array:
    """(count, UNKNOWNS), uniform and independent."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(UNKNOWNS)))


class Values(NamedTuple):
    """What n draws come to, (n,) each."""

    modulus: Array
    """factor"""
    vein_modulus: Array
    """factor, against the tissue"""
    poisson: Array
    weight: Array
    """factor"""
    thickness: Array
    """factor"""
    friction: Array
    """factor"""
    grasp: Array
    """m, by which the jaw path is shifted along the flap"""
    closing: Array
    """m, by which the jaws close further"""
    force: Array
    """factor of the grip's force"""
    jaw_width: Array
    """factor"""
    target: Array
    """m, by which B is shifted along the bed"""


def values(scene: Scene, z: ArrayLike, force: float = math.nan) -> Values:
    """What draws z (n, UNKNOWNS) come to in this scene; force: N, of the grip, where it has one.

    Where a shift would lead off the flap, B stays on it.
    """
    z = np.atleast_2d(np.asarray(z, float))
    u = scene.uncertainty
    column = dict(zip(UNKNOWNS, z.T, strict=True))

    def factor(name: str) -> Array:
        return 1.0 + getattr(u, name) * column[name]

    if u.poisson is None:
        poisson = np.full(len(z), scene.tissue.poisson)
    else:
        low, high = u.poisson
        poisson = (low + high) / 2 + (high - low) / 2 * column["poisson"]
    half = max(u.force, u.force_floor / force) if force > 0 else u.force
    near, far = -1e-6 * scene.tissue.length, -(1 - 1e-6) * scene.tissue.length
    target_x = scene.line_of_sight.target[0]
    return Values(
        factor("modulus"),
        factor("vein_modulus"),
        poisson,
        factor("weight"),
        factor("thickness"),
        factor("friction"),
        u.grasp * column["grasp"],
        u.closing * column["closing"],
        1.0 + half * column["force"],
        factor("jaw_width"),
        np.clip(target_x + u.target * column["target"], far, near) - target_x,
    )


class _One(NamedTuple):
    """What one draw comes to: fields of `Values`."""

    modulus: float
    vein_modulus: float
    poisson: float
    weight: float
    thickness: float
    friction: float
    grasp: float
    closing: float
    force: float
    jaw_width: float
    target: float


def scenario(scene: Scene, grasp: Grasp, path: JawPath, z: ArrayLike) -> tuple[Scene, Grasp, JawPath] | None:
    """Scene, grasp and path of one draw z (UNKNOWNS,); None where the jaws do not close on the flap at all.

    The gripper yields across the flap, so that it closes about the middle of a thicker flap too. Jaws that
    would stand off the flap stand at its end.
    """
    v = _One(*(float(a[0]) for a in values(scene, z, grasp.force or math.nan)))
    tissue, limits, line = scene.tissue, scene.limits, scene.line_of_sight
    height = v.thickness * tissue.height
    veins = tuple(
        vein.model_copy(
            update={
                "outline": tuple((x, v.thickness * y) for x, y in vein.outline),
                "modulus": v.modulus * v.vein_modulus * vein.modulus,
                "poisson": v.poisson if scene.uncertainty.poisson else vein.poisson,
            }
        )
        for vein in tissue.veins
    )
    there = scene.model_copy(
        update={
            "tissue": tissue.model_copy(
                update={
                    "height": height,
                    "density": v.weight * tissue.density,
                    "modulus": v.modulus * tissue.modulus,
                    "poisson": v.poisson,
                    "veins": veins,
                }
            ),
            "limits": Limits(
                strain=limits.strain,
                friction=min(5.0, float(v.friction) * limits.friction),
                clearance=limits.clearance,
            ),
            "jaws": scene.jaws.model_copy(
                update={"width": min(v.jaw_width * scene.jaws.width, tissue.length / 4 * (1 - 1e-9))}
            ),
            "line_of_sight": LineOfSight(
                camera=(min(line.camera[0], line.target[0] + v.target), line.camera[1]),
                target=(line.target[0] + v.target, 0.0),
            ),
        }
    )
    x = float(np.clip(grasp.x + v.grasp, *jaw_range(tissue.length, there.jaws.width)))
    poses = path.poses.copy()
    poses[:, 0] += x - grasp.x
    poses[:, 1] += (height - tissue.height) / 2
    poses[0, 3] = height
    if grasp.force is not None:
        force = v.force * grasp.force
        return None if force <= 0 else (there, Grasp(x, force=force), JawPath.from_poses(poses, path.kind))
    poses[1:, 3] -= v.closing
    compression = height - float(poses[1, 3])
    if not 0 < compression < height or poses[:, 3].min() <= 0:
        return None
    return there, Grasp(x, compression), JawPath.from_poses(poses, path.kind)
