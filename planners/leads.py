"""Where planners begin that improve a grasp: at the few places that the rod finds best.

One kind of path is followed from places all along the flap, the stable ones among them, each gripped in many
ways.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.foresight import FIRMEST, Foreseen, foresee
from planners.paths import PathOf
from planners.proposals import stable_grasps
from retract_env.grasp import Grasp
from retract_env.mesh import jaw_range
from retract_env.scene import Material, Scene

Array = NDArray[np.float64]

PLACES, GRIPS = 16, 9
"""How many places beside the stable ones, and compressions of each, are followed on the rod."""
LIGHTEST = 0.02
"""Least compression of those, over the height; the greatest is FIRMEST."""
APART = 0.02
"""Over the length: places nearer to a better one than this are no other places."""


def lightest(scene: Scene, path_of: PathOf, allowed: float, count: int) -> list[Grasp]:
    """At most `count` grasps that need the friction allowed on a kind of path, and no more, by the rod; those
    that strain least, the best first."""
    height = scene.tissue.height
    places = np.linspace(*jaw_range(scene.tissue.length, scene.jaws.width), PLACES + 2)[1:-1].tolist()
    places = sorted({*places, *(grasp.x for grasp in stable_grasps(scene))})
    compressions = np.geomspace(LIGHTEST, FIRMEST, GRIPS) * height
    grasps = [Grasp(x, delta) for x, delta in product(places, compressions.tolist())]
    guessed = scene.model_copy(update={"material": Material()})  # places to begin from, whatever the law
    found = foresee(guessed, [(grasp, path_of(scene, grasp)) for grasp in grasps])
    held = []
    for k, x in enumerate(places):
        rows = found[k * GRIPS : (k + 1) * GRIPS]
        known = least_grip(compressions, rows, allowed, scene)
        if known is not None:
            held.append((known[1], Grasp(x, known[0])))
    held.sort(key=lambda h: h[0])
    return apart([grasp for _, grasp in held], scene, count)


def least_grip(
    compressions: ArrayLike, foreseen: list[Foreseen], allowed: float, scene: Scene
) -> tuple[float, float] | None:
    """Compression, m, at which the friction allowed is needed, and the strain there; None where none holds.

    compressions: (n,) m, ascending; what is foreseen of each. Between the first that holds and the one before
    logarithms are interpolated: friction falls about as one over the compression.
    """
    c = np.asarray(compressions, float)
    for i, now in enumerate(foreseen):
        if not now.friction <= allowed or now.clearance < scene.limits.clearance:
            continue
        before = foreseen[i - 1] if i else None
        if before is None or not np.isfinite(before.friction) or before.clearance < scene.limits.clearance:
            return (float(c[i]), now.strain) if now.strain <= scene.limits.strain else None
        part = np.log(allowed / now.friction) / np.log(before.friction / now.friction)
        strain = now.strain + part * (before.strain - now.strain)
        return (float(c[i] * (c[i - 1] / c[i]) ** part), strain) if strain <= scene.limits.strain else None
    return None


def apart(grasps: list[Grasp], scene: Scene, count: int) -> list[Grasp]:
    """The first `count` of those that are not near one before."""
    out: list[Grasp] = []
    for grasp in grasps:
        if all(abs(grasp.x - other.x) >= APART * scene.tissue.length for other in out):
            out.append(grasp)
    return out[:count]
