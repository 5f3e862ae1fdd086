"""The robust statement: bounds of probabilities, margins, derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from planners.certify import Certificate, Robust, certify, robust, stated
from planners.correction import Correction
from planners.paths import ctc
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.rod import RodPhysics
from retract_env.scenarios import draws, scenario
from retract_env.scene import UNKNOWNS, Scene, Uncertainty, load_scene

FEW = Robust(samples=60, seed=4)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("homogeneous")


@pytest.fixture(scope="module")
def firm(scene: Scene) -> tuple[Grasp, JawPath]:
    """Eq. 5's grip, which survives everything."""
    grasp = Grasp(-0.035, 0.25 * scene.tissue.height)
    return grasp, ctc(scene, grasp)


@pytest.fixture(scope="module")
def certificate(scene: Scene, firm: tuple[Grasp, JawPath]) -> Certificate:
    return certify(scene, *firm, resolution="coarse", robust=FEW)


def test_688_samples_without_a_failure_say_one_per_cent() -> None:
    assert robust.upper_bound(0, 688, 1e-3) <= 0.01 < robust.upper_bound(0, 686, 1e-3)


@pytest.mark.parametrize(("failures", "samples", "beta"), [(1, 50, 0.05), (7, 300, 1e-3), (150, 300, 0.01)])
def test_the_bound_is_clopper_and_pearsons(failures: int, samples: int, beta: float) -> None:
    """With that probability, so few failures have a probability of beta."""
    bound = robust.upper_bound(failures, samples, beta)
    assert binom.cdf(failures, samples, bound) == pytest.approx(beta, rel=1e-9)
    assert robust.upper_bound(samples, samples, beta) == 1.0


def test_margins_are_exceeded_the_more_seldom_the_larger_they_are() -> None:
    often = robust.exceeded(robust.LEVELS)
    assert (np.diff(often) <= 0).all()
    assert 0 < often[-1] < robust.RARE < often[0] <= 1


def test_a_firm_grip_survives(certificate: Certificate) -> None:
    said = certificate.robust
    assert said is not None
    assert certificate.certified
    assert said["failures"] == {}
    assert said["samples"] == 60
    assert sum(said["judged"].values()) == 60
    # sixty draws cannot say as much as was asked
    assert said["bound"] == pytest.approx(said["sampled"] + said["missed"])
    assert said["sampled"] == pytest.approx(1 - 1e-3 ** (1 / 60))
    assert said["holds"] is False


def test_it_repeats_to_the_last_bit_and_survives_its_file(
    scene: Scene, firm: tuple[Grasp, JawPath], certificate: Certificate
) -> None:
    again = stated(certificate, scene, *firm, FEW)
    assert again.to_json() == certificate.to_json()
    assert Certificate.from_json(certificate.to_json()).to_json() == certificate.to_json()


def test_certificates_without_a_statement_have_none(scene: Scene, certificate: Certificate) -> None:
    data = Certificate(**{**certificate.__dict__, "robust": None}).to_json()
    assert "robust" not in data
    assert Certificate.from_json(data).robust is None


def test_a_light_grip_fails_and_the_worst_cases_can_be_opened(scene: Scene) -> None:
    grasp = Grasp(-0.035, 0.03 * scene.tissue.height)
    path = ctc(scene, grasp)
    said = certify(scene, grasp, path, resolution="coarse", robust=Robust(samples=20, seed=1)).robust
    assert said is not None
    assert sum(said["failures"].values()) >= 10
    assert set(said["failures"]) <= {"slip", "release", "diverged", "not_visible", "undecided"}
    assert said["bound"] > 0.5
    there = scenario(scene, grasp, path, robust.drawn(said["worst"][0]))
    assert there is None or certify(*there, resolution="coarse").reason != "ok"


def test_what_holds_by_a_margin_holds_by_every_smaller_one(
    scene: Scene, firm: tuple[Grasp, JawPath], certificate: Certificate
) -> None:
    corrected = robust.corrected_by(scene, *firm, certificate.history)
    assert corrected is not None
    f = robust.followed(scene, *firm, Flaps(scene, draws(40, 0)), corrected)
    shown, strain, friction, _ = f.at(1.0)
    shown_, strain_, friction_, _ = f.at(2.0)
    assert (shown_ >= shown).all()
    assert (strain_ > strain).all()
    assert (friction_ > friction).all()


