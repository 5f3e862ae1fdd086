"""Shapes that are drawn, in metres."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.drawing.shapes import JawShapes, SectionTopology, hidden_region, sight_reach
from retract_env.scene import Scene
from tests.retract_env.lifted import lifted

Array = NDArray[np.float64]


def test_the_hidden_region_of_a_wall_is_its_shadow() -> None:
    wall = np.array([(0.0, 0.0), (0.0, 1.0), (0.1, 1.0), (0.1, 0.0), (0.0, 0.0)])
    # the camera looks to the left past the top at (0, 1), to the bed at x = -2
    assert np.allclose(hidden_region(wall, (2.0, 2.0)), [(0.0, 0.0), (0.0, 1.0), (-2.0, 0.0)])


def test_the_hidden_region_is_bounded_by_the_ray_that_meets_the_bed_first() -> None:
    box = np.array([(0.0, 0.0), (-4.0, 0.0), (-4.0, 2.0), (0.0, 2.0), (0.0, 0.0)])
    # It stands on the bed with its foot at (-4, 0), and nothing before that is hidden.
    assert np.allclose(hidden_region(box, (-10.0, 8.0)), [(0, 0), (-4, 0), (-4, 0)])
    # Lifted by 1, the ray over (-4, 1) goes 6 across and 7 down: 48 / 7 across when it meets the bed, 8 down.
    lifted_box = hidden_region(box + np.array((0.0, 1.0)), (-10.0, 8.0))
    assert np.allclose(lifted_box[-2:], [(-4, 1), (-10 + 48 / 7, 0)])


def test_the_line_of_sight_is_shown_up_to_the_camera_or_to_the_nearest_border() -> None:
    away = np.array([-0.6, 0.8])
    assert sight_reach((1.0, 2.0), away, 3.0, left=-9.0, top=99.0) == 3.0
    assert sight_reach((1.0, 2.0), away, 30.0, left=-9.0, top=6.0) == pytest.approx(4 / 0.8)
    assert sight_reach((1.0, 2.0), away, 30.0, left=-2.0, top=99.0) == pytest.approx(3 / 0.6)
    assert sight_reach((1.0, 2.0), (0.0, 1.0), 30.0, left=-2.0, top=9.0) == 7.0  # never meets the left border


def test_the_outline_runs_from_the_foot_of_the_fixed_end_along_the_lower_surface_and_round() -> None:
    lift = lifted()
    points = lift.physics.section.points
    outline = points[SectionTopology(lift.physics.section, lift.scene.tissue.veins).outline]
    tissue = lift.scene.tissue
    assert np.allclose(outline[[0, -1]], 0.0)
    steps = np.linalg.norm(np.diff(outline, axis=0), axis=1)
    assert steps.sum() == pytest.approx(2 * (tissue.length + tissue.height))
    far = int(np.argmin(outline[:, 0] + outline[:, 1]))  # the lower corner of the free end
    assert np.all(outline[: far + 1, 1] == 0) and np.all(np.diff(outline[: far + 1, 0]) < 0)


def test_strain_jumps_at_veins_and_is_not_smeared_over_them() -> None:
    section = lifted("medium").physics.section
    smooth = SectionTopology(section, ()).smooth(np.where(section.vein >= 0, 0.1, 0.4))
    assert np.all(np.isclose(smooth, 0.1) | np.isclose(smooth, 0.4))
    assert np.ptp(smooth) > 0.2


@pytest.mark.parametrize("resolution", ["coarse", "medium"])
def test_veins_are_drawn_as_the_scene_has_them_whatever_the_mesh_makes_of_them(resolution: str) -> None:
    lift = lifted(resolution)
    points, veins = lift.physics.section.points, lift.scene.tissue.veins
    topology = SectionTopology(lift.physics.section, lift.scene.tissue.veins)
    rings = [np.array([*vein.outline, vein.outline[0]]) for vein in veins]

    def pieces(nodes: Array) -> Array:
        found: Array = np.linalg.norm(np.diff(topology.vein_lines(nodes), axis=0), axis=1)
        return found

    around = sum(np.linalg.norm(np.diff(ring, axis=0), axis=1).sum() for ring in rings)
    assert np.nansum(pieces(points)) == pytest.approx(around, rel=1e-9)
    # a quadratic motion is one that quadratic triangles follow exactly
    bend = np.column_stack([points[:, 0] - 8 * points[:, 0] * points[:, 1], 9 * points[:, 0] ** 2])
    lines, rest = topology.vein_lines(points + bend), topology.vein_lines(points)
    moved = np.column_stack([rest[:, 0] - 8 * rest[:, 0] * rest[:, 1], 9 * rest[:, 0] ** 2])
    assert np.allclose(lines, rest + moved, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("bold", [1.0, 2.0])
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.5])
def test_jaws_stand_on_the_tissue_back_to_back(bold: float, turn: float) -> None:
    scene: Scene = lifted().scene
    axis = np.array([-np.sin(turn), np.cos(turn)])
    middle = np.array([-0.02, 0.01])
    ends = np.concatenate((middle - 0.001 * axis, middle + 0.001 * axis))
    for shapes in JawShapes(scene, bold).at(ends):
        along = (shapes[:, :-1] - middle) @ axis
        assert np.all(along[0] <= -0.001 + 1e-12) and np.all(along[1] >= 0.001 - 1e-12)
        assert np.allclose(along[0], -along[1])
    pads = JawShapes(scene, bold).at(ends)[1][:, :-1]
    assert np.ptp((pads - middle) @ (axis[1], -axis[0])) == pytest.approx(bold * scene.jaws.width)
