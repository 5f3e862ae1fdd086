"""The section's mesh: follows veins and jaw patches, covers the flap once, names its nodes, repeats."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely import Polygon

from baselines.verification.flaps import HEIGHT, LENGTH, flap
from retract_env.mesh import RESOLUTIONS, SectionMesh, patch_ends, section_mesh
from retract_env.scene import Jaws, Scene, Vein, load_scene, sample_scene

Array = NDArray[np.float64]

SCENES = Path(__file__).resolve().parents[3] / "configs" / "scenes"
GRASPS = {
    "ten_veins": -0.0207,
    "homogeneous": -0.025,
    "twenty_veins": -0.0331,
    "near the fixed end": -0.0006,
    "free end": -LENGTH,
    "half off the free end": -LENGTH + 0.0002,
    "no jaws": None,
}
TINY = 1e-12
"""m, rounding of a coordinate below 0.1 m"""


def scene_of(name: str) -> Scene:
    path = SCENES / f"{name}.yaml"
    return load_scene(path) if path.exists() else flap()


@cache
def meshed(name: str, resolution: str = "coarse") -> tuple[Scene, SectionMesh]:
    scene = scene_of(name)
    return scene, section_mesh(scene, GRASPS[name], RESOLUTIONS[resolution])


@pytest.fixture(params=[(n, r) for n in GRASPS for r in ("coarse", "fine")], ids=lambda p: f"{p[0]}, {p[1]}")
def case(request: pytest.FixtureRequest) -> tuple[Scene, SectionMesh, float | None]:
    name, resolution = request.param
    return *meshed(name, resolution), GRASPS[name]


def areas(section: SectionMesh) -> Array:
    d1 = section.corners[:, 1] - section.corners[:, 0]
    d2 = section.corners[:, 2] - section.corners[:, 0]
    return (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2


Case = tuple[Scene, SectionMesh, float | None]


def test_triangles_cover_the_flap_and_none_is_inverted(case: Case) -> None:
    scene, section, _ = case
    assert (areas(section) > 0).all()
    assert areas(section).sum() == pytest.approx(scene.tissue.length * scene.tissue.height, rel=1e-12)


def test_each_vein_is_covered_by_its_own_triangles(case: Case) -> None:
    scene, section, _ = case
    for i, vein in enumerate(scene.tissue.veins):
        polygon = Polygon(vein.outline)
        inside = section.vein == i
        assert areas(section)[inside].sum() == pytest.approx(polygon.area, rel=1e-9)
        grown = polygon.buffer(1e-9)
        assert all(grown.covers(Polygon(triangle)) for triangle in section.corners[inside])
    assert set(np.unique(section.vein)) == {-1, *range(len(scene.tissue.veins))}


def test_middles_lie_half_way_and_edges_are_shared(case: Case) -> None:
    _, section, _ = case
    corners, middles = section.points[section.triangles[:, :3]], section.points[section.triangles[:, 3:]]
    assert np.abs(middles - (corners + np.roll(corners, -1, axis=1)) / 2).max() < TINY
    # no two nodes in one place, none unused; Euler: vertices - edges + triangles = 1 for a disc
    assert len(np.unique(np.round(section.points / 1e-9), axis=0)) == len(section.points)
    assert np.array_equal(np.unique(section.triangles), np.arange(len(section.points)))
    vertices, edges = (len(np.unique(section.triangles[:, part])) for part in (slice(3), slice(3, 6)))
    assert vertices - edges + len(section.triangles) == 1


def test_the_boundary_goes_around_once_counter_clockwise(case: Case) -> None:
    scene, section, _ = case
    first, _, last = section.boundary.T
    assert np.array_equal(np.sort(first), np.sort(last))
    (x1, y1), (x2, y2) = section.points[first].T, section.points[last].T
    assert np.hypot(x2 - x1, y2 - y1).sum() == pytest.approx(2 * (scene.tissue.length + scene.tissue.height))
    area = scene.tissue.length * scene.tissue.height
    assert (x1 * y2 - x2 * y1).sum() / 2 == pytest.approx(area, rel=1e-12)


def test_nodes_of_the_sides_are_named(case: Case) -> None:
    scene, section, _ = case
    x, y = section.points.T
    assert np.array_equal(section.fixed, np.flatnonzero(np.abs(x) < TINY))
    assert np.array_equal(section.bottom, np.flatnonzero(np.abs(y) < TINY))
    assert y[section.fixed].min() == pytest.approx(0, abs=TINY)
    assert y[section.fixed].max() == pytest.approx(scene.tissue.height, abs=TINY)
    assert (np.diff(x) >= 0).all()  # along x, which keeps the tangent's band narrow


def test_lengths_of_the_lower_surface_integrate_quadratics(case: Case) -> None:
    scene, section, _ = case
    length, x = scene.tissue.length, section.points[section.bottom, 0]
    for power in range(4):
        exact = (-1) ** power * length ** (power + 1) / (power + 1)
        assert section.bottom_length @ x**power == pytest.approx(exact, rel=1e-11)


def test_patches_end_on_nodes_and_hold_whole_edges(case: Case) -> None:
    scene, section, jaw_x = case
    for k, patch in enumerate(section.patches):
        if jaw_x is None:
            assert len(patch) == 0
            continue
        x, y = section.points[patch].T
        low = max(jaw_x - scene.jaws.width / 2, -scene.tissue.length)
        high = jaw_x + scene.jaws.width / 2
        assert y == pytest.approx(k * scene.tissue.height, abs=TINY)
        assert (x.min(), x.max()) == pytest.approx((low, high), abs=TINY)
        assert len(patch) % 2 == 1  # corners and the middles between them
        on_patch = np.isin(section.boundary, patch)
        edges = section.boundary[on_patch.all(axis=1)]
        ends = section.points[edges[:, [0, 2]], 0]
        assert np.abs(np.diff(ends, axis=1)).sum() == pytest.approx(high - low, rel=1e-9)


def test_triangles_are_not_slivers(case: Case) -> None:
    _, section, _ = case
    sides = np.linalg.norm(section.corners - np.roll(section.corners, -1, axis=1), axis=2)
    # 1 for an equilateral triangle; a corner of 5 degrees, the sharpest vein, forces about 0.15
    quality = 4 * np.sqrt(3) * areas(section) / (sides**2).sum(axis=1)
    assert quality.min() > 0.15


def test_every_resolution_refines_the_one_before() -> None:
    scene = flap()
    names = ["coarse", "medium", "fine", "finer"]
    assert list(RESOLUTIONS) == names
    counts = [len(section_mesh(scene, -0.025, RESOLUTIONS[name]).triangles) for name in names]
    assert (np.diff(counts) > 0).all()


def test_elements_are_small_at_the_ends_of_certified_patches() -> None:
    """Stress is singular there, and eps_1% would depend on where the mesher happens to put its nodes."""
    scene, asked = flap(), RESOLUTIONS["fine"]
    for jaw_x in (-0.002, -0.0101, -0.0163, -0.025, -0.031, -0.0402, -0.0492):
        section = section_mesh(scene, jaw_x, asked)
        x, y = section.points[section.boundary[:, [0, 2]]].transpose(2, 0, 1)
        size = np.hypot(x[:, 1] - x[:, 0], y[:, 1] - y[:, 0])
        # the mesher rounds the number of pieces
        assert size.max() <= 1.5 * asked.bulk * scene.tissue.height
        held = [np.isin(section.boundary, patch).all(axis=1) for patch in section.patches]
        # the mesher rounds the number of pieces
        assert np.abs(np.diff(x[held[0] | held[1]], axis=1)).max() <= 1.5 * scene.jaws.width / asked.patch
        for end in (jaw_x - scene.jaws.width / 2, jaw_x + scene.jaws.width / 2):
            at = (np.abs(x - end) < TINY).any(axis=1)
            assert at.sum() == 4  # on either side, below and above
            # and lets sizes grow within the first element
            assert np.abs(np.diff(x[at], axis=1)).max() <= 3 * asked.edge * scene.jaws.width


def test_meshing_repeats_exactly_in_threads_too() -> None:
    scene, grasps = scene_of("ten_veins"), [-0.0207, -0.031, -0.0405, -0.012]
    alone = [section_mesh(scene, x, RESOLUTIONS["coarse"]) for x in grasps]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda x: section_mesh(scene, x, RESOLUTIONS["coarse"]), grasps * 2))
    for a, b in zip(alone * 2, together, strict=True):
        assert np.array_equal(a.points, b.points)
        assert np.array_equal(a.triangles, b.triangles)
        assert np.array_equal(a.vein, b.vein)


def test_the_mesh_scales_with_the_flap() -> None:
    small, large = flap(), flap(length=10 * LENGTH, height=10 * HEIGHT, jaws=Jaws(width=1e-2))
    a, b = (section_mesh(s, -s.tissue.length / 2, RESOLUTIONS["coarse"]) for s in (small, large))
    assert np.array_equal(a.triangles, b.triangles)
    assert np.abs(10 * a.points - b.points).max() < 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_random_veins_are_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = sample_scene(rng)
    jaw_x = float(rng.uniform(-LENGTH, -0.002))
    section = section_mesh(scene, jaw_x, RESOLUTIONS["coarse"])
    assert (areas(section) > 0).all()
    for i, vein in enumerate(scene.tissue.veins):
        area = Polygon(vein.outline).area
        assert areas(section)[section.vein == i].sum() == pytest.approx(area, rel=1e-9)


# --- Patches and veins that meet the outline


def test_a_patch_keeps_off_the_fixed_end_and_leaves_no_sliver_at_the_free_end() -> None:
    scene = flap()
    assert patch_ends(scene, -0.02) == pytest.approx((-0.0205, -0.0195))
    assert patch_ends(scene, -LENGTH) == pytest.approx((-LENGTH, -LENGTH + 0.0005))
    assert patch_ends(scene, -LENGTH + 0.00052)[0] == -LENGTH
    for wrong in (-0.0005, -0.0001, 0.0, -LENGTH - 1e-6, np.nan):
        with pytest.raises(ValueError, match=r"grasp\.x = "):
            patch_ends(scene, wrong)


BORDERING = {
    "layer": [(-0.05, 0.0), (0.0, 0.0), (0.0, 0.001), (-0.05, 0.001)],
    "strip": [(-0.03, 0.0), (-0.028, 0.0), (-0.028, 0.0044), (-0.03, 0.0044)],
    "across the jaw's end": [(-0.0258, 0.0044), (-0.0258, 0.002), (-0.0247, 0.002), (-0.0247, 0.0044)],
    "at the fixed end": [(-0.002, 0.001), (0.0, 0.001), (0.0, 0.003), (-0.002, 0.003)],
    "half the flap": [(-0.025, 0.0), (0.0, 0.0), (0.0, 0.0044), (-0.025, 0.0044)],
}


def check_bordering(outline: list[tuple[float, float]], near: float) -> None:
    """The vein and both patches at -25 mm are followed; patch ends within `near` m."""
    scene = flap(veins=[Vein(outline=tuple(outline), modulus=200e3)])
    section = section_mesh(scene, -0.025, RESOLUTIONS["coarse"])
    assert (areas(section) > 0).all()
    assert areas(section).sum() == pytest.approx(LENGTH * HEIGHT, rel=1e-12)
    expected = Polygon(outline).area
    assert areas(section)[section.vein == 0].sum() == pytest.approx(expected, rel=1e-9 + near / 1e-3)
    x, y = section.points.T
    for k, patch in enumerate(section.patches):
        assert (x[patch].min(), x[patch].max()) == pytest.approx((-0.0255, -0.0245), abs=TINY + near)
        assert y[patch] == pytest.approx(k * HEIGHT, abs=TINY)
    assert section.bottom_length.sum() == pytest.approx(LENGTH, rel=1e-12)
    vertices, edges = (len(np.unique(section.triangles[:, part])) for part in (slice(3), slice(3, 6)))
    assert vertices - edges + len(section.triangles) == 1
    assert len(section.triangles) < 400


@pytest.mark.parametrize("name", BORDERING)
def test_a_vein_may_share_the_flaps_outline(name: str) -> None:
    check_bordering(BORDERING[name], near=0)


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-8, 1e-6])
def test_a_patch_may_end_where_a_vein_does(apart: float) -> None:
    """Exactly there, or so near that no element fits between."""
    low, high = -0.0255 - apart, -0.0245 + apart
    check_bordering([(low, 0.0044), (low, 0.002), (high, 0.002), (high, 0.0044)], near=2 * apart)