def test_a_light_force_that_may_be_none_lets_go(scene: Scene) -> None:
    """On just those draws of which there is no plan, as the jaws do not press."""
    grasp = Grasp(-0.035, force=5e-4)
    path, z = ctc(scene, Grasp(-0.035, 2e-4)), draws(60, 3)
    f = robust.followed(scene, grasp, path, Flaps(scene, z), Correction.none(path.last))
    none = np.array([scenario(scene, grasp, path, one) is None for one in z])
    assert 5 < none.sum() < 55
    assert np.array_equal(f.closed, ~none)
    level, reason = robust.levels(f)
    assert (level[none] == -2).all()
    assert (reason[none] == "release").all()


def test_a_draw_that_is_lost_is_told_as_such_unless_a_limit_was_broken_before(scene: Scene) -> None:
    lost = np.nan
    strain = np.array([[0.1, lost], [0.1, lost], [0.9, lost], [0.1, 0.1]])
    friction = np.array([[0.1, np.inf], [0.9, np.inf], [0.1, np.inf], [0.1, np.inf]])
    clearance = np.where(np.isnan(strain), lost, -1e-3)
    flags, limit = np.zeros((4, 2), bool), np.full(4, 0.5)
    f = robust.Followed(strain, friction, limit, clearance, flags, np.ones(4, bool), scene)
    assert f.at(0.0)[3].tolist() == ["diverged", "slip", "strain", "release"]


def test_a_score_is_the_least_margin_that_covers(
    scene: Scene, firm: tuple[Grasp, JawPath], certificate: Certificate
) -> None:
    corrected = robust.corrected_by(scene, *firm, certificate.history)
    assert corrected is not None
    f = robust.followed(scene, *firm, Flaps(scene, draws(20, 0)), corrected)
    _, strain, friction, _ = f.at(3.0)
    found = robust.scores(f, [30.0] * 20, strain, friction)
    least = robust.LEVELS[np.searchsorted(robust.LEVELS, 3.0)]
    assert (found <= least).all()
    assert (found[strain < 0.5] > 2.0).any()
    # beyond a limit it does not matter how far
    assert np.isfinite(robust.scores(f, [30.0] * 20, strain, np.full(20, 9.0))).all()
    assert np.isinf(robust.scores(f, [math.inf] * 20, strain, friction)).all()


def test_derivatives_are_those_of_differences_on_single_rods(
    scene: Scene, firm: tuple[Grasp, JawPath], certificate: Certificate
) -> None:
    """Each unknown a little more and a little less, by itself and through the scene that it makes."""
    said = certificate.robust
    assert said is not None
    sensitivities = said["sensitivities"]
    probed = robust.probe(scene)
    corrected = robust.corrected_by(scene, *firm, certificate.history)
    assert corrected is not None
    end = int(np.ceil(certificate.path["end"]))
    for name in ("modulus", "thickness", "closing", "grasp", "weight", "poisson", "target"):
        ends = []
        for sign in (1, -1):
            z = np.zeros(len(UNKNOWNS))
            z[UNKNOWNS.index(name)] = sign * 0.05
            if name != "poisson":  # whose range the scene is in the middle of
                assert probed.uncertainty.poisson is not None
                low, high = probed.uncertainty.poisson
                z[UNKNOWNS.index("poisson")] = (scene.tissue.poisson - (low + high) / 2) / ((high - low) / 2)
            there = scenario(probed, *firm, z)
            assert there is not None
            drawn, held, path = there
            physics = RodPhysics(drawn, held.x)
            physics.reset()
            states = [physics.move_to(pose) for pose in path.poses[1 : end + 1]]
            ends.append(max(s.worst_strain for s in states))
        half = robust._half_range(probed.uncertainty, name)
        slope = (ends[0] - ends[1]) / (0.1 * half)
        # the largest factor of the correction is in one and not in the other
        assert sensitivities[name]["strain"] == pytest.approx(slope, rel=0.1, abs=2e-3 * 0.28 / half)


def test_where_nothing_is_unknown_a_plan_that_is_certified_holds(
    scene: Scene, firm: tuple[Grasp, JawPath]
) -> None:
    known = scene.model_copy(update={"uncertainty": Uncertainty.none()})
    said = certify(known, *firm, resolution="coarse", robust=Robust(eps=0.2, samples=60)).robust
    assert said is not None
    assert said["failures"] == {}
    assert said["holds"] is True
    assert all(s["half_range"] == 0 for s in said["sensitivities"].values())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"eps": 0.0}, "robust.eps = 0, allowed (0, 1)"),
        ({"beta": 1.0}, "robust.beta = 1, allowed (0, 1)"),
        ({"samples": 5}, "robust.samples = 5, allowed 10 to 1000000"),
    ],
)
def test_what_cannot_be_asked_is_refused(arguments: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match="allowed") as refused:
        Robust(**arguments)  # type: ignore[arg-type]
    assert str(refused.value) == said
