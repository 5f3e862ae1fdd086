"""Flaps as arrays: those of the scenes that the same seeds give, alone and in batches."""

from __future__ import annotations

import hashlib
import json
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from retract_env.errors import SceneError
from retract_env.scene import LineOfSight, Scene, flaps, pcg64, sample_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.scene.veins import MIN_GAP

Array = NDArray[np.float64]

WIDE = SceneRanges(
    veins=(0, 60),
    vein_modulus=(1e3, 1e7),
    vein_width=(0.1, 1.5),
    vein_height=(0.05, 0.8),
    tissue_modulus=(1e3, 1e6),
    length=(0.04, 0.2),
    height=(4e-3, 2e-2),
    depth=(1e-3, 0.1),
    target=(0.0, 0.9),
    slope=(0.25, 1.5),
)


def outlines_of(scene: Scene) -> list[list[tuple[float, float]]]:
    return [list(vein.outline) for vein in scene.tissue.veins]


def test_seeds_keep_the_outlines_that_they_had_before_there_was_a_kernel() -> None:
    """Drawn in Python with GEOS then. Outlines are rounded, so that no machine's sine or cosine shows."""
    drawn = [outlines_of(sample_scene(np.random.default_rng(seed))) for seed in range(100)]
    assert hashlib.sha256(json.dumps(drawn).encode()).hexdigest()[:16] == "de548f217611e1fd"


@pytest.mark.parametrize(
    "ranges", [SceneRanges(), WIDE, SceneRanges(veins=(0, 0)), SceneRanges(veins=(3, 3))]
)
def test_arrays_are_those_of_the_scene(ranges: SceneRanges) -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        row, (scalars, vertices, offsets, moduli) = pcg64.state_of(rng), flaps.room(ranges.veins[1])
        count, placed = flaps.draw_flap(row, flaps.table(ranges), scalars, vertices, offsets, moduli)
        scene = sample_scene(rng, ranges)
        tissue, line = scene.tissue, scene.line_of_sight
        assert count == placed == len(tissue.veins)
        assert [vertices[offsets[v] : offsets[v + 1]].tolist() for v in range(count)] == [
            [list(vertex) for vertex in outline] for outline in outlines_of(scene)
        ]
        assert moduli.tolist() == [vein.modulus for vein in tissue.veins] + [0.0] * (len(moduli) - count)
        assert (offsets[count:] == offsets[count]).all()
        assert scalars[: flaps.CAMERA_X].tolist() == [
            tissue.length, tissue.height, tissue.depth, tissue.modulus
        ]  # fmt: skip
        assert (*scalars[flaps.CAMERA_X : flaps.SLOPE], 0.0) == (*line.camera, *line.target)
        assert LineOfSight.at(scalars[flaps.TARGET_X], scalars[flaps.SLOPE]) == line
        np.testing.assert_array_equal(row, pcg64.state_of(rng))


def test_where_veins_find_no_room_there_are_none() -> None:
    ranges = SceneRanges(veins=(60, 60), length=(0.005, 0.005))
    row, arrays = pcg64.state_of(np.random.default_rng(0)), flaps.room(60)
    count, placed = flaps.draw_flap(row, flaps.table(ranges), *arrays)
    assert count == 60 and 0 < placed < 60
    assert not any(array.any() for array in arrays[1:])


middles = st.integers(-(10**6), 10**6).map(lambda k: (k + 0.5) / 1e6)


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.floats(-1.0, 1.0), middles), st.integers(-2, 2))
def test_coordinates_are_rounded_as_python_rounds(value: float, steps: int) -> None:
    """Middles between two lattice points among them, as close as doubles come."""
    for _ in range(abs(steps)):
        value = math.nextafter(value, math.copysign(math.inf, steps))
    assert flaps._rounded(value) == round(value, 6)


def test_what_is_too_close_is_what_shapely_finds_too_close() -> None:
    """Pairs apart, crossing with and without vertices inside each other, and one within the other."""
    rng = np.random.default_rng(6)
    close = {True: 0, False: 0}
    for _ in range(3000):
        outlines = []
        for _ in range(2):
            n = int(rng.integers(8, 11))
            angle = (rng.uniform(-0.25, 0.25, n) + np.arange(n)) * math.tau / n
            oval = np.column_stack([np.cos(angle), np.sin(angle)]) * 10 ** rng.uniform(-4.2, -2.8, 2)
            outlines.append(np.round(oval + rng.uniform(-1e-3, 1e-3, 2), 6))
        gap = shapely.Polygon(outlines[0]).distance(shapely.Polygon(outlines[1]))
        if abs(gap - 2 * MIN_GAP) < 1e-12:  # for rounding to decide
            continue
        assert too_close(*outlines) == (gap < 2 * MIN_GAP)
        close[gap < 2 * MIN_GAP] += 1
    assert min(close.values()) > 500


def too_close(p: Array, q: Array) -> bool:
    boxes = [np.array(flaps._bounds(outline, len(outline))) for outline in (p, q)]
    found = flaps._boxes_within_gap(*boxes) and flaps._within_gap(p, len(p), boxes[0], q, len(q), boxes[1])
    return bool(found)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.005, 0.3), st.floats(0.005, 0.3), st.floats(0.5, 1.5))
def test_what_is_drawn_a_scene_may_have(seed: int, width: float, height: float, slope: float) -> None:
    """Thin veins, steep and level lines: either there is no room for a flap's veins, or it is a scene's.
    Batches of environments take flaps as they are drawn."""
    ranges = SceneRanges(
        veins=(1, 6), vein_width=(width, 3 * width), vein_height=(height, 3 * height), slope=(slope, 1.5)
    )
    rng = np.random.default_rng(seed)
    row, arrays = pcg64.state_of(rng), flaps.room(6)
    count, placed = flaps.draw_flap(row, flaps.table(ranges), *arrays)
    if placed < count:
        with pytest.raises(SceneError, match="no room for vein"):
            sample_scene(rng, ranges)
    else:
        sample_scene(rng, ranges)
