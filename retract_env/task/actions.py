"""What the three numbers of an action mean: the first one of an episode a grasp, all others a move.

Numbers lie in [-1, 1]. Both meanings have their inverse here, which policies that know poses use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.grasp import Grasp
from retract_env.mesh import jaw_range
from retract_env.scene import Scene
from retract_env.task.config import TaskConfig
from retract_env.task.rules import grip_range

Array = NDArray[np.float64]

SIZE = 3
"""numbers in an action"""
DEFAULT = TaskConfig()


def checked(action: ArrayLike) -> Array:
    """The action (3,) with each number clipped to [-1, 1].

    Raises ValueError, one line, for another shape or what is not a finite number.
    """
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"action = {action!r}, allowed {SIZE} numbers".replace("\n", " ")) from None
    if numbers.shape != (SIZE,):
        raise ValueError(f"action has shape {numbers.shape}, allowed ({SIZE},)")
    if not np.isfinite(numbers).all():
        raise ValueError(f"action = {numbers.tolist()}, allowed finite numbers")
    return np.clip(numbers, -1.0, 1.0)


def _range(scene: Scene, config: TaskConfig) -> tuple[float, float, float, float, float]:
    """x of the grasps nearest to the free and to the fixed end whose jaws fit on the flap, m; what grips are
    told in, m of compression or N of force; and in that the lightest grip and the factor of `grip_range`."""
    tissue, width = scene.tissue, scene.jaws.width
    # a hair inside, because an action is a rounded number
    nearest = jaw_range(tissue.length, width)[1] * (1 + 1e-6)
    unit = tissue.modulus * width * tissue.depth if config.grip == "force" else tissue.height
    return -tissue.length, nearest, unit, *grip_range(*config.firmness, tissue.length, tissue.height)


def to_grasp(action: ArrayLike, scene: Scene, config: TaskConfig = DEFAULT) -> Grasp:
    """Grasp of a first action: -1 is the free end and the lightest grip, 1 the fixed end and the firmest.

    In between, x goes linearly and compression or force geometrically (`rules.grip_range`). The third number
    has no meaning. Raises ValueError as `checked`.
    """
    near, far, unit, lightest, most = _range(scene, config)
    along, strength = ((checked(action)[:2] + 1) / 2).tolist()
    # a rounding error may leave the range
    firmness = unit * min(max(lightest * most**strength, lightest), config.firmness[1])
    return Grasp(near + along * (far - near), **{config.grip: firmness})


def from_grasp(grasp: Grasp, scene: Scene, config: TaskConfig = DEFAULT) -> Array:
    """First action (3,) that takes this grasp, or the nearest one in range.

    Raises ValueError for one that holds otherwise than the task's.
    """
    (held_by, firmness), *_ = grasp.firmness.items()
    if held_by != config.grip:
        raise ValueError(f"grasp.{held_by} = {firmness:g}, allowed a grasp by {config.grip}, as the task's")
    near, far, unit, lightest, most = _range(scene, config)
    along = (grasp.x - near) / (far - near)
    strength = np.log(firmness / (unit * lightest)) / np.log(most)
    return np.append(np.clip([2 * along - 1, 2 * strength - 1], -1.0, 1.0), 0.0)


def moved(action: ArrayLike, pose: ArrayLike, config: TaskConfig = DEFAULT) -> Array:
    """Pose (4,) x, y, theta, separation that a move leads to. The separation stays; it is nominal where the
    jaws hold by force. Raises as `checked`."""
    found: Array = np.asarray(pose, np.float64) + np.append(checked(action) * config.move, 0.0)
    return found


def move_towards(target: ArrayLike, pose: ArrayLike, config: TaskConfig = DEFAULT) -> Array:
    """Move (3,) from one pose (4,) to another, or as far towards it as one action leads."""
    change = (np.asarray(target, np.float64) - np.asarray(pose, np.float64))[:3]
    change[2] = np.pi - (np.pi - change[2]) % (2 * np.pi)  # the shorter way round
    wanted = change / config.move
    return wanted / max(1.0, float(np.abs(wanted).max()))
