"""Peaks between increments: bounds of what may hide, and certificates that more increments do not change."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from planners.certify import Certificate, Trial, certify
from planners.certify.peaks import NARROWEST, bounds, doubtful
from planners.certify.retraction import FRICTION_TOLERANCE, STRAIN_TOLERANCE
from planners.eased import eased
from planners.paths import circular, ctc
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene, load_scene, sample_scene
from retract_env.spring import SpringModel
from tests.planners.retractions import a_grasp, a_scene, judged

KEPT = json.loads(Path(__file__).with_name("peak_between_increments.json").read_text("utf-8"))
PEAK = Grasp(**KEPT["grasp"]), JawPath.from_json(KEPT["path"])


# --- The bound


def test_straight_and_convex_values_hide_nothing() -> None:
    at = np.array([1.0, 2.0, 2.5, 4.0])
    for values in (0.3 * at - 1, at**2):
        np.testing.assert_allclose(bounds(at, values), np.maximum(values[:-1], values[1:]), rtol=1e-12)


@pytest.mark.parametrize("top", np.linspace(2.0, 4.0, 9))
def test_a_parabola_stays_below_the_bound(top: float) -> None:
    at = np.arange(7.0)
    between = np.linspace(0, 6, 601)
    highest = [-((x - top) ** 2) for x in between]
    reached = [max(h for x, h in zip(between, highest, strict=True) if a <= x <= a + 1) for a in range(6)]
    assert (bounds(at, -((at - top) ** 2)) >= np.array(reached) - 1e-12).all()


@pytest.mark.parametrize("kink", np.linspace(2.02, 2.98, 13))
def test_a_kink_stays_below_the_bound(kink: float) -> None:
    """Wherever in its interval it is, the values beside it show enough of it."""
    at = np.arange(6.0)
    values = np.where(at < kink, 0.5 * (at - kink), 0.1 * (kink - at))
    assert bounds(at, values)[2] >= 0.0


def test_what_may_hide_is_looked_for_where_it_may_be_greatest_and_not_for_ever() -> None:
    at = np.array([1.0, 2.0, 3.0, 4.0])
    values = np.array([0.02, 0.39, 0.42, 0.32])
    assert doubtful(at, values, 0.425) == 1
    assert doubtful(at, values, 1.0) is None
    assert doubtful(at * NARROWEST, values, 0.425) is None
    assert doubtful(at[:1], values[:1], 0.0) is None


# --- Certificates


def test_a_peak_of_friction_within_an_increment_is_found() -> None:
    """Friction peaks at 2.3 waypoints, as the flap leaves its bed, for a fifth of an increment."""
    certificate = certify(load_scene("ten_veins"), *PEAK, "fine")
    assert certificate.reason == "slip"
    assert certificate.peaks is not None
    assert 2.2 < certificate.peaks["friction"]["progress"] < 2.4
    assert certificate.peaks["friction"]["jaw"] == "upper"
    at_waypoints = [
        max(friction)
        for friction, at in zip(certificate.history["friction"], certificate.history["progress"], strict=True)
        if at == round(at)
    ]
    assert max(at_waypoints) < 0.45 < 0.5 < certificate.required_friction


@cache
def divided(scene: Scene, grasp: Grasp, path: JawPath, division: int) -> Certificate:
    trial = Trial(scene, grasp, path, "coarse", division)
    trial.squeeze()
    trial.move()
    return trial.certificate()


def random_flap(seed: int, kind: str) -> tuple[Scene, Grasp, JawPath]:
    scene = sample_scene(np.random.default_rng(seed))
    best = SpringModel(scene.tissue).stable_grasps(scene.limits.strain, scene.jaws.width)[0]
    light = Grasp(best.x, 0.4 * best.compression)
    match kind:
        case "ctc":
            return scene, best, ctc(scene, best)
        case "circular":
            return scene, light, circular(scene, light)
        case _:
            return scene, light, eased(scene, light)


@pytest.mark.parametrize("kind", ["ctc", "circular", "eased", "peak"])
@pytest.mark.parametrize("seed", range(3))
def test_eight_times_as_many_increments_change_no_verdict(seed: int, kind: str) -> None:
    if kind == "peak":
        friction = (0.48, 0.485, 0.5)[seed]  # the peak on this mesh is at .482
        scene = load_scene("ten_veins")
        limits = scene.limits.model_copy(update={"friction": friction})
        scene, grasp, path = scene.model_copy(update={"limits": limits}), *PEAK
    else:
        scene, grasp, path = random_flap(seed, kind)
    once, finely = (divided(scene, grasp, path, k) for k in (1, 8))
    assert once.reason == finely.reason
    if once.certified:
        assert finely.required_friction <= once.required_friction + FRICTION_TOLERANCE
        assert finely.max_strain <= once.max_strain * (1 + STRAIN_TOLERANCE)


def test_frames_stand_in_their_order_and_the_greatest_is_where_the_certificate_says() -> None:
    certificate = judged(load_scene("ten_veins"), *PEAK)
    at, peaks = certificate.history["progress"], certificate.peaks
    assert peaks is not None
    assert at == sorted(at)
    assert len(set(at)) == len(at)
    assert certificate.increments == len(at) - 1 > len(PEAK[1]) - 2
    assert certificate.history["strain"][at.index(peaks["strain"]["progress"])] == certificate.max_strain
    friction = certificate.history["friction"][at.index(peaks["friction"]["progress"])]
    assert max(friction) == certificate.required_friction
    assert (peaks["strain_tolerance"], peaks["friction_tolerance"]) == (STRAIN_TOLERANCE, FRICTION_TOLERANCE)


def test_a_smooth_retraction_costs_few_looks() -> None:
    certificate = judged(a_scene(), a_grasp(), ctc(a_scene(), a_grasp()))
    whole = [at for at in certificate.history["progress"] if at >= 1 and at == round(at)]
    # the moment of visibility takes a few solutions too
    assert certificate.increments - 4 <= len(whole) + 8
