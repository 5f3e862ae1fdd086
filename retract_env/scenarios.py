"""Retractions as they may turn out: a scene and a plan with what is not known drawn from the scene's prior.

A draw is a row of numbers in [-1, 1], one for each of UNKNOWNS, 0 in the middle of its range.

What a draw makes of a scene's numbers (`turn_out`) and of a grasp (`close_on`) is compiled, because batches
of environments draw thousands of flaps a second; `scenario` and single environments use the same (`Drawn`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp, JawPath
from retract_env.mesh.jaws import SLIVER
from retract_env.scene import UNKNOWNS, LineOfSight, Scene

Array = NDArray[np.float64]


PLANNERS_SEED = 20_091_011
"""Of the draws that planners plan with; what is stated of a plan is stated of others."""


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


# The prior as a row of numbers: ranges in the order of UNKNOWNS, that of Poisson's ratio halved, then the
# least half range of the force, N, and the middle of the range of Poisson's ratio
(
    _MODULUS, _VEIN_MODULUS, _POISSON, _WEIGHT, _THICKNESS, _FRICTION, _GRASP, _CLOSING, _FORCE, _JAW_WIDTH,
    _TARGET,
) = range(len(UNKNOWNS))  # fmt: skip
_FLOOR, _MIDDLE = len(UNKNOWNS), len(UNKNOWNS) + 1
PRIOR = len(UNKNOWNS) + 2

# What a draw changes of a scene, and what one has to know for it, as a row of numbers, SI units. THICKER and
# STIFFER: factors of the veins' y and moduli; SHIFT, CLOSER: m, by which the jaw path is shifted along the
# flap, and by which the jaws close further. In a scene as it is stated the last four are 1, 1, 0, 0.
LENGTH, HEIGHT, DENSITY, GRAVITY, MODULUS, POISSON, FRICTION, JAW_WIDTH, CAMERA_X, TARGET_X = range(10)
THICKER, STIFFER, SHIFT, CLOSER = range(10, 14)
NUMBERS = 14

# Where jaws turn out to close: x and separation, m, force, N; and by how much, m, they are off in x and in y
# from where they were sent to, and have closed further
X, SEPARATION, HOLDS_BY, OFF_X, OFF_Y, CLOSED_FURTHER = range(6)
CLOSED = 6


def prior_numbers(scene: Scene) -> Array:
    """(PRIOR,) of the scene's uncertainty."""
    u = scene.uncertainty
    low, high = u.poisson or (scene.tissue.poisson,) * 2
    ranges = [(high - low) / 2 if name == "poisson" else getattr(u, name) for name in UNKNOWNS]
    return np.array([*ranges, u.force_floor, (low + high) / 2 if u.poisson else low])


def stated_numbers(scene: Scene) -> Array:
    """(NUMBERS,) of the scene as it is stated."""
    tissue, line = scene.tissue, scene.line_of_sight
    flap = (tissue.length, tissue.height, tissue.density, scene.gravity, tissue.modulus, tissue.poisson)
    others = (scene.limits.friction, scene.jaws.width, line.camera[0], line.target[0])
    return np.array([*flap, *others, 1.0, 1.0, 0.0, 0.0])


# No fastmath: every number has to be rounded as Python rounds it.
@njit(cache=True, nogil=True, error_model="numpy")
def _force_factor(prior: Array, z: Array, force: float) -> float:
    half = max(prior[_FORCE], prior[_FLOOR] / force) if force > 0 else prior[_FORCE]
    return float(1.0 + half * z[_FORCE])


@njit(cache=True, nogil=True, error_model="numpy")
def _value(prior: Array, z: Array, length: float, target_x: float, force: float, out: Array) -> None:
    """What one draw comes to, into out (UNKNOWNS,), as `Values` has them."""
    for k in range(len(out)):
        out[k] = 1.0 + prior[k] * z[k]
    out[_POISSON] = prior[_MIDDLE] + prior[_POISSON] * z[_POISSON]
    out[_GRASP], out[_CLOSING] = prior[_GRASP] * z[_GRASP], prior[_CLOSING] * z[_CLOSING]
    out[_FORCE] = _force_factor(prior, z, force)
    near, far = max(-1e-6 * length, target_x), min(-(1 - 1e-6) * length, target_x)
    out[_TARGET] = min(max(target_x + prior[_TARGET] * z[_TARGET], far), near) - target_x


