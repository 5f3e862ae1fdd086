"""Where an episode stands: what observation, reward and verdict are made from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from retract_env.mesh import SectionMesh
from retract_env.physics.base import TissueState


@dataclass(frozen=True)
class Situation:
    """Where an episode stands."""

    section: SectionMesh
    state: TissueState
    exposure: float
    holding: bool = False
    """whether the jaws have closed"""
    steps: int = 0
    """taken so far"""
    greatest_strain: float = 0.0
    """eps_1%, so far"""
    greatest_friction: float = 0.0
    """needed by either jaw, so far"""
    overlapped: bool = False
    """whether tissue ever was where something else is"""
    missed: bool = False
    """whether the jaws were closed without closing on the flap, which they can where not all is known"""
    off: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) m, by how much the jaws are off in x and in y from where they were sent to, and have closed
    further"""
