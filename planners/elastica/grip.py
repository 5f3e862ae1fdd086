"""The jaws' grip as two curves, measured on a coarse finite-element model: what `elastica` optimises with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import Grasp
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene

Array = NDArray[np.float64]

SQUEEZES = (0.25, 0.5, 1.0)
"""Parts of the grasp's compression at which its grip is measured."""


@dataclass(frozen=True)
class Grip:
    """What closing the jaws by a part c of the height does, each as a c + b c^2."""

    normal: tuple[float, float]
    """N, force that presses on each jaw"""
    strain: tuple[float, float]
    """eps_1%"""


def measured_grip(scene: Scene, grasp: Grasp, on_increment: Callable[[], None] = lambda: None) -> Grip:
    """The grip at one place, from a coarse finite-element model squeezed there. Raises Diverged, MeshError.

    on_increment: called before each squeeze; what it raises ends the measuring.

    Both curves are nearly straight: the normal force of the paper's flap is 2.2 E w d c away from its ends, w
    the jaws' width, and 1.6 at the free end; eps_1% is 1.2 c.
    """
    height = scene.tissue.height
    physics = FemPhysics(scene, grasp.x, "coarse")
    physics.reset()
    parts = np.array(SQUEEZES) * grasp.compression / height
    states = []
    for c in parts:
        on_increment()
        states.append(physics.move_to(np.array([grasp.x, height / 2, 0.0, height * (1 - c)])))
    pressing = [-(s.reactions * s.normals).sum() / 2 for s in states]
    return Grip(_curve(parts, pressing), _curve(parts, [s.worst_strain for s in states]))


def _curve(c: Array, values: Sequence[float]) -> tuple[float, float]:
    (a, b), *_ = np.linalg.lstsq(np.stack([c, c**2], axis=-1), np.array(values), rcond=None)
    return float(a), float(b)
