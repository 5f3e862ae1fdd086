"""Code verification: each function finds one number, and what it may be. Experiments of a study call them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from baselines.jobs.journal import Row
from baselines.verification import chains
from baselines.verification.beams import heavy_elastica, polygon
from baselines.verification.bodies import Body, prism_body, relax
from baselines.verification.convergence import beam_drop, errors, limit, tip_drops
from baselines.verification.flaps import EPS, HEIGHT, LENGTH, flap, square_vein
from baselines.verification.sections import split
from planners.paths import ctc
from retract_env.fem.elements import lame
from retract_env.fem.model import FlapModel
from retract_env.grasp import Grasp
from retract_env.mesh import Resolution, section_mesh
from retract_env.physics.fem import FemPhysics

Array = NDArray[np.float64]

MESH = Resolution("verification", patch=1, edge=0.3, growth=0.6, bulk=0.6)
MODULUS, POISSON = 40e3, 0.45
GRASP = Grasp(-0.025, 0.25 * HEIGHT)
SEED = 5


def most(value: float, allowed: float) -> Row:
    """A number that may be no greater."""
    return {"value": value, "least": -math.inf, "most": allowed}


def near(value: float, expected: float, off: float) -> Row:
    """A number that may be off by so much."""
    return {"value": value, "least": expected - off, "most": expected + off}


def _block(poisson: float = POISSON) -> Body:
    """A short flap on an irregular mesh."""
    scene = flap(length=0.012, poisson=poisson)
    return prism_body(scene, section_mesh(scene, None, MESH))


def patch_test(resolution: str) -> Row:  # noqa: ARG001  (of studies; here the mesh is given)
    """Affine boundary values are solved by the affine field, over the body's length."""
    body = _block()
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.9, 0.0], [0.0, 0.0, 1.1]])
    target = body.affine(F)
    sides = [
        body.face(axis, high) for axis, high in ((0, False), (0, True), (1, False), (1, True), (2, True))
    ]
    free = ~body.held(np.any(sides, axis=0), 0, 1, 2)
    u, _ = relax(body.assembly(free), np.where(free, 0.8 * target, target))
    return most(float(np.abs(u - target).max()) / 0.012, 1e-10)


def uniaxial(resolution: str) -> Row:  # noqa: ARG001
    """Force of a bar stretched by half, against the closed form."""
    stretch, poisson = 1.5, POISSON
    mu, lam = (float(v) for v in lame(np.array(MODULUS), np.array(poisson)))
    t = float(brentq(lambda t: mu * (t * t - 1) + lam * np.log(stretch * t * t), 0.3, 3.0, xtol=1e-15))
    return _stretched(np.array([stretch, t, t]), held=(0,), poisson=poisson)


def equibiaxial(resolution: str) -> Row:  # noqa: ARG001
    """Force of a sheet stretched alike in two directions, against the closed form."""
    stretch, poisson = 1.3, POISSON
    mu, lam = (float(v) for v in lame(np.array(MODULUS), np.array(poisson)))
    t = float(brentq(lambda t: mu * (t * t - 1) + lam * np.log(stretch**2 * t), 0.3, 3.0, xtol=1e-15))
    return _stretched(np.array([stretch, stretch, t]), held=(0, 1), poisson=poisson)


def _stretched(stretches: Array, held: tuple[int, ...], poisson: float) -> Row:
    """Error of the force on the end x of a block whose ends in the directions `held` are moved apart."""
    body = _block(poisson)
    prescribed = np.zeros(body.size, bool)
    for axis in range(3):
        prescribed |= body.held(body.face(axis, False), axis)
        if axis in held:
            prescribed |= body.held(body.face(axis, True), axis)
    target = body.affine(np.diag(stretches))
    # the guess is off where nothing holds it
    off = body.affine(np.diag(np.where(np.isin(range(3), held), stretches, 1 + 0.9 * (stretches - 1))))
    _, force = relax(body.assembly(~prescribed), np.where(prescribed, target, off))
    mu, lam = (float(v) for v in lame(np.array(MODULUS), np.array(poisson)))
    stress = mu * stretches[0] + (lam * math.log(math.prod(stretches)) - mu) / stretches[0]
    size = np.ptp(body.at, axis=0)
    found = float(body.vectors(force)[body.face(0, True), 0].sum())
    return most(abs(found / (stress * size[1] * size[2]) - 1), 1e-9)


