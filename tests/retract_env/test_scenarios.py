"""Scenes and plans with what is not known drawn from the prior."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planners.paths import ctc
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.rod import RodPhysics, flap_numbers, sight_numbers
from retract_env.rod.follow import CLEAR, DRAG, NORMAL, STRAIN
from retract_env.scenarios import Drawn, draws, scenario, values
from retract_env.scene import UNKNOWNS, Scene, Uncertainty, load_scene
from retract_env.spring.columns import veins_of

X, COMPRESSION = -0.03, 0.0008


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("ten_veins")


@pytest.fixture(scope="module")
def plan(scene: Scene) -> tuple[Grasp, JawPath]:
    grasp = Grasp(X, COMPRESSION)
    return grasp, ctc(scene, grasp, 8)


def test_draws_repeat_and_fill_their_ranges() -> None:
    z = draws(4000, 3)
    assert np.array_equal(z, draws(4000, 3))
    assert not np.array_equal(z, draws(4000, 4))
    assert np.array_equal(z[:10], draws(10, 3))  # more of them do not change the first ones
    assert z.min() >= -1
    assert z.max() <= 1
    # mean 0 and variance 1/3 of the uniform distribution, and no correlation, to four deviations
    assert np.abs(z.mean(axis=0)).max() < 4 * math.sqrt(1 / 3 / 4000)
    assert np.allclose(np.cov(z.T), np.eye(len(UNKNOWNS)) / 3, atol=4 / 3 / math.sqrt(4000))


def test_where_nothing_is_unknown_every_draw_is_the_plan_itself(
    scene: Scene, plan: tuple[Grasp, JawPath]
) -> None:
    known = scene.model_copy(update={"uncertainty": Uncertainty.none()})
    for z in draws(3, 0):
        there = scenario(known, *plan, z)
        assert there is not None
        assert there[0].hash == known.hash
        assert there[1].x == plan[0].x
        assert there[1].compression == pytest.approx(COMPRESSION, abs=1e-15)
        assert np.allclose(there[2].waypoints, plan[1].waypoints, rtol=0, atol=1e-15)


def test_each_unknown_changes_what_it_says(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    def at(name: str) -> tuple[Scene, Grasp, JawPath]:
        z = np.zeros(len(UNKNOWNS))
        z[UNKNOWNS.index(name)] = 1.0
        there = scenario(scene, *plan, z)
        assert there is not None
        return there

    tissue = scene.tissue
    assert at("modulus")[0].tissue.modulus == pytest.approx(1.3 * tissue.modulus)
    assert at("modulus")[0].tissue.veins[0].modulus == pytest.approx(1.3 * tissue.veins[0].modulus)
    assert at("vein_modulus")[0].tissue.veins[3].modulus == pytest.approx(1.2 * tissue.veins[3].modulus)
    assert at("vein_modulus")[0].tissue.modulus == tissue.modulus
    assert at("poisson")[0].tissue.poisson == pytest.approx(0.49)
    assert at("poisson")[0].tissue.veins[0].poisson == pytest.approx(0.49)
    assert at("weight")[0].tissue.density == pytest.approx(1.1 * tissue.density)
    assert at("friction")[0].limits.friction == pytest.approx(0.55)
    assert at("target")[0].line_of_sight.target[0] == pytest.approx(-0.0125 + 5e-4)
    thick, grasp, path = at("thickness")
    assert thick.tissue.height == pytest.approx(1.05 * tissue.height)
    assert thick.tissue.veins[0].outline[0] == pytest.approx((-0.04644, 1.05 * 0.00291))
    # jaws that are as far apart as planned squeeze a thicker flap more, about its own middle
    assert grasp.compression == pytest.approx(COMPRESSION + 0.05 * tissue.height)
    assert path.poses[1:, 3] == pytest.approx(plan[1].poses[1:, 3])
    assert path.poses[1, 1] == pytest.approx(thick.tissue.height / 2)
    _, grasp, path = at("grasp")
    assert grasp.x == pytest.approx(X + 5e-4)
    assert path.poses[:, 0] == pytest.approx(plan[1].poses[:, 0] + 5e-4)
    _, grasp, path = at("closing")
    assert grasp.compression == pytest.approx(COMPRESSION + 1e-4)
    assert path.poses[1:, 3] == pytest.approx(plan[1].poses[1:, 3] - 1e-4)


def test_of_a_grip_by_force_the_force_is_uncertain_and_has_a_floor(scene: Scene) -> None:
    z = np.zeros((1, len(UNKNOWNS)))
    z[0, UNKNOWNS.index("force")] = 1.0
    grasp = Grasp(X, force=0.02)
    there = scenario(scene, grasp, ctc(scene, Grasp(X, COMPRESSION), 8), z[0])
    assert there is not None
    assert there[1].force == pytest.approx(0.022)
    assert values(scene, z, 0.002).force == pytest.approx(1.5)  # the sensor's millinewton
    assert scenario(scene, Grasp(X, force=0.0005), ctc(scene, Grasp(X, COMPRESSION), 8), -z[0]) is None


def test_jaws_that_close_less_than_they_may_be_off_do_not_hold(scene: Scene) -> None:
    grasp = Grasp(X, 5e-5)
    z = np.zeros(len(UNKNOWNS))
    z[UNKNOWNS.index("closing")] = -1.0
    assert scenario(scene, grasp, ctc(scene, grasp, 8), z) is None


@pytest.mark.parametrize("by_force", [False, True])
def test_the_rods_arrays_are_those_of_the_drawn_scenes(
    scene: Scene, plan: tuple[Grasp, JawPath], by_force: bool
) -> None:
    z = draws(5, 11)
    grasp = Grasp(X, force=0.03) if by_force else plan[0]
    force = grasp.force
    flaps = Flaps(scene, z)
    followed = flaps.follow([X], plan[1].poses[1:][None], force=None if force is None else [force])
    for i in range(5):
        there = scenario(scene, grasp, plan[1], z[i])
        assert there is not None
        drawn, held, path = there
        assert flaps.flap[i] == pytest.approx(flap_numbers(drawn), rel=1e-12)
        assert flaps.sight[i] == pytest.approx(sight_numbers(drawn), rel=1e-12)
        assert flaps.friction[i] == pytest.approx(drawn.limits.friction)
        vertices, _, moduli = veins_of(drawn.tissue)
        assert flaps.veins[0] * [1, flaps.factors[i, 0]] == pytest.approx(vertices, rel=1e-12)
        assert flaps.veins[2] * flaps.factors[i, 1] == pytest.approx(moduli, rel=1e-12)
        physics = RodPhysics(drawn, held.x, force=held.force)
        physics.reset()
        for k, pose in enumerate(path.poses[1:]):
            if k == followed.reached[i]:
                break
            state, felt = physics.move_to(pose), followed.felt[i, k]
            assert felt[STRAIN] == pytest.approx(state.worst_strain, rel=1e-6)
            assert felt[CLEAR] == pytest.approx(state.clearance, abs=1e-9)
            needed = np.where(felt[NORMAL] > 0, np.abs(felt[DRAG]) / felt[NORMAL], np.inf)
            assert needed == pytest.approx(state.required_friction, rel=1e-4, abs=1e-7)


@pytest.mark.parametrize(
    "change",
    [
        {"limits": {"friction": 5.0}},
        {"jaws": {"width": 0.98 * 0.05 / 4}, "uncertainty": {"jaw_width": 0.1}},
        {"line_of_sight": {"camera": [-0.013, 0.05], "target": [-0.013, 0.0]}},
    ],
    ids=["most friction", "widest jaws", "a line of sight straight down"],
)
def test_draws_at_the_edge_of_what_a_scene_may_be_are_the_rods_too(
    scene: Scene, change: dict[str, Any]
) -> None:
    stated = Scene.from_data(scene.dump() | {k: scene.dump()[k] | v for k, v in change.items()})
    for end in (-1.0, 1.0):
        z = np.full(len(UNKNOWNS), end)
        flaps, drawn = Flaps(stated, z), Drawn(stated, z).scene
        assert flaps.flap[0] == pytest.approx(flap_numbers(drawn), rel=1e-12)
        assert flaps.sight[0] == pytest.approx(sight_numbers(drawn), rel=1e-12)
        assert flaps.friction[0] == drawn.limits.friction


def test_what_comes_of_one_retraction_depends_on_no_other(scene: Scene, plan: tuple[Grasp, JawPath]) -> None:
    z = draws(37, 5)
    poses = plan[1].poses[1:][None]
    together = Flaps(scene, z).follow([X], poses).felt
    for i in (0, 15, 16, 36):
        assert np.array_equal(Flaps(scene, z[i]).follow([X], poses).felt[0], together[i], equal_nan=True)
