"""The spring model: k_eq along the flap, stable grasps, how far to close the jaws. Sec. IV-B, IV-C."""

from retract_env.compilation import forget_old
from retract_env.spring.model import Basin, SpringModel, optimal_compression
from retract_env.spring.press import by_force, expected_compression, pressing
from retract_env.spring.stiffness import Stiffness

__all__ = [
    "Basin",
    "SpringModel",
    "Stiffness",
    "by_force",
    "expected_compression",
    "optimal_compression",
    "pressing",
]

forget_old()
