"""The flap in time: vibrations of a cantilever, their decay, and equilibrium as what is left of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.flaps import HEIGHT, LENGTH, flap
from baselines.verification.sections import grid_section
from retract_env.fem.dynamics import GAMMA, Motion, MovingFlap
from retract_env.fem.solver import Equilibrium

Array = NDArray[np.float64]

MODULUS, DENSITY = 40e3, 1000.0
PERIOD = 2 * np.pi * LENGTH**2 / 1.8751040687**2 / np.sqrt(MODULUS / DENSITY * HEIGHT**2 / 12)
"""s, of a slender cantilever's first vibration, by Euler and Bernoulli"""


def cantilever(gravity: float = 0.02) -> MovingFlap:
    """It hangs down by so little that it is a linear beam, and is slender."""
    scene = flap(gravity=gravity, bed=False, poisson=0.3)
    section = grid_section(np.linspace(-LENGTH, 0, 13), np.linspace(0, HEIGHT, 3), scene)
    return MovingFlap(scene, section, None)


def let_go(model: MovingFlap, steps: int, periods: float, drag: float = 0.0) -> tuple[Array, Array]:
    """Times, s, and places of the free end, m, without the weight under which it was at rest."""
    equilibrium = Equilibrium(model)
    u, _ = equilibrium.solve(model.at_rest())
    model.weigh(0.0)
    tip = int(np.argmin(np.hypot(*(model.section.points - [-LENGTH, HEIGHT / 2]).T)))
    motion, step = Motion(model, drag), PERIOD / steps
    equilibrium.forget()
    places = [model.prism.in_plane(u, 0)[tip, 1]]
    for _ in range(round(steps * periods)):
        u, _ = equilibrium.solve(motion.predict(u, step))
        motion.arrived(u, step)
        places.append(model.prism.in_plane(u, 0)[tip, 1])
    return step * np.arange(len(places)), np.array(places)


def lows(times: Array, places: Array) -> tuple[Array, Array]:
    """When and how low the free end is where it turns round, by parabolas through three places each."""
    k = np.flatnonzero((places[1:-1] < places[:-2]) & (places[1:-1] <= places[2:])) + 1
    before, at, after = places[k - 1], places[k], places[k + 1]
    off = (before - after) / (2 * (before - 2 * at + after))
    return times[k] + off * (times[1] - times[0]), at - (before - after) * off / 4


def test_the_mass_is_that_of_half_the_flap() -> None:
    model = cantilever()
    free = model.mass.reshape(-1, model.prism.stride)[:, 1 : 2 * model.prism.levels : 2].sum()
    at_the_wall = DENSITY * HEIGHT * HEIGHT / 2 * LENGTH / 12
    assert DENSITY * LENGTH * HEIGHT * HEIGHT / 2 - free == pytest.approx(0, abs=at_the_wall)


def test_a_cantilever_vibrates_as_often_as_a_beam_does() -> None:
    times, places = let_go(cantilever(), 100, 2.3)
    when, _ = lows(times, places)
    # shear, and the inertia of turning, make it slower by some parts of (h / l)^2
    assert when[0] / PERIOD == pytest.approx(1.0, abs=4 * (HEIGHT / LENGTH) ** 2)
    assert np.diff(when) / PERIOD == pytest.approx(1.0, abs=4 * (HEIGHT / LENGTH) ** 2)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.2])
def test_vibrations_die_away_as_asked(damping: float) -> None:
    steps = 100
    times, places = let_go(cantilever(), steps, 2.3, drag=2 * damping * 2 * np.pi / PERIOD)
    _, low = lows(times, places)
    asked = damping + np.pi * (GAMMA - 0.5) / steps  # what the method adds itself
    shrinks = np.exp(-2 * np.pi * asked / np.sqrt(1 - asked**2))
    assert low[1] / low[0] == pytest.approx(shrinks, rel=0.03)


def test_what_is_left_of_a_vibration_is_the_equilibrium() -> None:
    """Under half its weight, which it was given at once, and with so much drag that it creeps there."""
    model = cantilever()
    equilibrium = Equilibrium(model)
    model.weigh(0.5)
    expected, _ = equilibrium.solve(model.at_rest())
    model.weigh(1.0)
    u, _ = equilibrium.solve(model.at_rest())
    model.weigh(0.5)
    motion = Motion(model, 4 * np.pi / PERIOD)
    for _ in range(200):
        u, _ = equilibrium.solve(motion.predict(u, PERIOD / 50))
        motion.arrived(u, PERIOD / 50)
    assert np.abs(u - expected).max() < 1e-3 * np.abs(expected).max()
