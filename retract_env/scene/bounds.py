"""What flaps and lines of sight may have, whether they are stated or drawn."""

from __future__ import annotations

import math

from retract_env.config import Range

LENGTHS = Range(0.0, 0.5, "m", "(]")
HEIGHTS = Range(0.0, 0.05, "m", "(]")
DEPTHS = Range(0.0, 0.5, "m", "(]")
"""Of jaws, too."""
MODULI = Range(100.0, 1e8, "Pa")
SLOPES = Range(0.0, math.pi / 2, "rad", "(]")
CAMERA_HEIGHTS = Range(1e-3, 10.0, "m")
CAMERA_DISTANCE = 0.1
"""m, from the target, where nothing else is said."""
