"""Candidates squeezed on a cheaper mesh first, which says of most of them that they strain too much.

The strain of a squeeze is decided at the jaws: a mesh that is fine there and coarse elsewhere finds it within
2.3 % at a third of the cost, in 294 squeezes (benchmarks/scout.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from planners.certify import Trial
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, MeshError
from retract_env.scene import Scene

DOUBT = 0.04
"""By how much of its strain the cheaper mesh may err before a better retraction could be dropped."""


class Scouted(Trial):
    """A trial that `squeeze` tries on a mesh as fine as asked for at the jaws, and coarse elsewhere.

    `move` squeezes anew, on the mesh asked for, where the bound leaves a chance.
    """

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str = "fine"):
        super().__init__(scene, grasp, path, resolution)
        asked, coarse = RESOLUTIONS[resolution], RESOLUTIONS["coarse"]
        self._scout = replace(asked, bulk=coarse.bulk, growth=coarse.growth, true_veins=1.0, followed=1.0)
        self._scouted = False
        # nothing is gained without veins, or where meshes are coarse anyway
        self._worthwhile = bool(scene.tissue.veins) and asked.bulk < coarse.bulk

    def squeeze(self) -> None:
        """Squeeze on the cheaper mesh; `max_strain` is then a lower bound of what `move` begins with."""
        if self._scouted:
            return
        if not self._worthwhile:
            super().squeeze()
            return
        self._squeeze(self._scout)
        self.max_strain *= 1 - DOUBT
        self.reason = None  # the mesh asked for has the say
        self._scouted = True

    def move(
        self, bound: Callable[[], float] = lambda: math.inf, on_increment: Callable[[], None] = lambda: None
    ) -> None:
        """Squeeze on the mesh asked for, and follow the path."""
        if self._scouted:
            try:
                super().squeeze()
            except MeshError:
                self.reason = "unmeshable"
                return
        super().move(bound, on_increment)