def manufactured_order(resolution: str, gradient: bool) -> Row:  # noqa: ARG001
    """Rate at which the error of displacement, or of its gradient, shrinks with the mesh's size."""
    scene = flap(length=HEIGHT)
    section = section_mesh(scene, None, Resolution("verification", 1, 0.3, 0.6, 0.5))
    found = []
    for layers in (2, 4, 8):
        found.append(errors(section, layers, POISSON)[gradient])
        section = split(section, scene)
    rate = math.log2(found[-2] / found[-1])
    return near(rate, 2.0 if gradient else 3.0, 0.2) | {"errors": found}


def light_cantilever(resolution: str) -> Row:  # noqa: ARG001
    """Droop under a thousandth of its weight against Timoshenko's beam, relative."""
    scene = flap(modulus=600e3, poisson=0.0, gravity=0.01, bed=False)
    drop = limit(tip_drops(scene, cells=10, levels=3))
    return most(abs(drop / beam_drop(scene) - 1), (HEIGHT / LENGTH) ** 3)


def heavy_cantilever(resolution: str) -> Row:  # noqa: ARG001
    """Droop under its weight against Reissner's rod, relative: they differ by the strain's square."""
    scene = flap(modulus=600e3, poisson=0.0, bed=False)
    return most(abs(limit(tip_drops(scene, cells=10, levels=3)) / beam_drop(scene) - 1), 0.03**2)


def published_cantilever(resolution: str) -> Row:  # noqa: ARG001
    """cm, droop at E = 600 kPa, nu = .45, against the finest mesh of several codes."""
    scene = flap(modulus=600e3, bed=False)
    return near(100 * limit(tip_drops(scene, cells=10, levels=3)), 0.7675, 2e-3 * 0.7675)


def rigid_rotation(resolution: str) -> Row:  # noqa: ARG001
    """Greatest force of a flap that is turned as a whole, over E times the height squared."""
    body = prism_body(flap(), section_mesh(flap(), None, MESH))
    worst = 0.0
    for degrees in (1.0, 30.0, 90.0, 180.0):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        _, force = body.whole.residual(body.affine(turn, (0.3, -0.1, 0.0)))
        worst = max(worst, float(np.abs(force).max()))
    # places of half a metre, elements of a tenth of a millimetre
    return most(worst / (MODULUS * HEIGHT**2), 1e4 * EPS)


def _veined() -> FlapModel:
    """Off its bed, which would make corners where a node just touches it."""
    scene = flap(veins=[square_vein(-0.02, 0.0024, 0.0008)], bed=False)
    return FlapModel(scene, section_mesh(scene, GRASP.x, MESH), GRASP.x)


def _bent(model: FlapModel) -> Array:
    """A shape at random, every free unknown off by up to a hundredth of the height."""
    rng = np.random.default_rng(SEED)
    u = np.zeros(model.prism.size)
    u[model.free] = 1e-2 * HEIGHT * rng.uniform(-1, 1, len(model.free))
    return u


def residual_order(resolution: str) -> Row:  # noqa: ARG001
    """Rate at which differences of the energy tend to the forces, weight included."""
    model = _veined()
    u = _bent(model)
    way = np.random.default_rng(SEED + 1).uniform(-1, 1, len(u)) * 1e-3 * HEIGHT
    slope = float(model.residual(u)[1] @ way)
    return near(_rate(lambda t: model.residual(u + t * way)[0], slope, (0.2, 0.1)), 2.0, 0.2)


def tangent_order(resolution: str) -> Row:  # noqa: ARG001
    """Rate at which differences of the forces tend to the tangent."""
    model = _veined()
    u, rng = _bent(model), np.random.default_rng(SEED + 2)
    way, other = rng.uniform(-1, 1, (2, len(u))) * 1e-3 * HEIGHT
    slope = float(model.tangent_times(u, way) @ other)
    return near(_rate(lambda t: float(model.residual(u + t * way)[1] @ other), slope, (0.2, 0.1)), 2.0, 0.2)


