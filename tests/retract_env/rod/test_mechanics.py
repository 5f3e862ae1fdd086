"""The rod element's formulas against each other: energy, its derivatives, and what must not change it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.rod.mechanics import blocked, energy, gradient, hessian, resting, sine_cosine, strains

Array = NDArray[np.float64]

SECTION = (1.1, -0.2, 0.09, 0.3)
"""A, B, D and G of a section with a vein above the axis"""
SLACK = 0.14
BED, BLOCK = 0.3, 0.7


def test_sine_and_cosine_are_as_exact_as_claimed() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-100, 100, 20000), np.arange(-127, 128) * np.pi / 4, [0.0]])
    x = x[np.abs(x) < 100]
    found = np.array([sine_cosine(v) for v in x])
    assert np.abs(found - np.stack([np.sin(x), np.cos(x)], axis=1)).max() <= 1e-15


def element_energy(u: Array) -> float:
    """U over (x', y', theta, theta')."""
    s, c = np.sin(u[2]), np.cos(u[2])
    stretch, shear = strains(u[0], u[1], s, c)
    return float(energy(stretch, shear, u[3], *SECTION, SLACK))


def element_gradient(u: Array) -> Array:
    s, c = np.sin(u[2]), np.cos(u[2])
    stretch, shear = strains(u[0], u[1], s, c)
    return np.array(gradient(stretch, shear, u[3], s, c, *SECTION, SLACK))


def element_hessian(u: Array) -> Array:
    s, c = np.sin(u[2]), np.cos(u[2])
    stretch, shear = strains(u[0], u[1], s, c)
    xx, xy, yy, xt, yt, tt, xk, yk, tk, kk = hessian(stretch, shear, u[3], s, c, *SECTION, SLACK)
    return np.array([[xx, xy, xt, xk], [xy, yy, yt, yk], [xt, yt, tt, tk], [xk, yk, tk, kk]])


def pushed(u: Array) -> tuple[Array, Array]:
    """Energy and gradient over (x, y, theta) of what bed and block do, and the Hessian."""
    s, c = np.sin(u[2]), np.cos(u[2])
    lying, ly, lt, lyy, lyt, ltt = resting(u[1], s, c, BED)
    inside, gx, gy, gt, xx, yy, xt, yt, tt = blocked(u[0], u[1], s, c, BLOCK)
    first = np.array([lying + inside, gx, ly + gy, lt + gt])
    return first, np.array([[xx, 0, xt], [0, lyy + yy, lyt + yt], [xt, lyt + yt, ltt + tt]])


def pushed_energy(u: Array) -> float:
    return float(pushed(u)[0][0])


def pushed_gradient(u: Array) -> Array:
    return pushed(u)[0][1:]


def pushed_hessian(u: Array) -> Array:
    return pushed(u)[1]


def derivative_errors(function: Any, derivative: Any, at: Array) -> tuple[float, float]:
    """Of central differences with some step and with half of it, the greatest over all components."""
    exact, errors = np.atleast_1d(derivative(at)), []
    for step in (2e-3, 1e-3):
        differences = [
            (function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))
        ]
        errors.append(float(np.abs(np.array(differences) - exact).max()))
    return errors[0], errors[1]


ELEMENT = np.array([0.9, 0.3, 0.7, -0.4])
PUSHED = {
    "bed": np.array([-1.0, 0.3, 0.4]),
    "block, from the left": np.array([-0.1, 0.9, 0.8]),
    "block, from above": np.array([1.0, 1.4, -0.2]),
    "bed and block": np.array([0.05, 0.2, 0.3]),
    "block, upper surface": np.array([1.0, 1.3, -3.0]),
    "block, both surfaces": np.array([0.1, 0.8, 0.3]),
}


@pytest.mark.parametrize(
    ("function", "derivative", "at"),
    [
        pytest.param(element_energy, element_gradient, ELEMENT, id="element's energy"),
        pytest.param(element_gradient, element_hessian, ELEMENT, id="element's gradient"),
        *(
            pytest.param(pushed_energy, pushed_gradient, u, id=f"energy, {name}")
            for name, u in PUSHED.items()
        ),
        *(
            pytest.param(pushed_gradient, pushed_hessian, u, id=f"gradient, {name}")
            for name, u in PUSHED.items()
        ),
    ],
)
def test_derivatives_are_those_that_differences_tend_to(function: Any, derivative: Any, at: Array) -> None:
    coarse, fine = derivative_errors(function, derivative, at)
    assert coarse / fine == pytest.approx(4, abs=0.1)
    assert fine < 1e-6


def test_each_contact_is_the_one_it_is_named_after() -> None:
    bed, left, above, both, upper, _ = (pushed_gradient(u) for u in PUSHED.values())
    assert upper[0] == 0 and upper[1] < 0
    assert bed[0] == 0 and bed[1] < 0
    assert left[0] > 0 and left[1] == 0
    assert above[0] == 0 and above[1] < 0
    assert both[0] > 0 and both[1] < 0


def test_bed_and_block_push_in_proportion_to_depth_and_nowhere_else() -> None:
    assert pushed_gradient(np.array([-3.0, 0.5 - 0.02, 0.0])) == pytest.approx([0, -BED * 0.02, 0])
    assert pushed_gradient(np.array([2.0, 1.5 - 0.02, 0.0])) == pytest.approx([0, -BLOCK * 0.02, 0])
    assert pushed_gradient(np.array([0.02, 0.6, 0.0])) == pytest.approx([BLOCK * 0.02, 0, BLOCK * 0.01])
    for free in ([-3.0, 0.5, 0.0], [-1.0, 2.0, 1.0], [2.0, 1.5, 0.0], [0.5, 2.1, -0.5]):
        u = np.array(free)
        assert pushed_energy(u) == 0 and not pushed_gradient(u).any() and not pushed_hessian(u).any()


def test_nothing_jumps_at_the_corner_of_the_block() -> None:
    # around the corner, at depths that tend to 0, what pushes is no more than the depth allows
    for theta in (0.0, 0.6, -0.9):
        corner = np.array([-0.5 * np.sin(theta), 1 + 0.5 * np.cos(theta), theta])
        for radius in (1e-2, 1e-4, 1e-6):
            for way in np.linspace(0, 2 * np.pi, 25):
                u = corner + radius * np.array([np.cos(way), np.sin(way), 0])
                assert np.abs(pushed_gradient(u)).max() <= BLOCK * radius * (1 + 1e-9)


def test_the_energy_of_contact_is_continuous_inside_the_block_too() -> None:
    # where the two ways out are as long: the push turns there, but by both ways it stores as much
    for depth in (0.3, 0.1, 0.01):
        aside, above = np.array([depth - 1e-9, 1.5 - depth, 0.0]), np.array([depth + 1e-9, 1.5 - depth, 0.0])
        assert pushed_gradient(aside)[1] == 0 and pushed_gradient(above)[0] == 0
        assert pushed_energy(aside) == pytest.approx(pushed_energy(above), rel=1e-6)


def test_strains_are_those_of_the_definition() -> None:
    # a section along the axis: stretch alone; the axis turned away from the section: shear
    for theta, stretch in ((0.0, 0.1), (1.2, -0.2), (-2.5, 0.0)):
        s, c = np.sin(theta), np.cos(theta)
        assert strains((1 + stretch) * c, (1 + stretch) * s, s, c) == pytest.approx((stretch, 0), abs=1e-15)
        assert strains(c - 0.3 * s, s + 0.3 * c, s, c) == pytest.approx((0, 0.3), abs=1e-15)
