"""fem_gradient: its derivatives, its linear program, and what it finds."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import planners
from baselines.verification.flaps import HEIGHT
from planners import eased, effort
from planners.base import Candidate, NoPlan, Plan
from planners.certify import certify
from planners.effort import TooCostly
from planners.fem_gradient.planner import (
    ENOUGH,
    GRIP,
    HOLDS,
    KIND,
    PART,
    STRETCH,
    TIMES,
    TURN,
    UNITS,
    Program,
    begun,
    jaw_path,
    motion,
    motion_slope,
)
from planners.fem_gradient.sensitivity import Response, Sensitivity
from planners.light_grip import LightGrip
from planners.paths import arc_turn, ctc, goal_radius
from planners.search import race
from planners.swift import program as program_of_the_rod
from retract_env.mesh import Resolution
from retract_env.objectives import clearance, required_friction, worst_mean
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene
from tests.planners.retractions import a_grasp, a_scene, veined

Array = NDArray[np.float64]

TINY = Resolution("tiny", patch=2, edge=0.5, growth=1.0, bulk=1.0, bed=0.3, vein_corners=4)
GRASP = a_grasp(-0.03, 0.06)
HOMOGENEOUS = a_scene(friction=0.5)
LIGHT = a_grasp(-0.035, 0.085)
"""The place and grip that `light_grip` comes to on this scene."""


@cache
def bent(name: str) -> tuple[Sensitivity, Response, FemPhysics]:
    """A flap half way to exposure, part of it still on its bed, with its derivatives."""
    scene = {"homogeneous": HOMOGENEOUS, "veined": veined()}[name]
    path = eased.eased(scene, GRASP, 12)
    physics = FemPhysics(scene, GRASP.x, TINY)
    physics.reset()
    for k in range(1, 8):
        physics.move_to(path.pose_at(k), float(k))
    sensitivity = Sensitivity(physics)
    return sensitivity, sensitivity.settled(path.pose_at(7.0), physics.displacements), physics


@cache
def program() -> Program:
    """Begun with an eased path that neither holds nor clears the line."""
    line = HOMOGENEOUS.line_of_sight
    turn = 0.95 * float(arc_turn(1 / goal_radius(line.camera, line.target), -GRASP.x, HEIGHT))
    begin = np.array([turn, *(0.01 * np.array([1, 2, 3]) / 3), *[0.82] * 3, *[0.03] * 4])
    return Program(HOMOGENEOUS, GRASP.x, begin, "coarse")


def check_slope(value: Callable[[float], Array], slope: Array, step: float) -> None:
    """Central differences D(h) leave out c h^2, so that D(h/2) is off by a third of D(h) - D(h/2); twice that
    is left for higher orders, and 1e-6 for what is left of the residual in each equilibrium."""
    wide, narrow = ((value(h) - value(-h)) / (2 * h) for h in (step, step / 2))
    allowed = np.abs(wide - narrow).max() + 1e-6 * np.abs(slope).max()
    assert np.abs(slope).max() > 0
    assert np.abs(slope - narrow).max() <= allowed
    assert allowed < 0.02 * np.abs(slope).max()  # else the step was too long to tell


# --- Derivatives


@pytest.mark.parametrize("name", ["homogeneous", "veined"])
@pytest.mark.parametrize(("component", "step"), [(0, 2e-5), (1, 2e-5), (2, 2e-3), (3, 1e-5)])
def test_slopes_are_what_differences_of_equilibria_say(name: str, component: int, step: float) -> None:
    """Strain, jaw forces, clearance and the displacements themselves, by x, y, theta and separation."""
    sensitivity, at, _ = bent(name)

    @cache
    def moved(h: float) -> Response:
        return sensitivity.at(at.pose + h * np.eye(4)[component], at)

    worst = at.strains >= np.sort(at.strains)[-20]
    check_slope(lambda h: moved(h).u, at.slope[:, component], step)
    check_slope(lambda h: moved(h).strains[worst], at.strains_slope[worst, component], step)
    check_slope(lambda h: moved(h).forces, at.forces_slope[:, :, component], step)
    check_slope(lambda h: moved(h).clearances, at.clearances_slope[:, component], step)


@pytest.mark.parametrize("name", ["homogeneous", "veined"])
def test_responses_are_measured_as_the_certifier_measures(name: str) -> None:
    sensitivity, at, physics = bent(name)
    state = physics.state()
    # the state's equilibrium is known to a strain of 1e-5
    assert worst_mean(at.strains, sensitivity.volumes) == pytest.approx(state.worst_strain, abs=2e-5)
    assert at.clearances.min() == pytest.approx(state.clearance, abs=1e-5 * 0.05)
    line = physics.scene.line_of_sight
    every = np.concatenate([sensitivity.model.positions(at.u, k) for k in range(2)])
    assert at.clearances.min() == pytest.approx(clearance(every, line.camera, line.target), rel=1e-12)
    friction = np.abs(at.forces[:, 0]) / at.forces[:, 1]
    assert friction == pytest.approx(required_friction(state.reactions, state.normals), rel=1e-3)


def test_motion_slopes_are_differences_of_poses() -> None:
    times = np.linspace(0, 1, 7)
    unknowns = np.array([1.1, 0.005, 0.01, 0.02, 0.7, 0.8, 0.9, 0.05, 0.04, 0.06, 0.03])
    slope = motion_slope(HOMOGENEOUS, -0.03, unknowns, times)
    for k in range(11):

        def value(h: float, k: int = k) -> Array:
            return motion(HOMOGENEOUS, -0.03, unknowns + h * UNITS * np.eye(11)[k], times)

        check_slope(value, slope[:, :, k], 1e-2)


# --- Paths


def test_eased_paths_are_among_the_motions() -> None:
    scene, times = HOMOGENEOUS, np.linspace(0, 1.2, 9)
    line = scene.line_of_sight
    goal = float(arc_turn(1 / goal_radius(line.camera, line.target), -GRASP.x, HEIGHT))
    unknowns = np.empty(11)
    unknowns[TURN], unknowns[PART], unknowns[GRIP] = goal, eased.TURN, GRASP.compression / HEIGHT
    unknowns[STRETCH] = eased.STRETCH * np.array([1, 2, 3]) / 3
    poses = eased.eased(scene, GRASP, 400).poses[1:]
    found = motion(scene, GRASP.x, unknowns, times)
    for k in range(4):
        # between 400 waypoints a smooth path differs from its chords by 1e-5 of its size
        at = np.interp(-found[:, 2], -poses[:, 2], poses[:, k])
        assert found[:, k] == pytest.approx(at, abs=1e-4 * max(np.abs(poses[:, k]).max(), HEIGHT))


def test_paths_begin_squeezed_in_place() -> None:
    unknowns = np.array([1.1, 0.005, 0.01, 0.02, 0.7, 0.8, 0.9, 0.05, 0.04, 0.06, 0.03])
    grasp, path = jaw_path(HOMOGENEOUS, -0.03, unknowns)
    assert grasp.x == -0.03 and grasp.compression == pytest.approx(0.05 * HEIGHT)
    assert path.poses[0] == pytest.approx([-0.03, HEIGHT / 2, 0.0, HEIGHT])
    assert path.poses[1] == pytest.approx([-0.03, HEIGHT / 2, 0.0, HEIGHT - grasp.compression])
    assert path.poses[-1, 3] == pytest.approx(0.97 * HEIGHT)


# --- The linear program


def test_no_step_promises_what_the_finite_elements_found() -> None:
    """The program's eps_1% is `worst_mean`, to the last digits that its solver gives."""
    first = program()
    merit = first._merit(first.unknowns, first.responses)
    _, promised = first._step(1e-9)
    assert promised == pytest.approx(merit, abs=1e-5)


