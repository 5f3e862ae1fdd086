"""Model assumptions, each with its size: what a certificate states where one of them is changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from baselines.jobs.journal import Row
from baselines.verification.sliding import slid
from baselines.verification.solution import CASES, WIDE, until_certified
from planners.certify import certify
from planners.certify.moving import Start, moving, way_long
from retract_env.scene import Scene

BASES = ("homogeneous, CTC", "eased, light grip")
"""Cases of `solution`, a firm grip and a light one."""
CHANGES: Mapping[str, Mapping[str, Any]] = {
    "as it is": {},
    "Poisson's ratio .40 for .45": {"tissue": {"poisson": 0.40}},
    "Poisson's ratio .49 for .45": {"tissue": {"poisson": 0.49}},
    "jaws .5 mm wide for 1 mm": {"jaws": {"width": 5e-4}},
    "jaws 2 mm wide for 1 mm": {"jaws": {"width": 2e-3}},
    "20 mm deep for 4.4 mm": {"tissue": {"depth": 0.020}},
    "20 mm deep, jaws hold 4.4 mm of it": {"tissue": {"depth": 0.020}, "jaws": {"depth": 4.4e-3}},
    "no bed": {"bed": False},
    "weight 10 % more": {"tissue": {"density": 1100.0}},
    "Fung's law, b = 2": {"material": {"law": "fung", "stiffening": 2.0}},
    "Fung's law, b = 8": {"material": {"law": "fung", "stiffening": 8.0}},
    "held until a quarter of the stiffness has relaxed": {"moduli": 0.75},
    "held until half of the stiffness has relaxed": {"moduli": 0.50},
}
"""What is changed of a scene: fields of its parts, or its own; or all moduli, to a part of themselves.

Where all moduli of a viscoelastic flap relax by the same share, and the jaws stand still, it comes to rest as
an elastic one of the moduli that are left, however it was moved before.
"""


MOTIONS: tuple[tuple[float, Start], ...] = (
    (2.0, "smooth"),
    (1.0, "smooth"),
    (0.5, "smooth"),
    (0.25, "smooth"),
    (1.0, "sudden"),
)
"""In how many s, and how begun, motions are made that certificates know no time of."""
SLIDING = (*BASES, "stiff rectangular veins at the grasp, CTC", "8 mm thick, no bed, CTC")
"""Cases whose patches are let slip node by node; the last needs nearly all the friction that there is."""


def freed(scene: Scene) -> Scene:
    """The scene at limits that nothing breaks."""
    return scene.model_copy(update={"limits": WIDE})


def changed(scene: Scene, change: str) -> Scene:
    """The scene with another assumption."""
    data = scene.dump()
    for name, value in CHANGES[change].items():
        if name == "moduli":
            for part in (data["tissue"], *data["tissue"]["veins"]):
                part["modulus"] *= value
            continue
        data[name] = {**data[name], **value} if isinstance(value, Mapping) else value
    return Scene.from_data(data)


def with_change(resolution: str, case: str, change: str) -> Row:
    """What the certificate of a case states of the same motion of the jaws with another assumption."""
    scene, path = until_certified(case)
    found = certify(changed(freed(scene), change), CASES[case].grasp, path, resolution)
    return {
        "reason": found.reason,
        "max_strain": found.max_strain,
        "required_friction": found.required_friction,
        "clearance": found.clearance,
    }


def in_time(resolution: str, case: str, seconds: float, start: Start) -> Row:
    """What a case comes to with inertia, made in so many s, and what its certificate states."""
    scene, path = until_certified(case)
    plain = certify(freed(scene), CASES[case].grasp, path, resolution)
    speed = way_long(plain.frames) / seconds
    found = moving(scene, plain.frames, speed, resolution, start)
    return {
        "speed": speed,
        "max_strain": found.max_strain,
        "required_friction": found.required_friction,
        "clearance": found.clearance,
        "strain_slow": plain.max_strain,
        "friction_slow": plain.required_friction,
    }


def node_by_node(resolution: str, case: str) -> Row:
    """What a case comes to where every node of a patch slips by itself, and what its certificate states."""
    scene, path = until_certified(case)
    plain = certify(freed(scene), CASES[case].grasp, path, resolution)
    found = slid(freed(scene), plain.frames, scene.limits.friction, resolution)
    return {
        **asdict(found),
        "strain_rigid": plain.max_strain,
        "friction_rigid": plain.required_friction,
        "clearance_rigid": plain.clearance,
    }
