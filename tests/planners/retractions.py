"""Retractions that several tests judge, on the coarse mesh and each simulated once."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

from baselines.verification.flaps import HEIGHT, LENGTH, flap
from planners.certify import Certificate, certify
from planners.paths import circular, ctc, linear
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Limits, LineOfSight, Scene, Vein

MOTIONS: dict[str, Callable[[Scene, Grasp], JawPath]] = {
    "ctc": ctc,
    "circular": circular,
    "linear75": partial(linear, slope=math.radians(75)),
}


def box(left: float, right: float, low: float, high: float, modulus: float = 200e3) -> Vein:
    """m, Pa"""
    return Vein(outline=((left, low), (right, low), (right, high), (left, high)), modulus=modulus)


def a_scene(strain: float = 0.5, friction: float = 5.0, target: float = 0.25, **changes: Any) -> Scene:
    """The paper's flap with changes, B at `target` of its length; the jaws as rough as may be."""
    line = LineOfSight.at(-target * LENGTH, math.pi / 4)
    limits = Limits(strain=strain, friction=friction)
    return flap(**changes).model_copy(update={"limits": limits, "line_of_sight": line})


def veined(strain: float = 0.5, friction: float = 5.0) -> Scene:
    """Two stiff veins, one towards the bed and one towards the top."""
    veins = [box(-0.036, -0.033, 0.0005, 0.0025), box(-0.018, -0.015, 0.002, 0.004)]
    return a_scene(strain, friction, veins=veins)


def a_grasp(x: float = -0.025, part: float = 0.25) -> Grasp:
    """Compression as a part of the height; the paper's is a quarter for homogeneous tissue (Eq. 5)."""
    return Grasp(x, part * HEIGHT)


def poses(grasp: Grasp, *motion: tuple[float, float, float, float]) -> JawPath:
    """Squeeze, then these poses x, y, theta, separation."""
    height = HEIGHT - grasp.compression
    begin = [(grasp.x, HEIGHT / 2, 0.0, s) for s in (HEIGHT, height)]
    return JawPath.from_poses([*begin, *motion], "by hand")


@cache
def judged(scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    return certify(scene, grasp, path, "coarse")


def retraction(scene: Scene, grasp: Grasp | None = None, motion: str = "ctc") -> Certificate:
    grasp = grasp or a_grasp()
    return judged(scene, grasp, MOTIONS[motion](scene, grasp))