def test_linear_models_are_off_by_the_square_of_the_step() -> None:
    first = program()
    slopes = motion_slope(first.scene, first.x, first.unknowns, TIMES)
    linear, (slack, slack_slope) = first._strained(slopes), first._constraints(slopes)
    step, _ = first._step(0.5)
    errors = []
    for part in (0.2, 0.05):
        poses = motion(first.scene, first.x, first.unknowns + part * UNITS * step, TIMES)
        responses = [first.sensitivity.at(p, r) for p, r in zip(poses, first.responses, strict=True)]
        standing = first.standing(responses)
        promised = max(pose.worst(part * step)[0] for pose in linear)
        # the friction cones' rows come first, then the lowest nodes, in the models; their least, in the truth
        cones = len(standing.slack) - 1
        wanted = slack + part * slack_slope @ step
        off = np.append(wanted[:cones] - standing.slack[:cones], wanted[cones:].min() - standing.slack[-1])
        errors.append([abs(promised - float(standing.strain.max())), float(np.abs(off).max())])
    # a sixteenth, but for higher orders
    assert (np.array(errors[1]) < np.array(errors[0]) / 8).all()


def test_a_path_that_slips_and_hides_the_target_comes_to_hold_and_to_clear() -> None:
    first = program()
    before = first.standing(first.responses)
    assert before.violation > HOLDS
    solved = Program(HOMOGENEOUS, GRASP.x, first.unknowns, "coarse")
    solved.solve()
    after = solved.standing(solved.responses)
    assert after.violation < HOLDS
    assert solved.responses[-1].clearances.min() > 0


