"""The outline of a cut through solids, from their faces."""

from __future__ import annotations

import numpy as np

from baselines.paper.skins import Faces
from baselines.paper.studies.fig9 import cut_edges


def hexagon(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int], z: int) -> list[int]:
    """Corners and middles of a triangle in their order round it, um."""
    corners = np.array([a, b, c])
    ring = np.stack([corners, (corners + np.roll(corners, -1, axis=0)) // 2], axis=1).reshape(-1, 2)
    return np.column_stack([ring, np.full(6, z)]).ravel().tolist()


def test_edges_between_faces_and_faces_elsewhere_are_left_out() -> None:
    low, high = hexagon((0, 0), (2000, 0), (2000, 2000), 500), hexagon((0, 0), (2000, 2000), (0, 2000), 500)
    side = [0, 0, 500, 2000, 0, 500, 2000, 0, -500, 0, 0, -500]
    behind = hexagon((0, 0), (2000, 0), (2000, 2000), -500)
    faces: Faces = {"corners": [low, high, side, behind], "strain": [0.0] * 4}
    edges = cut_edges(faces)
    assert edges.shape == (8, 2, 3) and np.all(edges[..., 2] == 0.5)
    assert np.isclose(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum(), 8.0)  # of a square of 2 mm
    assert cut_edges({"corners": [side], "strain": [0.0]}).shape == (0, 2, 3)
