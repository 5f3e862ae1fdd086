"""The planner on the rod: its motion, its derivatives, what it finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.base import NoPlan, Plan
from planners.correction import Correction
from planners.fem_gradient import planner as fem_gradient
from planners.swift import program
from planners.swift.planner import TOLERATED, Search, plan_swift
from planners.whatif import Flaps
from retract_env.scenarios import draws, values
from retract_env.scene import Limits, LineOfSight, Scene, Uncertainty, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("ten_veins")


@pytest.fixture(scope="module")
def search(scene: Scene) -> Search:
    return Search(scene)


@pytest.fixture(scope="module")
def unknowns(search: Search) -> np.ndarray:
    return search.starts()[1]


def planned(scene: Scene, grip: str = "position") -> Plan:
    return plan_swift(scene, resolution="coarse", workers=None, on_update=None, grip=grip)


@pytest.fixture(scope="module")
def by_position(scene: Scene) -> Plan:
    return planned(scene)


def test_the_motion_is_that_of_fem_gradient_up_to_its_end(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        u = rng.uniform(program.LOW, program.HIGH)
        times = np.linspace(0, 1, 7)
        other = fem_gradient.motion(scene, u[program.PLACE] * scene.tissue.length, u[1:12], times)
        assert np.allclose(program.motion(scene, u, times), other, rtol=1e-12, atol=1e-15)


def test_a_path_begins_squeezed_in_place(scene: Scene, unknowns: np.ndarray) -> None:
    grasp, path = program.jaw_path(scene, unknowns, "swift", by_force=False)
    height = scene.tissue.height
    assert path.poses[0] == pytest.approx([grasp.x, height / 2, 0, height])
    assert path.poses[1] == pytest.approx([grasp.x, height / 2, 0, height - grasp.compression])


@pytest.mark.parametrize("by_force", [False, True])
def test_a_small_step_gains_what_the_linear_program_promises(
    scene: Scene, unknowns: np.ndarray, by_force: bool
) -> None:
    """Derivatives by differences: halving the step quarters the error of the promise."""
    one = program.Program(
        scene, Flaps(scene), 0.03, 2e-3, Correction.none(len(program.TIMES)), by_force=by_force
    )
    u = np.clip(unknowns, one.low, one.high)
    around = one._around(u)
    now = one.merit(u, around[0])
    errors = []
    for radius in (0.02, 0.01):
        step, promised = one._step(u, around, radius)
        found = one.merit(u + program.UNITS * step, one.standing((u + program.UNITS * step)[None])[0])
        assert promised < now
        errors.append(abs(found - promised))
        assert abs(found - promised) < 0.1 * (now - promised)
    assert errors[1] < 0.5 * errors[0]


def test_what_loses_the_flap_is_worse_than_anything(scene: Scene, unknowns: np.ndarray) -> None:
    one = program.Program(scene, Flaps(scene), 0.03, 2e-3, Correction.none(len(program.TIMES)))
    sound = one.standing(unknowns[None])[0]
    strain = np.where(np.arange(len(program.TIMES)) < 5, sound.strain, np.nan)
    lost = replace(sound, strain=strain, sound=np.array([False]))
    assert one.merit(unknowns, sound) < one.merit(unknowns, lost) == np.inf


def test_grips_by_force_are_planned_on_the_prior_that_they_are_judged_on(scene: Scene) -> None:
    """The less the force, the larger the part of it that is not known."""
    z, force = draws(20, 5), [0.002, 0.006, 0.05]
    pressed = Flaps(scene, z).pressing(force)
    for told, found in zip(force, pressed.T, strict=True):
        assert np.array_equal(found, values(scene, z, told).force * told)
    assert np.ptp(pressed[:, 0] / 0.002) > 2 * np.ptp(pressed[:, 1] / 0.006)


def test_a_plan_holds_on_the_whole_sample(search: Search) -> None:
    found = search.whole(search.ranked()[0])
    assert found.violation <= TOLERATED
    assert 0.05 < found.strain < 0.2


def test_the_plan_is_certified_and_spares_the_tissue(by_position: Plan) -> None:
    certificate = by_position.certificate
    assert certificate.certified
    # the paper's grip strains by .25 there, the least with exact knowledge is .08
    assert certificate.max_strain < 0.125
    assert certificate.required_friction < 0.3  # it is prepared for worse


def test_a_grip_by_force_needs_less_to_be_safe(scene: Scene, by_position: Plan) -> None:
    plan = planned(scene, "force")
    assert plan.grasp.force is not None
    assert plan.certificate.certified
    assert plan.certificate.max_strain < 0.9 * by_position.certificate.max_strain


def test_with_all_known_the_tissue_is_spared_more(scene: Scene, by_position: Plan) -> None:
    plan = planned(scene.model_copy(update={"uncertainty": Uncertainty.none()}))
    assert plan.certificate.certified
    assert plan.certificate.max_strain < 0.9 * by_position.certificate.max_strain


def test_it_repeats_to_the_last_bit(scene: Scene, by_position: Plan) -> None:
    again = planned(scene)
    assert again.grasp == by_position.grasp
    assert again.path == by_position.path
    assert again.certificate.to_json() == by_position.certificate.to_json()


def test_what_cannot_be_done_is_no_plan(scene: Scene) -> None:
    strict = scene.model_copy(update={"limits": Limits(strain=0.01, friction=0.02)})
    with pytest.raises(NoPlan):
        planned(strict)


def test_a_flap_without_bed_or_veins_and_a_steep_line_are_planned() -> None:
    scene = load_scene("homogeneous")
    other = scene.model_copy(update={"line_of_sight": LineOfSight.at(-0.02, 1.3), "bed": False})
    assert planned(other).certificate.certified
