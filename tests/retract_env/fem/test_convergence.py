"""Errors shrink at the rates of theory: a manufactured finite-strain solution, cantilevers that droop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from baselines.verification.convergence import beam_drop, errors, limit, tip_drops
from baselines.verification.flaps import HEIGHT, LENGTH, flap
from baselines.verification.sections import split
from retract_env.mesh import Resolution, section_mesh


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
def test_a_manufactured_solution_converges_at_third_order_and_its_gradient_at_second(poisson: float) -> None:
    scene = flap(length=HEIGHT)
    section = section_mesh(scene, None, Resolution("test", 1, 0.3, 0.6, 0.5))
    found = []
    for layers in (2, 4, 8):
        found.append(errors(section, layers, poisson))
        section = split(section, scene)
    displacement, gradient = np.log2(np.array(found[-2]) / np.array(found[-1]))
    assert displacement == pytest.approx(3, abs=0.2)
    assert gradient == pytest.approx(2, abs=0.2)
    assert found[-1][0] < 0.003


def corner_exponent(poisson: float) -> float:
    """Exponent of displacement where a clamped and a free side meet at right angles (Williams 1952)."""
    kappa = 3 - 4 * poisson
    return brentq(
        lambda e: np.sin(e * np.pi / 2) ** 2 - ((kappa + 1) ** 2 - 4 * e**2) / (4 * kappa), 0.3, 0.999
    )


def test_a_small_load_bends_the_flap_as_timoshenkos_beam() -> None:
    scene = flap(modulus=600e3, poisson=0.0, gravity=0.01, bed=False)
    drop = limit(tip_drops(scene, cells=10, levels=3))
    # without lateral contraction the clamp disturbs nothing; warping at it has the size of (h / l)^3
    assert drop == pytest.approx(beam_drop(scene), rel=(HEIGHT / LENGTH) ** 3)
    tissue = scene.tissue
    euler = 1.5 * tissue.density * scene.gravity * LENGTH**4 / (tissue.modulus * HEIGHT**2)
    shear = 0.6 * 2 * tissue.density * scene.gravity * LENGTH**2 / tissue.modulus
    assert drop == pytest.approx(euler + shear, rel=(HEIGHT / LENGTH) ** 3)


def test_a_large_load_bends_the_flap_as_reissners_rod() -> None:
    scene = flap(modulus=600e3, poisson=0.0, bed=False)
    drops = tip_drops(scene, cells=10, levels=3)
    # the material's moment differs from E I times curvature by the square of the strain, 3 % at the clamp
    assert limit(drops) == pytest.approx(beam_drop(scene), rel=0.03**2)
    assert beam_drop(scene, flexible=False) == pytest.approx(0.7756e-2, abs=1e-6)  # published: the elastica
    order = np.log2(np.diff(drops)[0] / np.diff(drops)[1])
    # between those of displacement, 3, and of energy, 4
    assert 2.9 < order < 4.1


def test_the_published_cantilever() -> None:
    """Tip drop 0.7675 cm of the finest of several codes' meshes, E = 600 kPa, nu = 0.45."""
    scene = flap(modulus=600e3, bed=False)
    assert limit(tip_drops(scene, cells=10, levels=3)) == pytest.approx(0.7675e-2, rel=2e-3)


def test_a_clamped_corner_sets_the_rate_of_nearly_incompressible_tissue() -> None:
    """Energy, and with it the drop under a dead load, converges with twice the singularity's exponent."""
    scene = flap(length=4 * HEIGHT, gravity=0.01, bed=False)
    drops = tip_drops(scene, cells=4, levels=4)
    order = np.log2(np.diff(drops)[-2] / np.diff(drops)[-1])
    assert order == pytest.approx(2 * corner_exponent(0.45), abs=0.15)
    assert (np.diff(drops) > 0).all()  # too stiff, never too soft