@njit(cache=True, nogil=True, error_model="numpy")
def _values(prior: Array, z: Array, length: float, target_x: float, force: float, out: Array) -> None:
    for i in range(len(z)):
        _value(prior, z[i], length, target_x, force, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def turn_out(stated: Array, prior: Array, z: Array, out: Array) -> None:
    """What a draw z (UNKNOWNS,) makes of a scene: out (NUMBERS,) from stated (NUMBERS,); prior: (PRIOR,)."""
    v = np.empty(len(z))
    _value(prior, z, stated[LENGTH], stated[TARGET_X], np.nan, v)
    out[LENGTH], out[GRAVITY] = stated[LENGTH], stated[GRAVITY]
    out[HEIGHT] = v[_THICKNESS] * stated[HEIGHT]
    out[DENSITY] = v[_WEIGHT] * stated[DENSITY]
    out[MODULUS] = v[_MODULUS] * stated[MODULUS]
    out[POISSON] = v[_POISSON]
    out[FRICTION] = min(5.0, v[_FRICTION] * stated[FRICTION])
    out[JAW_WIDTH] = min(v[_JAW_WIDTH] * stated[JAW_WIDTH], stated[LENGTH] / 4 * (1 - 1e-9))
    out[TARGET_X] = stated[TARGET_X] + v[_TARGET]
    out[CAMERA_X] = min(stated[CAMERA_X], out[TARGET_X])
    out[THICKER], out[STIFFER] = v[_THICKNESS], v[_MODULUS] * v[_VEIN_MODULUS]
    out[SHIFT], out[CLOSER] = v[_GRASP], v[_CLOSING]


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_outs(stated: Array, prior: Array, z: Array, out: Array) -> None:
    for i in range(len(z)):
        turn_out(stated, prior, z[i], out[i])


def turned_out(scene: Scene, z: ArrayLike) -> Array:
    """(n, NUMBERS), what draws z (n, UNKNOWNS) make of a scene. Raises ValueError for another shape."""
    rows = _draws(z)
    out = np.empty((len(rows), NUMBERS))
    _turn_outs(stated_numbers(scene), prior_numbers(scene), rows, out)
    return out


def _draws(z: ArrayLike) -> Array:
    """(n, UNKNOWNS), one after the other in memory."""
    rows = np.ascontiguousarray(np.atleast_2d(np.asarray(z, float)))
    if rows.shape[1:] != (len(UNKNOWNS),):
        raise ValueError(f"draws have shape {rows.shape}, allowed (n, {len(UNKNOWNS)})")
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def shifted(x: Any, shift: Any, length: float, width: Any) -> Any:
    """Where jaws stand, m, along the flap, that were sent to x, m: off by a shift, m, but on the flap.

    One that was sent beyond the free end's half patch goes no further. length, width: m, of flap and jaws.
    """
    nearest = -(0.5 + SLIVER) * width
    farthest = np.minimum(np.minimum(-length + width / 2, nearest), x)
    return np.minimum(np.maximum(x + shift, farthest), nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def close_on(
    height: float,
    numbers: Array,
    prior: Array,
    z: Array,
    x: float,
    separation: float,
    force: float,
    out: Array,
) -> bool:
    """Where jaws turn out to close that are sent to x, m, to close to a separation, m, or until they press
    with a force, N, nan without one: into out (CLOSED,). False where they do not close on the flap at all.

    height: m, of the flap as it is stated; numbers: (NUMBERS,) as it turns out.
    """
    out[X] = shifted(x, numbers[SHIFT], numbers[LENGTH], numbers[JAW_WIDTH])
    out[OFF_X], out[OFF_Y], out[CLOSED_FURTHER] = out[X] - x, (numbers[HEIGHT] - height) / 2, 0.0
    out[SEPARATION], out[HOLDS_BY] = separation, force
    if not math.isnan(force):
        out[HOLDS_BY] = _force_factor(prior, z, force) * force
        return bool(out[HOLDS_BY] > 0.0)
    out[SEPARATION], out[CLOSED_FURTHER] = separation - numbers[CLOSER], numbers[CLOSER]
    return bool(0.0 < numbers[HEIGHT] - out[SEPARATION] < numbers[HEIGHT])


def values(scene: Scene, z: ArrayLike, force: float = math.nan) -> Values:
    """What draws z (n, UNKNOWNS) come to in this scene; force: N, of the grip, where it has one.

    Where a shift would lead off the flap, B stays on it.
    """
    rows = _draws(z)
    out = np.empty_like(rows)
    target_x = scene.line_of_sight.target[0]
    _values(prior_numbers(scene), rows, scene.tissue.length, target_x, force, out)
    return Values(*np.ascontiguousarray(out.T))


class Drawn:
    """A scene as it turns out in one draw."""

    def __init__(self, stated: Scene, z: ArrayLike):
        """stated: the scene as it is said to be; z: (UNKNOWNS,)."""
        self.stated, self.z = stated, np.array(z, float)
        self._prior, self._numbers = prior_numbers(stated), np.empty(NUMBERS)
        turn_out(stated_numbers(stated), self._prior, self.z, self._numbers)
        self.scene = _scene(stated, self._numbers.tolist())
        """what there is"""

    def close(self, grasp: Grasp, separation: float) -> tuple[Grasp, float, Array] | None:
        """What comes of jaws that are sent to close like this, to a separation, m: the grasp, the separation
        (as sent, where they close by force), and (3,) m, by how much they are off in x and in y from where
        they were sent to, and have closed further. None where they do not close on the flap at all."""
        out, height = np.empty(CLOSED), self.stated.tissue.height
        force = math.nan if grasp.force is None else grasp.force
        if not close_on(height, self._numbers, self._prior, self.z, grasp.x, separation, force, out):
            return None
        x, there, force, *_ = out.tolist()
        if grasp.force is not None:
            return Grasp(x, force=force), there, out[OFF_X:]
        return Grasp(x, self.scene.tissue.height - there), there, out[OFF_X:]


def _scene(stated: Scene, numbers: list[float]) -> Scene:
    """The scene that has these numbers, and all else as it is stated."""
    tissue, poisson = stated.tissue, numbers[POISSON]
    veins = tuple(
        vein.model_copy(
            update={
                "outline": tuple((x, numbers[THICKER] * y) for x, y in vein.outline),
                "modulus": numbers[STIFFER] * vein.modulus,
                "poisson": poisson if stated.uncertainty.poisson else vein.poisson,
            }
        )
        for vein in tissue.veins
    )
    flap = {
        "height": numbers[HEIGHT],
        "density": numbers[DENSITY],
        "modulus": numbers[MODULUS],
        "poisson": poisson,
        "veins": veins,
    }
    line = stated.line_of_sight
    return stated.model_copy(
        update={
            "tissue": tissue.model_copy(update=flap),
            "limits": stated.limits.model_copy(update={"friction": numbers[FRICTION]}),
            "jaws": stated.jaws.model_copy(update={"width": numbers[JAW_WIDTH]}),
            "line_of_sight": LineOfSight(
                camera=(numbers[CAMERA_X], line.camera[1]), target=(numbers[TARGET_X], 0.0)
            ),
        }
    )


def scenario(scene: Scene, grasp: Grasp, path: JawPath, z: ArrayLike) -> tuple[Scene, Grasp, JawPath] | None:
    """Scene, grasp and path of one draw z (UNKNOWNS,); None where the jaws do not close on the flap at all.

    The gripper yields across the flap, so that it closes about the middle of a thicker flap too. Jaws that
    would stand off the flap stand at its end.
    """
    drawn = Drawn(scene, z)
    closed = drawn.close(grasp, float(path.poses[1, 3]))
    if closed is None:
        return None
    held, _, off = closed
    poses = path.poses.copy()
    poses[:, :2] += off[:2]
    poses[1:, 3] -= off[2]
    poses[0, 3] = drawn.scene.tissue.height
    if poses[:, 3].min() <= 0:
        return None
    return drawn.scene, held, JawPath.from_poses(poses, path.kind)
