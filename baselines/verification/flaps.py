"""The flaps that are deformed: those of the paper, with changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from retract_env.scene import Jaws, LineOfSight, Scene, Tissue, Vein

LENGTH, HEIGHT = 0.05, 0.0044
EPS = float(np.finfo(float).eps)


def flap(
    length: float = LENGTH,
    height: float = HEIGHT,
    depth: float = HEIGHT,
    modulus: float = 40e3,
    poisson: float = 0.45,
    veins: Sequence[Vein] = (),
    gravity: float = 9.8,
    bed: bool = True,
    jaws: Jaws | None = None,
) -> Scene:
    """The paper's homogeneous flap (Sec. V), B at a quarter of its length, with changes."""
    return Scene(
        name="test",
        tissue=Tissue(
            length=length,
            height=height,
            depth=depth,
            density=1000.0,
            modulus=modulus,
            poisson=poisson,
            veins=tuple(veins),
        ),
        line_of_sight=LineOfSight.at(-0.25 * length, np.pi / 4),
        jaws=jaws or Jaws(),
        gravity=gravity,
        bed=bed,
    )


def square_vein(x: float, y: float, half: float, modulus: float = 200e3, poisson: float = 0.45) -> Vein:
    """A vein around (x, y), m, that reaches `half` to each side."""
    corners = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]
    return Vein(outline=tuple(corners), modulus=modulus, poisson=poisson)
