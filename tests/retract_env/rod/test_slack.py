"""The slack of bent sections: derivatives of the energy, and Rivlin's exact flexure of a block of rubber."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.rod import mechanics

Array = NDArray[np.float64]

SECTION = (1.1, 0.07, 0.09, 0.3)
"""A, B, D, G"""
SLACK = 0.14


def energy(v: Array) -> float:
    """v: x', y', theta, theta'."""
    stretch, shear = mechanics.strains(v[0], v[1], math.sin(v[2]), math.cos(v[2]))
    return float(mechanics.energy(stretch, shear, v[3], *SECTION, SLACK))


def gradient(v: Array) -> Array:
    s, c = math.sin(v[2]), math.cos(v[2])
    stretch, shear = mechanics.strains(v[0], v[1], s, c)
    return np.array(mechanics.gradient(stretch, shear, v[3], s, c, *SECTION, SLACK))


@pytest.mark.parametrize("seed", range(5))
def test_forces_and_tangent_are_derivatives_of_the_energy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = np.array([1.0, 0.0, 0.0, 0.0]) + rng.uniform(-0.5, 0.5, 4)
    steps = 1e-6 * np.eye(4)
    slopes = [(energy(v + d) - energy(v - d)) / 2e-6 for d in steps]
    assert gradient(v) == pytest.approx(slopes, abs=1e-8)
    s, c = math.sin(v[2]), math.cos(v[2])
    stretch, shear = mechanics.strains(v[0], v[1], s, c)
    xx, xy, yy, xt, yt, tt, xk, yk, tk, kk = mechanics.hessian(stretch, shear, v[3], s, c, *SECTION, SLACK)
    tangent = [[xx, xy, xt, xk], [xy, yy, yt, yk], [xt, yt, tt, tk], [xk, yk, tk, kk]]
    columns = np.array([(gradient(v + d) - gradient(v - d)) / 2e-6 for d in steps])
    assert np.array(tangent) == pytest.approx(columns, abs=1e-7)


def test_a_bent_section_that_nothing_pulls_is_longer() -> None:
    bend, b = 0.4, SLACK
    force = mechanics.gradient(b * bend**2, 0.0, bend, 0.0, 1.0, 1.0, 0.0, 1 / 12, 0.3, b)
    assert force == pytest.approx((0.0, 0.0, 0.0, bend / 12), abs=1e-15)


@pytest.mark.parametrize("bend", [0.1, 0.2])
def test_rivlins_flexure_has_that_slack(bend: float) -> None:
    # A block of rubber in plane strain, bent to a cylinder by moments alone: its surfaces are stretched by
    # e^(t/2) and e^(-t/2) with sinh t = bend, its middle by sqrt(cosh t).
    middle = math.sqrt(math.cosh(math.asinh(bend))) - 1
    cubic, poisson = 1.5, 1.0  # of rubber that cannot contract sideways; stress goes as t - cubic t^2
    assert middle == pytest.approx((cubic + 1.5 * poisson) / 12 * bend**2, rel=bend**2)
