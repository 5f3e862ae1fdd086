"""Where the jaws may sit on a flap."""

from __future__ import annotations

from retract_env.scene import Scene

SLIVER = 0.05
"""A patch that ends nearer than this, over its width, to an end of the flap reaches up to it: no sliver is
left. At the fixed end it would be held twice, so jaws keep that far off."""


def jaw_range(length: float, width: float) -> tuple[float, float]:
    """Least and greatest x, m, of a grasp whose jaws stand on the flap with their whole width.

    length: m, of the flap; width: m, of the jaws. `patch_ends` accepts both ends. Where no such place is left
    both are the greatest.
    """
    nearest = -(0.5 + SLIVER) * width
    return min(-length + width / 2, nearest), nearest


def patch_ends(scene: Scene, jaw_x: float) -> tuple[float, float]:
    """Where the jaw patches begin and end along the flap, m; a grasp at the free end has half a patch.

    Raises ValueError where the patch does not keep off the fixed end.
    """
    length, width = scene.tissue.length, scene.jaws.width
    nearest = jaw_range(length, width)[1]
    if not -length * (1 + 1e-9) <= jaw_x <= nearest:
        raise ValueError(
            f"grasp.x = {jaw_x:g} m, allowed [{-length:g}, {nearest:g}] m for jaws {width:g} m wide"
        )
    low, high = jaw_x - width / 2, jaw_x + width / 2
    return (-length if low < -length + SLIVER * width else low), high
