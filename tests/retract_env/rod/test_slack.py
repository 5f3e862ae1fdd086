"""The slack of bent sections: what it is for, and Rivlin's exact flexure of a block of rubber."""

from __future__ import annotations

import math

import pytest

from retract_env.rod import mechanics


def test_a_bent_section_that_nothing_pulls_is_longer() -> None:
    bend, b = 0.4, 0.14
    force = mechanics.gradient(b * bend**2, 0.0, bend, 0.0, 1.0, 1.0, 0.0, 1 / 12, 0.3, b)
    assert force == pytest.approx((0.0, 0.0, 0.0, bend / 12), abs=1e-15)


@pytest.mark.parametrize("bend", [0.1, 0.2])
def test_rivlins_flexure_has_that_slack(bend: float) -> None:
    # A block of rubber in plane strain, bent to a cylinder by moments alone: its surfaces are stretched by
    # e^(t/2) and e^(-t/2) with sinh t = bend, its middle by sqrt(cosh t).
    middle = math.sqrt(math.cosh(math.asinh(bend))) - 1
    cubic, poisson = 1.5, 1.0  # of rubber that cannot contract sideways; stress goes as t - cubic t^2
    assert middle == pytest.approx((cubic + 1.5 * poisson) / 12 * bend**2, rel=bend**2)
