"""How hard the jaws press and by how much they close, roughly: what is told before anything is computed."""

from __future__ import annotations

from retract_env.grasp import Grasp
from retract_env.scene import Scene

PRESSED = 2.58
"""Normal force over E w d c, with w the jaws' width, d the flap's depth and c the compression over the
height: the median of squeezes of random flaps on finite elements, of which 90 % have 2.18 to 3.59."""
FIRMEST = 0.5
"""Over the height; no more is expected of any force."""


def expected_compression(scene: Scene, grasp: Grasp) -> float:
    """m, by how much the jaws of a grasp will close: the separations of a path that they hold by force are
    nominal."""
    if grasp.force is None:
        return grasp.compression
    tissue = scene.tissue
    share = grasp.force / (PRESSED * tissue.modulus * scene.jaws.width * tissue.depth)
    return min(share, FIRMEST) * tissue.height
