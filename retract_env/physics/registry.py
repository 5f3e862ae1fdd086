"""Physics by name, and the last few flaps kept for when an episode begins on one of them again."""

from __future__ import annotations

import importlib.util
from collections import OrderedDict

from retract_env.config import BULLET
from retract_env.objectives import verdict
from retract_env.physics.base import Physics, TissueState
from retract_env.scene import Scene

DEFAULT_RESOLUTION = {"bullet": "medium", "fem": "coarse"}
"""Physics by name, and what each is made with unless told otherwise."""


def check_physics(name: str, resolution: str) -> None:
    """Raise ValueError for an unknown name, ImportError where pybullet is missing, with what to install."""
    if name not in DEFAULT_RESOLUTION:
        raise ValueError(f"physics = {name!r}, allowed {', '.join(DEFAULT_RESOLUTION)}")
    if name == "bullet":
        if importlib.util.find_spec("pybullet") is None:
            raise ImportError(
                f'physics = "bullet" needs pybullet: {BULLET}; '
                "TissueRetractFEM-v0, on the finite elements, needs nothing more"
            )
        from retract_env.physics.bullet.flap import BULLET_RESOLUTIONS

        allowed = list(BULLET_RESOLUTIONS)
    else:
        from retract_env.mesh import RESOLUTIONS

        allowed = list(RESOLUTIONS)
    if resolution not in allowed:
        raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(allowed)}")


def make_physics(name: str, scene: Scene, jaw_x: float, resolution: str) -> Physics:
    """One flap between jaws at jaw_x, m. Raises as its constructor; a move ends where a limit is broken."""
    limits = scene.limits

    def broken(state: TissueState) -> bool:
        found = verdict(
            state.max_strain, state.required_friction, state.clearance, limits.strain, limits.friction
        )
        return state.progress >= 1 and found not in (None, "ok")

    if name == "bullet":
        from retract_env.physics.bullet.flap import BulletPhysics

        return BulletPhysics(scene, jaw_x, resolution, stop_when=broken)
    from retract_env.physics.fem import FemPhysics

    return FemPhysics(scene, jaw_x, resolution, stop_when=broken)


class PhysicsPool:
    """Gives out physics of one name and resolution, one at a time; the same flap and grasp the same again."""

    def __init__(self, name: str, resolution: str, size: int = 2):
        """size: flaps kept. Raises as `check_physics`."""
        check_physics(name, resolution)
        self.name, self.resolution, self.size = name, resolution, size
        self._kept: OrderedDict[tuple[str, float], Physics] = OrderedDict()

    def take(self, scene: Scene, jaw_x: float) -> Physics:
        """The physics, to be reset before use; it is closed after `size` others were taken."""
        key = scene.hash, jaw_x
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        physics = make_physics(self.name, scene, jaw_x, self.resolution)
        self._kept[key] = physics
        while len(self._kept) > self.size:
            self._kept.popitem(last=False)[1].close()
        return physics

    def close(self) -> None:
        """Close all."""
        while self._kept:
            self._kept.popitem()[1].close()
