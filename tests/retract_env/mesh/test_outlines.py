"""Veins with fewer corners: same area, same place, room for the mesher, nearly the same retraction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.verification.flaps import HEIGHT, LENGTH, flap, square_vein
from planners.certify import certify
from planners.paths import ctc
from retract_env.mesh import RESOLUTIONS, section_mesh
from retract_env.mesh.outlines import area, fewer_corners, with_corners
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, Vein, load_scene, sample_scene
from retract_env.scene.veins import MIN_GAP
from retract_env.spring import SpringModel

SCENES = Path(__file__).resolve().parents[3] / "configs" / "scenes"
few = settings(max_examples=25, deadline=None)

random_scenes = st.integers(0, 100_000).map(lambda seed: sample_scene(np.random.default_rng(seed)))


def polygons(scene: Scene) -> list[shapely.Polygon]:
    return [shapely.Polygon(vein.outline) for vein in scene.tissue.veins]


@few
@given(random_scenes, st.integers(3, 7))
def test_area_and_centroid_stay(scene: Scene, corners: int) -> None:
    for vein in scene.tissue.veins:
        simpler = np.array(with_corners(vein.outline, corners))
        assert len(simpler) == min(corners, len(vein.outline))
        before, after = shapely.Polygon(vein.outline), shapely.Polygon(simpler)
        assert area(simpler) == pytest.approx(before.area, rel=1e-9)
        assert after.centroid.distance(before.centroid) < 1e-9


@few
@given(random_scenes)
def test_gaps_stay_and_everything_else_too(scene: Scene) -> None:
    simpler = fewer_corners(scene, 4)
    tissue = simpler.tissue
    assert Scene.from_data(simpler.dump()) == simpler  # all rules for veins hold
    found = polygons(simpler)
    for i, one in enumerate(found):
        assert all(one.distance(other) >= MIN_GAP for other in found[:i])
    assert [v.modulus for v in tissue.veins] == [v.modulus for v in scene.tissue.veins]
    veins = scene.tissue.veins
    assert simpler == scene.model_copy(
        update={"tissue": scene.tissue.model_copy(update={"veins": tissue.veins})}
    )
    assert sum(len(v.outline) for v in tissue.veins) <= sum(len(v.outline) for v in veins)


def test_veins_on_the_surface_and_crowded_ones_keep_their_outline() -> None:
    on_top = Vein(
        outline=((-0.03, HEIGHT), (-0.031, 0.003), (-0.03, 0.002), (-0.029, 0.003), (-0.0285, HEIGHT)),
        modulus=2e5,
    )
    octagon = [(np.cos(a), np.sin(a)) for a in (np.arange(8) + 0.5) * np.pi / 4]
    near = [
        Vein(outline=tuple((x + 1e-3 * c, 2.2e-3 + 1e-3 * s) for c, s in octagon), modulus=2e5)
        for x in (-0.02, -0.02 + 2e-3 * np.cos(np.pi / 8) + 1.1 * MIN_GAP)
    ]
    scene = flap(veins=[on_top, *near])
    assert fewer_corners(scene, 4).tissue.veins[0] == on_top
    # as squares, with corners where octagons have sides, they would reach further
    assert fewer_corners(scene, 4).tissue.veins[1] == near[0]
    assert [len(v.outline) for v in fewer_corners(flap(veins=near[:1]), 4).tissue.veins] == [4]


def test_nothing_changes_where_nothing_is_to_be_gained() -> None:
    scene = flap(veins=[square_vein(-0.02, 0.0024, 0.0008)])
    assert fewer_corners(scene, 4) is scene
    assert fewer_corners(flap(), 4) == flap()


def test_a_dented_outline_that_would_turn_inside_out_stays() -> None:
    star = tuple(
        (r * np.cos(a), r * np.sin(a))
        for a, r in zip(np.arange(10) * np.pi / 5, [1e-3, 1e-4] * 5, strict=True)
    )
    veins = [Vein(outline=tuple((x - LENGTH / 2, y + HEIGHT / 2) for x, y in star), modulus=2e5)]
    simpler = fewer_corners(flap(veins=veins), 4)
    assert all(p.is_valid for p in polygons(simpler))


def test_meshes_away_from_the_jaws_have_fewer_triangles() -> None:
    scene = load_scene(SCENES / "ten_veins.yaml")
    drawn = section_mesh(scene, -0.035, RESOLUTIONS["medium"])
    meshed = FemPhysics(scene, -0.035, "medium").section
    assert len(meshed.triangles) < 0.8 * len(drawn.triangles)
    assert np.unique(meshed.vein).tolist() == np.unique(drawn.vein).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ten_veins", "twenty_veins"])
def test_coarse_retractions_are_within_6_percent_of_fine(name: str) -> None:
    """What the environments promise; friction to 0.05 of 0.5, the moment of visibility to one waypoint."""
    scene = load_scene(SCENES / f"{name}.yaml")
    grasp = SpringModel(scene.tissue).stable_grasps()[0]
    coarse, fine = (certify(scene, grasp, ctc(scene, grasp), resolution) for resolution in ("coarse", "fine"))
    assert coarse.reason == fine.reason == "ok"
    assert coarse.max_strain == pytest.approx(fine.max_strain, rel=0.06)
    assert coarse.required_friction == pytest.approx(fine.required_friction, abs=0.05)
    assert coarse.path["end"] == pytest.approx(fine.path["end"], abs=1.0)
