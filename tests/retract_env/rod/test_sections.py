"""Sections of the rod against the formulas of composite beams, and the grip against a scaling law."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.verification.flaps import HEIGHT, LENGTH, flap
from planners.elastica.grip import measured_grip
from retract_env.grasp import Grasp
from retract_env.rod.sections import elements
from retract_env.scene import Tissue, Vein
from tests.planners.retractions import box

E = 40e3


def tissue(*veins: Vein) -> Tissue:
    return flap(veins=veins).tissue


def layer(low: float, high: float) -> Vein:
    return box(-LENGTH, 0.0, low, high, 5 * E)


def test_a_homogeneous_section() -> None:
    part = elements(tissue(), -0.04, -0.01, 3)
    area, inertia = HEIGHT**2, HEIGHT**4 / 12
    assert part.length == pytest.approx(0.01)
    assert part.stretch == pytest.approx(np.full(3, 1 / (E * area)))
    assert part.bend == pytest.approx(np.full(3, 1 / (E * inertia)))
    assert part.shear == pytest.approx(np.full(3, 2 * 1.45 / (5 / 6 * E * area)))
    assert part.couple == pytest.approx(np.zeros(3), abs=1e-12)
    # a moment that curves the flap upwards stretches its lower surface
    assert part.bottom[:, 1] == pytest.approx(HEIGHT / 2 * part.bend)
    assert part.top[:, 1] == pytest.approx(-HEIGHT / 2 * part.bend)


def test_a_flap_that_is_all_vein_is_as_stiff_as_the_vein() -> None:
    soft, stiff = (elements(tissue(*veins), -0.05, 0.0, 4) for veins in ((), (layer(0.0, HEIGHT),)))
    for name in ("stretch", "bend", "shear", "bottom", "top"):
        assert getattr(stiff, name) == pytest.approx(getattr(soft, name) / 5)


def test_a_stiff_lower_half_moves_the_neutral_axis_down() -> None:
    part = elements(tissue(layer(0.0, HEIGHT / 2)), -0.03, -0.02, 2)
    half = HEIGHT**2 / 2
    area = 6 * E * half
    axis = (E - 5 * E) * half * (HEIGHT / 4) / area  # of the modulus over the section
    inertia = 6 * E * half * HEIGHT**2 / 12 - area * axis**2
    assert part.bend == pytest.approx(np.full(2, 1 / inertia))
    assert part.couple == pytest.approx(axis / inertia * np.ones(2))
    # a force through the neutral axis, M = -N axis, does not bend
    assert part.couple - part.bend * axis == pytest.approx(np.zeros(2), abs=1e-9 * part.bend.max())
    assert part.stretch - part.couple * axis == pytest.approx(np.full(2, 1 / area))


def test_a_vein_counts_by_its_chords() -> None:
    diamond = Vein(
        outline=((-0.03, HEIGHT / 2), (-0.025, 0.001), (-0.02, HEIGHT / 2), (-0.025, HEIGHT - 0.001)),
        modulus=5 * E,
    )
    part = elements(tissue(diamond), -0.035, -0.015, 400)
    x = -0.035 + part.length * (np.arange(400) + 0.5)
    chord = (HEIGHT - 0.002) * np.clip(1 - np.abs(x + 0.025) / 0.005, 0, None)
    stretch = 1 / (E * HEIGHT * (HEIGHT + 4 * chord))
    assert part.stretch == pytest.approx(stretch, rel=1e-3)
    assert part.couple == pytest.approx(np.zeros(400), abs=1e-9 * part.bend.max())
    # the softest slice decides the strain of an element
    whole = elements(tissue(diamond), -0.04, -0.01, 1)
    soft = elements(tissue(), -0.04, -0.01, 1)
    assert whole.bottom == pytest.approx(soft.bottom)
    assert whole.bend < soft.bend


def test_the_grip_scales_with_modulus_and_size() -> None:
    small, large = flap(), flap(2 * LENGTH, 2 * HEIGHT, 2 * HEIGHT, modulus=3 * E)
    large = large.model_copy(update={"jaws": large.jaws.model_copy(update={"width": 2e-3}), "gravity": 0.0})
    small = small.model_copy(update={"gravity": 0.0})
    a = measured_grip(small, Grasp(-0.03, 1e-3))
    b = measured_grip(large, Grasp(-0.06, 2e-3))
    assert b.normal == pytest.approx([12 * n for n in a.normal], rel=1e-3)
    assert b.strain == pytest.approx(a.strain, rel=1e-3)
    # pressed evenly, without friction at its sides, a column of the jaws' width alone would bear E w d c
    assert a.normal[0] > E * 1e-3 * HEIGHT
    assert 1 < a.strain[0] < 1.5
