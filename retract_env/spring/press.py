"""How hard the jaws press and by how much they close, roughly: what is told before anything is computed."""

from __future__ import annotations

from retract_env.grasp import Grasp
from retract_env.scene import Scene

PRESSED = 2.58
"""Normal force over E w d c, with w the jaws' width, d their depth and c the compression over the
height: the median of squeezes of random flaps on finite elements, of which 90 % have 2.18 to 3.59."""
FIRMEST = 0.5
"""Over the height; no more is expected of any force."""


def pressing(scene: Scene) -> float:
    """N, with which jaws are expected to press over the part of the height by which they close."""
    depth = scene.jaws.depth or scene.tissue.depth
    return PRESSED * scene.tissue.modulus * scene.jaws.width * depth


def by_force(scene: Scene, grasp: Grasp) -> Grasp:
    """The grasp at the same place that presses as hard as closing so far is expected to."""
    if grasp.force is not None:
        return grasp
    force = pressing(scene) * grasp.compression / scene.tissue.height
    return Grasp(grasp.x, score=grasp.score, force=force)


def expected_compression(scene: Scene, grasp: Grasp) -> float:
    """m, by how much the jaws of a grasp will close: the separations of a path that they hold by force are
    nominal."""
    if grasp.force is None:
        return grasp.compression
    return min(grasp.force / pressing(scene), FIRMEST) * scene.tissue.height
