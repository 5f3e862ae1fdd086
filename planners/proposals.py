"""Grasps times paths: what the planners of the paper's kind hand to `generate_and_test`. Sec. IV-A, V-B."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np

from planners.paths import PATHS
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import SLIVER
from retract_env.scene import Scene
from retract_env.spring import SpringModel, optimal_compression

UNIFORM = 50
"""Grasps of an exhaustive search, as many as for Fig. 12."""


def stable_grasps(scene: Scene) -> list[Grasp]:
    """The paper's candidates, best score first: stable grasps, or ten uniform ones where none is. Sec.
    IV-B."""
    return SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)


def uniform_grasps(scene: Scene, samples: int = UNIFORM) -> list[Grasp]:
    """Grasps at -length i / samples, i = 1 ... samples, each compressed by Eq. 5, free end first.

    They are moved so that the jaws fit; those that then coincide count once. k_eq is taken at the grasp, k_n
    is the lower of the maxima beside it, and at a maximum k_n = k_eq. Raises ValueError for samples below 1.
    """
    if samples < 1:
        raise ValueError(f"samples = {samples}, allowed 1 or more")
    tissue, width = scene.tissue, scene.jaws.width
    model = SpringModel(tissue)
    basins = model.basins()
    low, high = -tissue.length + width / 2, -(0.5 + SLIVER) * width
    places = np.unique(np.clip(-tissue.length * np.arange(1, samples + 1) / samples, low, high))

    def grasp(x: float) -> Grasp:
        k_eq = float(model.k_eq(x))
        k_n = max(k_eq, min((b.k_n for b in basins if b.left <= x <= b.right), default=k_eq))
        delta = float(optimal_compression(k_eq, k_n, tissue.height, scene.limits.strain))
        return Grasp(x, delta, k_n * delta**2 / 2)

    return [grasp(x) for x in places.tolist()]


def along(scene: Scene, grasps: Iterable[Grasp], kinds: Iterable[str]) -> list[tuple[Grasp, JawPath]]:
    """Every grasp with every path of these kinds, names in PATHS."""
    return [(grasp, PATHS[kind](scene, grasp)) for grasp, kind in product(grasps, kinds)]
