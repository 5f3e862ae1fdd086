"""What every physics answers with: the state of the tissue and of the jaws after a move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Diverged(ArithmeticError):
    """No equilibrium was found."""


@dataclass(frozen=True)
class TissueState:
    """The flap in equilibrium with one pose of the jaws.

    All arrays belong to the drawn section, the plane of symmetry z = 0, unless said otherwise.
    """

    points: Array
    """(n, 2) m, where the section's nodes are now."""
    strain: Array
    """(m,) mean strain of each section triangle, over the depth too."""
    jaws: Array
    """(4,) m, (x1, y1, x2, y2): lower and upper jaw."""
    reactions: Array
    """(2, 2) N, force of the tissue on the lower and on the upper jaw, over the whole depth."""
    normals: Array
    """(2, 2) unit vectors, from each jaw into the tissue."""
    max_strain: float
    """eps_1%, the mean strain of the 1 % of volume that is strained most. Sec. III-C."""
    worst_at: Array
    """(2,) m, rest position of the most strained spot."""
    required_friction: Array
    """(2,) least Coulomb coefficient that holds each jaw; inf where the jaw would pull."""
    clearance: float
    """m, signed distance of the lowest tissue node to AB; negative while tissue lies below it."""
    progress: float
    """How far along the path, in waypoints; 0 at rest, 1 squeezed."""
