"""Chains of rod elements against beams whose answer is known, and how fast they tend to it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.beams import elastica, heavy_elastica, polygon
from baselines.verification.chains import (
    LENGTH,
    PLAIN,
    ROUNDING,
    Chains,
    rates,
    settled,
    straight,
    swept,
)
from retract_env.rod.chain import LANES

Array = NDArray[np.float64]

A, _, D, G = PLAIN
STIFF = (1e4, 0.0, D, 1e4)
"""A section that hardly stretches or shears: under the loads below by some 1e-7."""
REFINED = (4, 8, 16, 32)
"""elements"""


def tips(chains: Chains) -> Array:
    """(3, LANES) how the free end has moved."""
    found: Array = chains.nodes[0] - np.array([-LENGTH, 0.5, 0])[:, None]
    return found


def test_the_tip_tends_to_the_elastica_s_in_second_order() -> None:
    alphas = np.linspace(0.1, 1.3, LANES)
    loads, along, across = np.array([elastica(alpha) for alpha in alphas]).T
    errors = []
    for elements in REFINED:
        there = settled(straight(elements, section=STIFF, load=(0.0, loads, 0.0)))
        x, y, theta = there.nodes[0]
        errors.append(np.abs([x + along, y - 0.5 - across, theta + alphas]).max(axis=0))
    assert rates(errors) == pytest.approx(np.full((3, LANES), 2.0), abs=0.1)
    assert np.max(errors[-1]) < 1e-3 * LENGTH


def test_the_tip_tends_to_the_heavy_elastica_s_in_second_order() -> None:
    weights = np.array([0.1, 1.0, 10.0])[np.arange(LANES) % 3] * D / LENGTH**3
    exact = np.array([heavy_elastica(weight) for weight in weights[:3]]).T
    errors = []
    for elements in REFINED:
        there = settled(straight(elements, section=STIFF, weight=weights))
        errors.append(np.abs(tips(there)[:, :3] - exact).max(axis=0))
    assert rates(errors) == pytest.approx(np.full((3, 3), 2.0), abs=0.1)


@pytest.mark.parametrize("elements", [3, 7, 16, 40])
def test_an_end_moment_rolls_the_chain_up_into_a_regular_polygon(elements: int) -> None:
    """Strains and angles are exact, whatever the number of elements; chords are as long as arcs should be.

    So a whole circle closes exactly, if there are elements enough for one.
    """
    turns = np.linspace(-1, 2, LANES) * 2 * np.pi if elements > 6 else np.linspace(-1, 1, LANES) * 2 * np.pi
    # in the direction of -theta, the moment of the clamp being turn D / LENGTH
    there = settled(straight(elements, load=(0.0, 0.0, -turns * D / LENGTH)))
    for lane, turn in enumerate(turns):
        expected = polygon(elements, turn, LENGTH / elements)
        assert there.nodes[:, :, lane] == pytest.approx(
            expected, abs=1e-6
        )  # the residual's tolerance, / stiffness
    assert tips(there)[:2, -1] + [-LENGTH, 0] == pytest.approx([0, 0], abs=1e-6)  # a whole number of circles


def test_the_tip_of_an_arc_tends_to_the_circle_s_in_second_order() -> None:
    turn = 3.0
    exact = np.array([-np.sin(turn), 1 - np.cos(turn)]) * LENGTH / turn + [0, 0.5]
    errors = []
    for elements in REFINED:
        there = settled(straight(elements, load=(0.0, 0.0, -turn * D / LENGTH)))
        errors.append(np.linalg.norm(there.nodes[0, :2, 0] - exact))
    assert rates(errors) == pytest.approx([2.0] * 3, abs=0.05)


@pytest.mark.parametrize("elements", [1, 2, 9])
def test_a_pull_along_the_axis_is_exact(elements: int) -> None:
    strain = np.linspace(-0.002, 0.3, LANES)  # it buckles below -pi^2 D / 4 LENGTH^2
    there = settled(straight(elements, load=(-A * strain, 0.0, 0.0)))
    stretched = -LENGTH * np.linspace(1, 0, elements + 1)[:, None] * (1 + strain)
    assert there.nodes[:, 0] == pytest.approx(stretched, abs=1e-8)
    assert there.nodes[:, 1] == pytest.approx(np.full_like(stretched, 0.5), abs=ROUNDING)


@pytest.mark.parametrize("elements", [1, 2, 4, 8])
def test_a_short_beam_bends_and_shears_as_timoshenko_s(elements: int) -> None:
    """P l^3 / 3 D + P l / G; elements with one point miss a share 1 / 4 n^2 of the bending, and no shear."""
    load = 1e-4
    lengths = np.linspace(0.2, 1.5, LANES)
    chains = straight(elements, length=1.0, load=(0.0, load, 0.0))
    chains.P[0] = lengths / elements
    chains.U[0::3] *= lengths
    there = settled(chains)
    bending, shearing = load * lengths**3 / (3 * D), load * lengths / G
    tip = there.nodes[0, 1] - 0.5
    # deflections are of order 1e-3: what is not linear in them is some 1e-6 of it
    assert tip == pytest.approx(bending * (1 - 1 / (4 * elements**2)) + shearing, rel=1e-5)
    assert tip == pytest.approx(bending + shearing, rel=1 / (4 * elements**2))


COUPLED = (1.1, -0.2, 0.09, 0.3)


@pytest.mark.parametrize("elements", [1, 2, 5, 16])
def test_a_coupled_section_stretches_and_curves_as_its_stiffness_says(elements: int) -> None:
    """A moment curves and stretches it; a pull on the axis with the moment B e leaves it straight."""
    length = 2.0
    stiffness = np.array([COUPLED[:2], COUPLED[1:3]])
    moments = np.linspace(-0.05, 0.05, LANES)
    strain, curvature = np.linalg.solve(stiffness, np.stack([0 * moments, moments]))
    there = settled(straight(elements, length, COUPLED, load=(0.0, 0.0, -moments)))
    for lane in range(LANES):
        expected = polygon(elements, curvature[lane] * length, length / elements * (1 + strain[lane]))
        assert there.nodes[:, :, lane] == pytest.approx(expected, abs=1e-8)

    pull, moment = stiffness @ [0.1, 0.0]
    there = settled(straight(elements, length, COUPLED, load=(-pull, 0.0, -moment)))
    expected = polygon(elements, 0.0, length / elements * 1.1)
    assert there.nodes[:, :, 0] == pytest.approx(expected, abs=1e-8)


def test_a_column_between_clamps_buckles_at_reissner_s_load_in_second_order() -> None:
    """P (1 - P / A + P / G) = 4 pi^2 D / l^2: the straight column is then stretched by -P / A."""
    euler = 4 * np.pi**2 * D / LENGTH**2
    share = 1 / G - 1 / A
    critical = (np.sqrt(1 + 4 * share * euler) - 1) / (2 * share) / A
    errors = []
    for elements in (16, 32, 64):
        low, high = 0.5 * critical, 2 * critical
        while high - low > 1e-12:
            # LANES strains at once
            strains = np.linspace(low, high, LANES)
            column = straight(elements, clamped=True)
            column.U[0::3] *= 1 - strains
            unstable = swept(column).pivots > 0
            assert not unstable[0] and unstable[-1]
            at = int(np.argmax(unstable))
            low, high = strains[at - 1], strains[at]
        errors.append(abs(high / critical - 1))
    assert rates(errors) == pytest.approx([2.0] * 2, abs=0.1)
    assert errors[-1] < 1e-2
