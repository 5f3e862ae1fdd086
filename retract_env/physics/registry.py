"""Physics by name: what each is made with, its environment, what has to be installed for it.

A physics is a class as `base.Physics` describes, in a file of its own. A line in `PHYSICS` adds it: the
environments, recipes, benchmarks and the console list what they find there.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from retract_env.physics.base import Physics, TissueState
    from retract_env.scene import Scene

Given = TypeVar("Given", bound="Scene | str")

_IN_A_CHECKOUT = not (Path(__file__).parents[1] / "configs").is_dir()
BULLET = "make bullet" if _IN_A_CHECKOUT else 'pip install "retract[bullet]"'
"""The command that installs PyBullet, in a checkout or elsewhere; without wheels it compiles for minutes."""


@dataclass(frozen=True)
class PhysicsKind:
    """One way to compute how a flap behaves."""

    name: str
    env_id: str
    """Gymnasium's id of the environment that runs on it"""
    source: str | Callable[..., Physics]
    """The class, or "module:Class", which is imported when it is first needed. It is made with (scene, jaw_x,
    resolution, stop_when=None, force=None), and its attribute `resolutions` lists the names that it takes."""
    resolution: str
    """what it is made with unless told otherwise"""
    about: str
    """in a few words, for messages"""
    vector: str | None = None
    """"module:Class" of the environment that runs many at once, if there is one"""
    needs: str = ""
    """a package that has to be installed besides, if any"""
    install: str = ""
    """the command that installs it"""
    any_law: bool = False
    """whether it follows what a scene's `material` says, and not the neo-Hookean law alone"""

    def load(self) -> Any:
        """The class."""
        if not isinstance(self.source, str):
            return self.source
        module, _, name = self.source.partition(":")
        return getattr(importlib.import_module(module), name)

    @property
    def resolutions(self) -> tuple[str, ...]:
        """Names of the meshes that it can be made with."""
        return tuple(self.load().resolutions)

    @property
    def missing(self) -> str:
        """What an ImportError says where the package that it needs is not installed, in one line."""
        others = [f"{kind.env_id}, on {kind.about}," for kind in PHYSICS.values() if not kind.needs]
        instead = f"; {' or '.join(others)} needs nothing more" if others else ""
        return f'physics = "{self.name}" needs {self.needs}: {self.install}{instead}'

    def check(self, resolution: str) -> None:
        """Raise ImportError where a package is missing, with the command that installs it, and ValueError for
        an unknown resolution."""
        if self.needs and importlib.util.find_spec(self.needs) is None:
            raise ImportError(self.missing)
        if resolution not in self.resolutions:
            raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(self.resolutions)}")

    def accepted(self, scene: Given) -> Given:
        """The scene, or the word that stands for one. Raises SceneError for tissue of a law that this physics
        does not know."""
        if not self.any_law and not isinstance(scene, str):
            scene.needs_neo_hookean(f"on {self.about}")
        return scene

    def make(
        self,
        scene: Scene,
        jaw_x: float,
        resolution: str,
        stop_when: Callable[[TissueState], bool] | None = None,
        force: float | None = None,
    ) -> Physics:
        """One flap between jaws at jaw_x, m. Raises as `accepted` and its constructor.

        stop_when: where a move cannot be made whole, it ends at the first state on its way that this is true
        of. force: N, that the jaws hold by, whatever separation they are told; None: by the separation.
        """
        # one of another package may know no force, which is its own to say
        held = {} if force is None else {"force": force}
        physics: Physics = self.load()(self.accepted(scene), jaw_x, resolution, stop_when=stop_when, **held)
        return physics


PHYSICS = {
    kind.name: kind
    for kind in (
        PhysicsKind(
            "bullet",
            "TissueRetract-v0",
            "retract_env.physics.bullet.flap:BulletPhysics",
            resolution="medium",
            about="a soft body of PyBullet",
            needs="pybullet",
            install=BULLET,
        ),
        PhysicsKind(
            "fem",
            "TissueRetractFEM-v0",
            "retract_env.physics.fem:FemPhysics",
            resolution="coarse",
            about="the finite elements",
            any_law=True,
        ),
        PhysicsKind(
            "rod",
            "TissueRetractRod-v0",
            "retract_env.physics.rod:RodPhysics",
            resolution="rod",
            about="a planar rod",
            vector="retract_env.vector:TissueRetractVectorEnv",
        ),
    )
}
"""Every physics by its name; `retract_env.register_physics` adds those of other packages."""


def physics_kind(name: str) -> PhysicsKind:
    """The physics of that name. Raises ValueError with the names that there are."""
    if name not in PHYSICS:
        raise ValueError(f"physics = {name!r}, allowed {', '.join(PHYSICS)}")
    return PHYSICS[name]