# --- The planner


@cache
def planned(workers: int = 1) -> Plan:
    return planners.plan(HOMOGENEOUS, KIND, "coarse", workers)


def test_it_begins_with_the_path_that_is_best_on_the_rod() -> None:
    u = np.array([-0.6, 2.0, 0.01, 0.02, 0.03, 0.8, 0.9, 1.0, 0.1, 0.09, 0.08, 0.07, 1.0, 0.0])
    x, own = begun(HOMOGENEOUS, u)
    theirs = program_of_the_rod.motion(HOMOGENEOUS, u[None], TIMES)[0]
    assert np.allclose(motion(HOMOGENEOUS, x, own, TIMES), theirs, rtol=0, atol=1e-15)


def test_it_spares_the_tissue_more_than_light_grip_and_eased_do() -> None:
    found = planned()
    certificate = found.certificate
    assert certificate.certified and found.path.kind == KIND
    assert certificate.required_friction <= ENOUGH * HOMOGENEOUS.limits.friction
    light = race(
        HOMOGENEOUS, [LightGrip(HOMOGENEOUS, LIGHT, ctc(HOMOGENEOUS, LIGHT))], "light_grip", "coarse", 1
    )
    assert certificate.max_strain < 0.9 * light.certificate.max_strain
    assert certificate.max_strain <= planners.plan(HOMOGENEOUS, "eased", "coarse", 1).certificate.max_strain


def test_its_certificate_is_the_certifiers() -> None:
    found = planned()
    assert found.certificate.to_json() == certify(HOMOGENEOUS, found.grasp, found.path, "coarse").to_json()


def test_an_optimisation_that_takes_too_much_work_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    first = program()
    monkeypatch.setattr(effort, "MOST_ITERATIONS", first.sensitivity.iterations // 2)
    with pytest.raises(TooCostly, match="iterations, allowed"):
        Program(HOMOGENEOUS, GRASP.x, first.unknowns, "coarse")


def test_workers_make_no_difference() -> None:
    assert planned(2).to_json() == planned().to_json()


def test_an_interrupt_in_an_update_comes_out_and_leaves_no_thread() -> None:
    before = set(threading.enumerate())

    def update(candidates: Sequence[Candidate]) -> None:
        if any(c.status == "squeezed" for c in candidates):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        planners.PLANNERS[KIND](HOMOGENEOUS, resolution="coarse", workers=2, on_update=update)
    assert set(threading.enumerate()) == before


def test_what_no_path_can_do_is_no_plan() -> None:
    """A flap that may hardly be strained cannot be bent away."""
    strict: Scene = a_scene(strain=0.02)
    with pytest.raises(NoPlan, match="strain"):
        planners.plan(strict, KIND, "coarse", 1)
