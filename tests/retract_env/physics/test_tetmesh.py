"""Tetrahedra for Bullet: they fill the flap, fit together, and carry the section that is drawn."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.flaps import HEIGHT, LENGTH, flap, square_vein
from retract_env.errors import MeshError
from retract_env.physics.bullet.tetmesh import TetMesh, tet_mesh
from retract_env.scene import Jaws, Scene

Array = NDArray[np.float64]


def mesh(scene: Scene, jaw_x: float = -0.025, along: float = 0.4, across: int = 2, deep: int = 2) -> TetMesh:
    return tet_mesh(scene, jaw_x, along, across, deep)


MESHES = {
    "usual": lambda: mesh(flap()),
    "one layer": lambda: mesh(flap(), deep=1),
    "at the free end": lambda: mesh(flap(), jaw_x=-LENGTH),
    "deep, narrow jaws": lambda: mesh(flap(depth=4 * HEIGHT, jaws=Jaws(width=2e-3, depth=HEIGHT))),
    "veined": lambda: mesh(flap(veins=[square_vein(-0.02, 0.0022, 0.001)])),
}


@pytest.fixture(params=list(MESHES))
def a_mesh(request: pytest.FixtureRequest) -> TetMesh:
    return MESHES[request.param]()


def volumes(m: TetMesh) -> Array:
    corners = m.points[m.cells]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6)


def test_tetrahedra_fill_the_flap(a_mesh: TetMesh) -> None:
    volume = volumes(a_mesh)
    assert volume.min() > 0
    box = np.ptp(a_mesh.points, axis=0)
    assert volume.sum() == pytest.approx(box.prod(), rel=1e-12)
    assert box[:2] == pytest.approx([LENGTH, HEIGHT], rel=1e-12)
    assert a_mesh.points[:, 2].sum() == pytest.approx(0, abs=1e-12)


def test_faces_meet(a_mesh: TetMesh) -> None:
    faces = np.sort(np.concatenate([np.delete(a_mesh.cells, k, axis=1) for k in range(4)]), axis=1)
    count = Counter(map(tuple, faces.tolist()))
    assert set(count.values()) == {1, 2}
    corners = a_mesh.points[[face for face, n in count.items() if n == 1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    l, h, d = np.ptp(a_mesh.points, axis=0)
    surface = float(np.linalg.norm(normals, axis=1).sum() / 2)
    assert surface == pytest.approx(2 * (l * h + h * d + d * l), rel=1e-12)


def test_the_mesh_is_its_own_mirror_image_in_depth() -> None:
    m = mesh(flap())
    number = {tuple(p): i for i, p in enumerate(m.points.tolist())}
    mirror = np.array([number[x, y, -z if z else z] for x, y, z in m.points.tolist()])
    assert {frozenset(c) for c in m.cells.tolist()} == {frozenset(c) for c in mirror[m.cells].tolist()}


@pytest.mark.parametrize("jaw_x", [-0.0481, -0.025, -0.0061])
def test_nodes_stand_at_the_patches_ends(jaw_x: float) -> None:
    m = mesh(flap(jaws=Jaws(width=1.4e-3)), jaw_x)
    for nodes, y in zip(m.patches, (0.0, HEIGHT), strict=True):
        x, height, z = m.points[nodes].T
        assert [x.min(), x.max()] == pytest.approx([jaw_x - 0.7e-3, jaw_x + 0.7e-3], abs=1e-15)
        assert (height == y).all() and np.ptp(z) == pytest.approx(HEIGHT)
    assert (m.points[m.fixed, 0] == 0).all() and len(m.fixed) == 9


def test_a_patch_that_nearly_reaches_the_free_end_reaches_it() -> None:
    m = mesh(flap(), -LENGTH + 0.7e-3)
    assert m.points[m.patches[0], 0].min() == -LENGTH


def test_narrow_jaws_hold_the_middle_of_a_deep_flap() -> None:
    m = mesh(flap(depth=4 * HEIGHT, jaws=Jaws(depth=HEIGHT)))
    z = m.points[m.patches[1], 2]
    assert [z.min(), z.max()] == pytest.approx([-HEIGHT / 2, HEIGHT / 2])


def test_the_section_is_a_plane_of_the_mesh(a_mesh: TetMesh) -> None:
    m, section = a_mesh, a_mesh.section
    assert section.points == pytest.approx(m.points[m.section_nodes, :2].mean(axis=1), abs=1e-15)
    p = section.points[section.triangles]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert area.min() > 0 and area.sum() == pytest.approx(LENGTH * HEIGHT)
    for k in range(3):
        assert p[:, 3 + k] == pytest.approx((p[:, k] + p[:, (k + 1) % 3]) / 2, abs=1e-15)
    assert section.bottom_length.sum() == pytest.approx(LENGTH)
    assert (np.diff(section.points[:, 0]) >= 0).all()
    outline = section.points[section.boundary[:, [0, 2]]]
    assert np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1).sum() == pytest.approx(2 * (LENGTH + HEIGHT))
    for under, nodes in zip(section.patches, m.patches, strict=True):
        assert np.ptp(section.points[under, 0]) == pytest.approx(np.ptp(m.points[nodes, 0]))


def test_every_tetrahedron_counts_once_for_the_section(a_mesh: TetMesh) -> None:
    m = a_mesh
    assert np.asarray(m.share.sum(axis=0)).ravel() == pytest.approx(1)
    p = m.section.corners
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    # two triangles a column of cubes, each with half of its volume
    assert m.share @ volumes(m) == pytest.approx(area * np.ptp(m.points[:, 2]))


@pytest.mark.parametrize(("ratio", "copies"), [(0.3, 1), (1.9, 1), (2.1, 3), (5.0, 5), (6.1, 7), (99.0, 99)])
def test_copies_are_the_nearest_odd_number(ratio: float, copies: int) -> None:
    m = mesh(flap(veins=[square_vein(-0.02, 0.0022, 0.0015, modulus=ratio * 40e3)]))
    (vein,) = m.veins
    assert vein.copies == copies and vein.stiffness == pytest.approx(ratio)
    assert set(m.copies.tolist()) == {1, copies}
    assert vein.area == pytest.approx(9e-6)
    inside = volumes(m)[m.copies > 1].sum() / HEIGHT if copies > 1 else vein.meshed_area
    assert vein.meshed_area == pytest.approx(inside)
    assert vein.meshed_area == pytest.approx(vein.area, rel=0.3)
    assert (m.section.vein == 0).any() and (m.section.vein == -1).any()


def test_a_vein_that_is_too_stiff_is_refused() -> None:
    with pytest.raises(MeshError, match=r"tissue\.veins\[0\]\.modulus = 4\.2e\+06 Pa, .*up to 3\.96e\+06 Pa"):
        mesh(flap(veins=[square_vein(-0.02, 0.0022, 0.001, modulus=4.2e6)]))


def test_a_grasp_off_the_flap_is_refused() -> None:
    with pytest.raises(ValueError, match=r"grasp\.x = 0 m, allowed"):
        mesh(flap(), 0.0)


def test_the_file_says_what_the_mesh_is() -> None:
    m = mesh(flap(veins=[square_vein(-0.02, 0.0022, 0.001)]))
    lines = m.vtk().splitlines()
    assert lines[:4] == ["# vtk DataFile Version 2.0", "flap", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    n, listed = len(m.points), int(m.copies.sum())
    assert lines[4] == f"POINTS {n} double"
    assert np.array_equal(np.loadtxt(lines[5 : 5 + n]), m.points)
    assert lines[5 + n] == f"CELLS {listed} {5 * listed}"
    cells = np.loadtxt(lines[6 + n : 6 + n + listed], dtype=int)
    assert (cells[:, 0] == 4).all()
    assert np.array_equal(cells[:, 1:], np.repeat(m.cells, m.copies, axis=0))
    assert lines[6 + n + listed] == f"CELL_TYPES {listed}"
    assert lines[7 + n + listed :] == ["10"] * listed