def _rate(value: Callable[[float], float], slope: float, steps: tuple[float, float]) -> float:
    """Order of central differences."""
    off = [abs((value(t) - value(-t)) / (2 * t) - slope) for t in steps]
    return math.log2(off[0] / off[1]) / math.log2(steps[0] / steps[1])


def energy_balance(resolution: str) -> Row:
    """What the jaws do along a retraction, over what the flap's potential energy has grown, less 1.

    The work is summed over increments by the trapezoidal rule. A grip that is no firmer than friction asks
    for, and three quarters of the path: firmer ones, and jaws that bend the flap sharply in the end, fold the
    surface at a jaw's edge, which snaps and loses energy.
    """
    scene, grasp = flap(), Grasp(-0.035, 0.12 * HEIGHT)
    path = ctc(scene, grasp)
    physics = FemPhysics(scene, grasp.x, resolution)
    physics.reset()
    begin = physics.model.residual(physics.displacements)[0]
    work, before = 0.0, physics.displacements
    force = physics.model.residual(before)[1]
    for progress in np.concatenate([np.linspace(0, 1, 17)[1:], np.linspace(1, path.last, 97)[1:73]]):
        physics.move_to(path.pose_at(float(progress)), float(progress))
        after = physics.displacements
        pulled = physics.model.residual(after)[1]
        held = physics.model.driven
        work += float(((pulled + force) / 2)[held] @ (after - before)[held])
        before, force = after, pulled
    grown = physics.model.residual(before)[0] - begin
    return most(abs(work / grown - 1), 5e-3)


def rolled_up_rod(resolution: str) -> Row:  # noqa: ARG001
    """Heights, greatest deviation of a rod that a moment rolls up to a circle from the regular polygon."""
    turn, elements = 2 * math.pi, 16
    stiffness = chains.PLAIN[2] / chains.LENGTH
    there = chains.settled(chains.straight(elements, load=(0.0, 0.0, -turn * stiffness)))
    return most(
        float(np.abs(there.nodes[:, :, 0] - polygon(elements, turn, chains.LENGTH / elements)).max()), 1e-6
    )


def hanging_rod_order(resolution: str) -> Row:  # noqa: ARG001
    """Rate at which a rod's droop tends to that of the heavy elastica."""
    stiff = (1e4, 0.0, chains.PLAIN[2], 1e4)
    weight = chains.PLAIN[2] / chains.LENGTH**3
    exact, off = heavy_elastica(weight), []
    for elements in (8, 16, 32):
        tip = chains.settled(chains.straight(elements, section=stiff, weight=weight)).nodes[0, :, 0]
        off.append(float(np.abs(tip - np.array([-chains.LENGTH, 0.5, 0.0]) - exact).max()))
    return near(min(math.log2(a / b) for a, b in pairwise(off)), 2.0, 0.1)


Check = tuple[str, Callable[..., Row], dict[str, Any], str]
CHECKS: tuple[Check, ...] = (
    ("patch test, irregular mesh: deviation over the length", patch_test, {}, ""),
    ("uniaxial stretch by 1.5: error of the force", uniaxial, {}, ""),
    ("equibiaxial stretch by 1.3: error of the force", equibiaxial, {}, ""),
    ("manufactured solution: order of displacement", manufactured_order, {"gradient": False}, ""),
    ("manufactured solution: order of its gradient", manufactured_order, {"gradient": True}, ""),
    ("cantilever, small load, against Timoshenko's beam", light_cantilever, {}, ""),
    ("cantilever, large load, against Reissner's rod", heavy_cantilever, {}, ""),
    ("cantilever, large load, several codes' droop", published_cantilever, {}, "cm"),
    ("rigid rotation up to 180 degrees: force", rigid_rotation, {}, ""),
    ("forces from differences of the energy: order", residual_order, {}, ""),
    ("tangent from differences of the forces: order", tangent_order, {}, ""),
    ("work of the jaws against the energy gained", energy_balance, {}, ""),
    ("rod rolled up into a circle: deviation", rolled_up_rod, {}, "heights"),
    ("rod that hangs, against the heavy elastica: order", hanging_rod_order, {}, ""),
)
"""What is checked, by which function with which arguments, and its unit."""
