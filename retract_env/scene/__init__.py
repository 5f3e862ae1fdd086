"""What is to be retracted: the parts of a scene, which veins it may have, random scenes."""

from retract_env.errors import SceneError
from retract_env.scene.parts import (
    Jaws,
    Limits,
    LineOfSight,
    Material,
    Scene,
    Tissue,
    Vein,
    load_scene,
    sample_scene,
)
from retract_env.scene.uncertainty import UNKNOWNS, Uncertainty

__all__ = [
    "UNKNOWNS",
    "Jaws",
    "Limits",
    "LineOfSight",
    "Material",
    "Scene",
    "SceneError",
    "Tissue",
    "Uncertainty",
    "Vein",
    "load_scene",
    "sample_scene",
]
