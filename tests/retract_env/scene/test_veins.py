"""Veins: which outlines are accepted, and how the others are refused."""

from __future__ import annotations

import copy
from functools import partial
from typing import Any

import numpy as np
import pytest

from retract_env.scene import Scene, Tissue, Vein, sample_scene
from retract_env.scene.veins import MIN_GAP
from tests.retract_env.descriptions import HEIGHT, LENGTH, SQUARE, box, complaint, moved, with_veins


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        ([], ".outline: 0 distinct vertices, allowed at least 3"),
        (SQUARE[:2], ".outline: 2 distinct vertices, allowed at least 3"),
        ([*SQUARE[:2], SQUARE[0]], ".outline: 2 distinct vertices, allowed at least 3"),
        ([SQUARE[0], *SQUARE], ".outline[0]: 0 m from the next vertex, allowed at least 1e-06 m"),
        ([[-0.02, 0.001], [-0.019, 0.002], [-0.018, 0.003]], ".outline: the polygon has no area"),
        (
            [SQUARE[k] for k in (0, 2, 1, 3)],
            ".outline: the polygon crosses or touches itself near (-0.025, 0.002) m",
        ),
        (
            [*SQUARE, [-0.025, 0.001]],
            ".outline: the polygon crosses or touches itself near (-0.025, 0.001) m",
        ),
        (box(-0.03, -0.02, 0.002, 0.00204), ".outline: mean thickness 4e-05 m, allowed at least 5e-05 m"),
        ([[-0.03, 0.001], [-0.02, 0.001], [-0.02, 0.0018]], ".outline[0]: corner sharper than 5 degrees"),
        (
            [*SQUARE[:3], [-0.02496, 0.003], [-0.025, 0.0012], [-0.02504, 0.003], SQUARE[3]],
            ".outline[4]: corner sharper than 5 degrees",
        ),
        (
            moved(SQUARE, dy=0.002),
            ": vertex 2 at (-0.024, 0.005) m is outside the flap, allowed x in [-0.05, 0] m",
        ),
        (moved(SQUARE, dy=-0.0011), ": vertex 0 at (-0.026, -0.0001) m is outside the flap"),
        (moved(SQUARE, dx=0.025), ": vertex 1 at (0.001, 0.001) m is outside the flap"),
        (moved(SQUARE, dx=-0.025), ": vertex 0 at (-0.051, 0.001) m is outside the flap"),
        (moved(SQUARE, dy=0.00136), ": 4e-05 m from the top of the flap, allowed at least 5e-05 m, or 0 m"),
        (moved(SQUARE, dy=-0.00096), ": 4e-05 m from the bottom of the flap"),
        (moved(SQUARE, dx=-0.02396), ": 4e-05 m from the free end of the flap"),
        (moved(SQUARE, dx=0.02396), ": 4e-05 m from the fixed end of the flap"),
        (
            [[-0.03, 0.0], [-0.029, 0.002], [-0.031, 0.002]],
            ": touches the bottom of the flap with one vertex",
        ),
        (
            [[-0.03, 0.0], [-0.02, 0.0], [-0.01, 0.0005], [-0.02, 0.003]],
            ": leaves the bottom of the flap at less than 5 degrees",
        ),
        ([[0.001, "a"], *SQUARE[1:]], ".outline[0][1] = 'a', not a number; allowed [-10, 10] m"),
        ([[0.001], *SQUARE[1:]], ".outline[0] = [0.001], not a point [x, y] in m"),
        ("round", ".outline = 'round', not a list"),
    ],
)
def test_a_bad_vein_is_named_by_its_index(outline: Any, message: str) -> None:
    good = moved(SQUARE, dx=-0.02)
    assert f"tissue.veins[1]{message}" in complaint(lambda: Scene.from_data(with_veins(good, outline)))


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (moved(SQUARE, dx=0.001), "tissue.veins[1]: overlaps or touches veins[0], allowed at least 5e-05 m"),
        (SQUARE, "tissue.veins[1]: overlaps or touches veins[0]"),
        (box(-0.0255, -0.0245, 0.0015, 0.0025), "tissue.veins[1]: overlaps or touches veins[0]"),
        (box(-0.024, -0.022, 0.001, 0.003), "tissue.veins[1]: overlaps or touches veins[0]"),
        (
            box(-0.02396, -0.022, 0.001, 0.003),
            "tissue.veins[1]: is 4e-05 m from veins[0], allowed at least 5e-05 m",
        ),
    ],
)
def test_veins_that_meet_are_named_by_their_indices(second: Any, message: str) -> None:
    for first, other in ((SQUARE, second), (second, SQUARE)):
        assert message in complaint(partial(Scene.from_data, with_veins(first, other)))


def test_the_least_gap_itself_is_allowed() -> None:
    right = box(-0.024 + MIN_GAP, -0.022, 0.001, HEIGHT - MIN_GAP)
    assert len(Scene.from_data(with_veins(SQUARE, right)).tissue.veins) == 2


@pytest.mark.parametrize(
    "outline",
    [
        box(-LENGTH, 0.0, 0.0, HEIGHT / 2),
        box(-LENGTH, 0.0, HEIGHT / 2, HEIGHT),
        box(-0.03, -0.02, 0.0, HEIGHT),
        box(-LENGTH, 0.0, 0.0, HEIGHT),
    ],
    ids=["lower layer", "upper layer", "strip", "whole flap"],
)
def test_layers_and_strips_are_veins(outline: Any) -> None:
    assert Scene.from_data(with_veins(outline)).tissue.veins[0].outline == tuple(map(tuple, outline))


def test_rounding_at_the_surface_is_taken_for_the_surface() -> None:
    top = HEIGHT * (1 + 1e-15)
    assert top != HEIGHT
    (vein,) = Scene.from_data(with_veins(box(-0.03, -0.02, -1e-18, top))).tissue.veins
    assert {y for _, y in vein.outline} == {0.0, HEIGHT}


def test_outlines_become_counter_clockwise_and_open() -> None:
    ring = Vein(outline=np.array(SQUARE), modulus=2e5).outline  # type: ignore[arg-type]
    assert ring == tuple(map(tuple, SQUARE))
    clockwise = [SQUARE[0], *SQUARE[:0:-1]]
    for drawn in (clockwise, [*clockwise, clockwise[0]], [*SQUARE, SQUARE[0]]):
        assert Scene.from_data(with_veins(drawn)).tissue.veins[0].outline == ring


def test_mirrored_tissue_is_as_good() -> None:
    """The rules favour no side: a flap turned over, or end for end, is accepted or refused alike."""
    bad = [with_veins(SQUARE, moved(SQUARE, dx=0.001)), with_veins(moved(SQUARE, dy=0.00136))]
    good = [sample_scene(np.random.default_rng(seed)).dump() for seed in range(30)]
    for scenes, accepted in ((good, True), (bad, False)):
        for scene in scenes:
            for ends, sides in ((False, True), (True, False), (True, True)):
                tissue = copy.deepcopy(scene["tissue"])
                for vein in tissue["veins"]:
                    vein["outline"] = [
                        [-LENGTH - x if ends else x, HEIGHT - y if sides else y] for x, y in vein["outline"]
                    ]
                if accepted:
                    assert len(Tissue(**tissue).veins) == len(tissue["veins"])
                else:
                    complaint(partial(Tissue, **tissue))
