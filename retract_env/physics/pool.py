"""The last few flaps of an environment, kept for when an episode begins on one of them again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from retract_env.physics.registry import physics_kind

if TYPE_CHECKING:
    from retract_env.physics.base import Physics, TissueState
    from retract_env.scene import Scene


class PhysicsPool:
    """Gives out physics of one kind and resolution, one at a time; the same flap and grasp the same again.

    A copy of it, also a pickled one, is as good and begins empty.
    """

    def __init__(self, name: str, resolution: str | None = None, size: int = 2):
        """resolution: None is the kind's own; size: flaps kept.

        Raises ValueError for an unknown name or resolution, ImportError where a package is missing.
        """
        self.kind = physics_kind(name)
        self.resolution, self.size = resolution or self.kind.resolution, size
        self.kind.check(self.resolution)
        self._kept: OrderedDict[tuple[str, float, bool, float | None], Physics] = OrderedDict()

    def take(
        self,
        scene: Scene,
        jaw_x: float,
        stop_when: Callable[[TissueState], bool] | None = None,
        force: float | None = None,
    ) -> Physics:
        """The physics, to be reset before use; it is closed after `size` others were taken.

        stop_when, force: as `PhysicsKind.make` has them; the first must depend on nothing but the scene.
        """
        key = scene.hash, jaw_x, stop_when is None, force
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        physics = self.kind.make(scene, jaw_x, self.resolution, stop_when, force)
        self._kept[key] = physics
        while len(self._kept) > self.size:
            self._kept.popitem(last=False)[1].close()
        return physics

    def close(self) -> None:
        """Close all."""
        while self._kept:
            self._kept.popitem()[1].close()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_kept": OrderedDict()}
