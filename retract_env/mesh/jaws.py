"""Where the jaws may sit on a flap."""

from __future__ import annotations

from retract_env.scene import Scene

SLIVER = 0.05
"""A patch that ends nearer than this, over its width, to an end of the flap reaches up to it: no sliver is
left."""


def patch_ends(scene: Scene, jaw_x: float) -> tuple[float, float]:
    """Where the jaw patches begin and end along the flap, m; a grasp at the free end has half a patch.

    Raises ValueError where the patch does not keep off the fixed end.
    """
    length, width = scene.tissue.length, scene.jaws.width
    low, high = jaw_x - width / 2, jaw_x + width / 2
    if not (jaw_x >= -length * (1 + 1e-9) and high <= -SLIVER * width):
        least = -(0.5 + SLIVER) * width
        raise ValueError(
            f"grasp.x = {jaw_x:g} m, allowed [{-length:g}, {least:g}] m for jaws {width:g} m wide"
        )
    return (-length if low < -length + SLIVER * width else low), high
