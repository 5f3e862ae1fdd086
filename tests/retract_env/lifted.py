"""A flap on its way up, for pictures of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from planners.paths import ctc
from retract_env.drawing.renderer import SectionRenderer
from retract_env.grasp import Grasp
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, load_scene

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Retraction:
    """A flap on its way up, by the finite elements."""

    scene: Scene
    physics: FemPhysics
    states: tuple[TissueState, ...]

    def renderer(self, size: tuple[int, int] = (640, 480)) -> SectionRenderer:
        return SectionRenderer(self.scene, self.physics.section, size)


@cache
def lifted(resolution: str = "coarse") -> Retraction:
    """Ten veins, at rest, squeezed and eight steps later; at the end part of the target area is in view.

    At `coarse` no triangle follows a vein.
    """
    scene = load_scene(ROOT / "configs" / "scenes" / "ten_veins.yaml")
    grasp = Grasp(x=-0.03485, compression=0.97e-3)
    poses = ctc(scene, grasp).poses
    physics = FemPhysics(scene, grasp.x, resolution)
    states = [physics.reset()]
    for i in (1, *range(4, 29, 3)):
        states.append(physics.move_to(poses[i], float(i)))
    return Retraction(scene, physics, tuple(states))
