"""Surfaces of the flap in space: closed, turned outwards, around the volume that the flap has."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.paper.skins import Faces, skins
from baselines.paper.studies.fig9 import Camera
from baselines.verification.flaps import HEIGHT, LENGTH
from planners.certify import Trial
from planners.paths import ctc
from retract_env.scene import Scene, Tissue
from tests.planners.retractions import a_grasp, veined

Array = NDArray[np.float64]

DEPTH = 0.012  # m, of several layers


@cache
def squeezed() -> Trial:
    scene = veined()
    tissue = Tissue.from_data(scene.tissue.model_dump() | {"depth": DEPTH})
    deep = Scene.from_data(scene.model_dump() | {"tissue": tissue})
    grasp = a_grasp(part=0.02)
    trial = Trial(deep, grasp, ctc(deep, grasp), "medium")  # coarse meshes follow no vein here
    trial.squeeze()
    return trial


def triangles(faces: Faces) -> Array:
    """(t, 3, 3) m, each face as a fan."""
    fans = []
    for corners in faces["corners"]:
        points = np.array(corners, float).reshape(-1, 3) * 1e-6
        fans += [points[[0, i, i + 1]] for i in range(1, len(points) - 1)]
    return np.array(fans)


@pytest.mark.parametrize("which", [0, 1])
def test_a_surface_is_closed_and_turned_outwards(which: int) -> None:
    """Its normals add up to nothing, and by Gauss it encloses the volume of the flap, or of the veins."""
    p, q, r = np.moveaxis(triangles(skins(squeezed())[which]), 1, 0)
    normals = np.cross(q - p, r - p) / 2
    area = np.linalg.norm(normals, axis=1).sum()
    assert np.abs(normals.sum(axis=0)).max() < 1e-3 * area
    volume = (normals * (p + q + r)).sum() / 9
    veins = 2 * 0.003 * 0.002
    section = LENGTH * HEIGHT if which == 0 else veins
    assert volume == pytest.approx(section * DEPTH, rel=0.01)  # nearly incompressible, squeezed a little


def test_every_face_has_a_strain() -> None:
    for faces in skins(squeezed()):
        assert len(faces["strain"]) == len(faces["corners"]) > 0
        assert min(faces["strain"]) >= 0
        assert max(faces["strain"]) > 0


def test_both_sides_mirror_each_other() -> None:
    points = np.concatenate([np.array(c).reshape(-1, 3) for c in skins(squeezed())[0]["corners"]])
    here = {tuple(p) for p in points.tolist()}
    assert {(x, y, -z) for x, y, z in here} == here


def test_the_camera_keeps_lengths_across_its_view() -> None:
    camera = Camera(0.6, 0.4)
    axes = np.array([camera.right, camera.up, camera.towards])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera.flat(axes), [[1, 0], [0, 1], [0, 0]], atol=1e-12)
    assert camera.up[1] > 0
