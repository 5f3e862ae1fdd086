"""The retracted flap as a solid: the skin of its tissue and of its veins as flat faces, each with its
strain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from planners.certify import Trial
from retract_env.objectives import strain

Array = NDArray[np.float64]

MICRO = 1e-6
"""m, to which corners are kept"""


class Faces(TypedDict):
    """Flat faces of a surface, seen from outside counter-clockwise; plain data.

    corners: um, x y z of each corner in turn, triangles and quadrilaterals; strain: of the element behind.
    """

    corners: list[list[int]]
    strain: list[float]


def skins(trial: Trial) -> tuple[Faces, Faces]:
    """Skin of the flap and of its veins as a trial left them, on both sides of the plane of symmetry."""
    physics = trial.physics
    assert physics is not None
    prism, section = physics.model.prism, physics.section
    ends = np.concatenate([[0], 2 * np.arange(len(prism.blocks)) + 1])  # the levels where layers end
    points = physics.model.solid(physics.displacements)[ends].swapaxes(0, 1)
    stretches = physics.model.assembly.stretches(physics.displacements)
    weights = [block.measured for block in prism.blocks]
    strains = np.stack(
        [(strain(s) * w).sum(axis=1) / w.sum(axis=1) for s, w in zip(stretches, weights, strict=True)]
    )
    triangles = section.triangles
    every = np.arange(len(triangles))
    within = [every[section.vein == i] for i in range(len(trial.scene.tissue.veins))]
    skin = _skin([every], triangles, points, strains)
    return skin, _skin(within, triangles, points, strains)


def _skin(
    bodies: Sequence[NDArray[np.intp]], triangles: NDArray[np.int32], points: Array, strains: Array
) -> Faces:
    """Surfaces of the prisms over these sets of triangles. points: (n, k, 3) m; strains: (k - 1, m)."""
    corners: list[Array] = []
    values: list[float] = []
    last = points.shape[1] - 1
    for body in bodies:
        edges = np.concatenate([triangles[body][:, [a, 3 + a, (a + 1) % 3]] for a in range(3)])
        owner = np.tile(body, 3)
        _, first, times = np.unique(edges[:, 1], return_index=True, return_counts=True)
        for e in first[times == 1]:
            a, middle, b = edges[e]
            for p, q in ((a, middle), (middle, b)):
                for layer in range(last):
                    quad = points[[p, q, q, p], [layer, layer, layer + 1, layer + 1]]
                    corners += [quad, quad[::-1] * (1, 1, -1)]
                    values += 2 * [strains[layer, owner[e]]]
        for t in body:
            face = points[triangles[t, [0, 3, 1, 4, 2, 5]], last]
            corners += [face, face[::-1] * (1, 1, -1)]
            values += 2 * [strains[-1, t]]
    return {
        "corners": [np.round(c / MICRO).astype(int).ravel().tolist() for c in corners],
        "strain": [round(float(v), 4) for v in values],
    }
