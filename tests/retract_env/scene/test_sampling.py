"""Random scenes: valid, within their ranges, named by a seed."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
import shapely

from retract_env.scene import Scene, sample_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.scene.veins import MIN_GAP
from tests.retract_env.descriptions import HEIGHT, LENGTH, complaint


def test_sampled_scenes_are_valid_and_keep_their_ranges() -> None:
    """200 seeds. The checks are made afresh here, with polygons, not with the sampler's own."""
    counts: Counter[int] = Counter()
    moduli: list[float] = []
    for seed in range(200):
        scene = sample_scene(np.random.default_rng(seed))
        assert Scene.from_data(scene.dump()) == scene
        veins = scene.tissue.veins
        counts[len(veins)] += 1
        moduli += [vein.modulus for vein in veins]
        polygons = [shapely.Polygon(vein.outline) for vein in veins]
        room = shapely.box(-LENGTH, 0.0, 0.0, HEIGHT).buffer(-MIN_GAP)
        assert all(room.covers(polygon) for polygon in polygons)
        for i, polygon in enumerate(polygons):
            assert polygon.area > 0.9 * polygon.convex_hull.area
            assert all(polygon.distance(other) >= MIN_GAP for other in polygons[:i])
        assert 0.1 * LENGTH <= -scene.line_of_sight.target[0] <= 0.4 * LENGTH
        assert 30.0 - 1e-9 <= math.degrees(scene.line_of_sight.slope) <= 70.0 + 1e-9
    assert set(counts) == set(range(21))  # each number is missed with probability (20/21)^200 < 1e-4
    assert min(moduli) >= 80e3
    assert max(moduli) <= 400e3
    # Log-uniform: half of the n moduli lie below the geometric mean, up to four binomial standard deviations.
    below = np.mean(np.array(moduli) < math.sqrt(80e3 * 400e3))
    assert abs(below - 0.5) < 4 * 0.5 / math.sqrt(len(moduli))


def test_a_seed_names_a_scene() -> None:
    first, again, other = (sample_scene(np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert first == again
    assert first.hash == again.hash
    assert first.hash != other.hash


def test_ranges_shift_what_is_drawn() -> None:
    ranges = SceneRanges(
        veins=(12, 12), tissue_modulus=(20e3, 80e3), height=(3e-3, 6e-3), depth=(0.01, 0.02), slope=(1.3, 1.4)
    )
    scenes = [sample_scene(np.random.default_rng(seed), ranges) for seed in range(20)]
    assert {len(scene.tissue.veins) for scene in scenes} == {12}
    for scene in scenes:
        assert 20e3 <= scene.tissue.modulus <= 80e3
        assert 3e-3 <= scene.tissue.height <= 6e-3
        assert 0.01 <= scene.tissue.depth <= 0.02
        assert 1.3 - 1e-9 <= scene.line_of_sight.slope <= 1.4 + 1e-9
    assert len({scene.tissue.height for scene in scenes}) == 20


def test_ranges_that_cannot_be_met_are_refused() -> None:
    rng = np.random.default_rng(0)
    crowd = SceneRanges(veins=(60, 60), length=(0.005, 0.005))
    assert "no room for vein" in complaint(lambda: sample_scene(rng, crowd))
    assert "veins = (0, 501), allowed up to 500" in complaint(lambda: SceneRanges(veins=(0, 501)))
    assert "slope = (2, 1), allowed [least, greatest]" in complaint(lambda: SceneRanges(slope=(2, 1)))


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        ({"height": (0.004, 1.0)}, "height = 1.0 m, allowed (0, 0.05] m"),
        ({"vein_modulus": (50, 4e5)}, "vein_modulus = 50 Pa, allowed [100, 1e+08] Pa"),
        ({"tissue_modulus": (4e4, 1e9)}, "tissue_modulus = 1000000000.0 Pa, allowed"),
        ({"length": (0.003, 0.05)}, "length = 0.003 m, allowed (0.004, 0.5] m"),
        ({"depth": (0.0, 0.004)}, "depth = 0.0 m, allowed (0, 0.5] m"),
        ({"target": (0.1, 1.1)}, "target = 1.1, allowed [0, 1]"),
        ({"slope": (0.5, 2.0)}, "slope = 2.0 rad, allowed (0, 1.5708] rad"),
        ({"target": (0.0, 0.0)}, "target = (0.0, 0.0), allowed a place between both ends"),
        ({"slope": (0.001, 1.0)}, "slope = (0.001, 1.0): the height of the camera = "),
        (
            {"length": (0.2, 0.4), "height": (0.01, 0.03), "slope": (0.05, 0.3)},
            "slope = (0.05, 0.3): from 0.05 rad the camera may be inside a flap",
        ),
    ],
    ids=lambda given: next(iter(given)) if isinstance(given, dict) else "",
)
def test_ranges_that_no_scene_may_have_are_refused_whatever_the_seed(
    ranges: dict[str, Any], said: str
) -> None:
    assert said in complaint(lambda: SceneRanges(**ranges))
