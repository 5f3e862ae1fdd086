"""The certificate as a document: names, hash, round trip, a finer mesh's word, and what is refused."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import retract_env
from baselines.verification.flaps import HEIGHT, LENGTH
from planners.certify import REASONS, Certificate, Trial, certify, differences
from planners.certify.trial import VERIFIED_IN
from planners.paths import ctc
from retract_env.errors import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.physics.fem import FemPhysics
from tests.planners.retractions import a_grasp, a_scene, judged, poses, retraction, veined

STABLE_NAMES = {
    *("certified", "reason", "max_strain", "strain_limit", "required_friction", "friction_limit"),
    *("clearance", "increments", "mesh", "scene_hash", "version"),
}


def released() -> Certificate:
    """The upper jaw lets go, and would need friction without bound."""
    return judged(a_scene(strain=0.9), a_grasp(), poses(a_grasp(), (-0.025, HEIGHT / 2, 0.0, 2 * HEIGHT)))


def unmeasured() -> Certificate:
    """Nothing could be simulated, not even the flap at rest."""
    return retraction(a_scene(modulus=100.0, gravity=100.0, bed=False))


CERTIFICATES: dict[str, Callable[[], Certificate]] = {
    "homogeneous": lambda: retraction(a_scene()),
    "veined": lambda: retraction(veined()),
    "released": released,
    "unmeasured": unmeasured,
}
every_certificate = pytest.mark.parametrize("made", CERTIFICATES.values(), ids=CERTIFICATES)


def sealed(data: dict[str, Any]) -> str:
    """SHA-256 of the canonical JSON of all but the hash."""
    content = {key: value for key, value in data.items() if key != "hash"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@every_certificate
def test_the_file_has_the_stable_names_and_strict_json(made: Callable[[], Certificate]) -> None:
    data = made().to_json()
    assert set(data) >= STABLE_NAMES
    assert {"nodes", "elements"} <= set(data["mesh"])
    assert set(data["grasp"]) == {"x", "compression"}
    assert data["reason"] in REASONS
    assert data["certified"] is (data["reason"] == "ok")
    assert data["version"] == retract_env.__version__
    assert type(data["increments"]) is type(data["mesh"]["nodes"]) is type(data["mesh"]["elements"]) is int
    text = json.dumps(data, allow_nan=False)  # strict: plain types, no infinity
    assert json.loads(text) == data
    assert {"seconds", "time", "date"}.isdisjoint(data)


@every_certificate
def test_a_certificate_is_read_back_as_it_was(made: Callable[[], Certificate]) -> None:
    certificate = made()
    data = certificate.to_json()
    again = Certificate.from_json(json.loads(json.dumps(data)))
    assert again == certificate  # all but the frames
    assert again.to_json() == data
    assert data["hash"] == sealed(data)


def test_a_pulling_jaw_needs_friction_without_bound() -> None:
    certificate = released()
    assert certificate.reason == "release"
    assert certificate.required_friction == math.inf
    data = certificate.to_json()
    assert data["required_friction"] == "inf"
    assert Certificate.from_json(data).history["friction"][-1] == certificate.history["friction"][-1]


def test_what_was_simulated_is_named() -> None:
    scene, grasp = veined(strain=0.45, friction=1.5), Grasp(-0.025, 0.2 * HEIGHT)
    certificate = retraction(scene, grasp)
    assert certificate.scene_hash == scene.hash
    assert (certificate.strain_limit, certificate.friction_limit) == (0.45, 1.5)
    assert certificate.grasp == {"x": grasp.x, "compression": grasp.compression}
    assert certificate.path["kind"] == "ctc"
    assert certificate.mesh["resolution"] == "coarse"
    assert certificate.section is not None
    # one quadratic layer of wedges over the half depth: two levels of nodes
    assert certificate.mesh["elements"] == len(certificate.section.triangles)
    assert certificate.mesh["nodes"] == 2 * len(certificate.section.points)


def tamper(data: dict[str, Any], way: str) -> None:
    match way:
        case "value":
            data["max_strain"] = math.nextafter(data["max_strain"], 0)
        case "verdict":
            data["certified"] = not data["certified"]
        case "history":
            data["history"]["strain"][3] /= 2
        case "order":
            data["history"]["jaws"].reverse()
        case "scene":
            data["scene_hash"] = "0" * 64
        case "added":
            data["approved_by"] = "nobody"
        case "removed":
            del data["version"]
        case "hash":
            data["hash"] = data["hash"][::-1]
        case "not a number":
            data["clearance"] = math.nan


@pytest.mark.parametrize(
    "way",
    ["value", "verdict", "history", "order", "scene", "added", "removed", "hash", "not a number"],
)
def test_a_changed_certificate_is_refused(way: str) -> None:
    data = json.loads(json.dumps(retraction(a_scene()).to_json()))
    Certificate.from_json(data)
    tamper(data, way)
    one_line(lambda: Certificate.from_json(data))


@pytest.mark.parametrize("data", [None, 3, [], "certificate", {}])
def test_what_is_no_certificate_is_refused(data: Any) -> None:
    assert one_line(lambda: Certificate.from_json(data)).startswith("certificate: ")


def one_line(call: Callable[[], object]) -> str:
    with pytest.raises(ValueError) as caught:
        call()
    message = str(caught.value)
    assert message and len(message.splitlines()) == 1
    return message


# --- The word of a finer mesh


def test_verification_reports_the_differences_to_the_finer_mesh() -> None:
    scene, grasp, path = a_scene(), a_grasp(), ctc(a_scene(), a_grasp())
    certificate = certify(scene, grasp, path, "coarse", verify=True)
    trial = Trial(scene, grasp, path, "medium", VERIFIED_IN)
    trial.squeeze()
    trial.move()
    plain, finer = retraction(scene), trial.certificate()
    word = certificate.verification
    assert word is not None
    assert word["resolution"] == "medium"
    assert (word["nodes"], word["reason"]) == (finer.mesh["nodes"], finer.reason)
    assert word["increments"] == finer.increments > 2 * plain.increments
    assert word["max_strain"] == finer.max_strain
    assert word["max_strain_difference"] == pytest.approx(plain.max_strain / finer.max_strain - 1, rel=1e-12)
    assert word["required_friction_difference"] == plain.required_friction - finer.required_friction
    assert word["end_difference"] == plain.path["end"] - finer.path["end"]
    assert 0 < abs(word["max_strain_difference"]) < 0.06  # the coarse mesh's stated error
    # the rest is the same certificate; the verification is under its seal
    assert replace(certificate, verification=None) == plain
    data = certificate.to_json()
    assert data["hash"] == sealed(data) != plain.to_json()["hash"]
    assert Certificate.from_json(json.loads(json.dumps(data))) == certificate


@pytest.mark.parametrize("stage", ["rest", "release"])
def test_a_finer_mesh_that_fails_is_reported_too(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    """Differences that have no value are written as such, in strict JSON."""
    if stage == "rest":
        reset = FemPhysics.reset

        def unsettled(self: FemPhysics) -> Any:
            if self.resolution.name == "medium":
                raise Diverged("staged")
            return reset(self)

        monkeypatch.setattr(FemPhysics, "reset", unsettled)
        path, scene = ctc(a_scene(), a_grasp()), a_scene()
    else:
        path, scene = poses(a_grasp(), (-0.025, HEIGHT / 2, 0.0, 2 * HEIGHT)), a_scene(strain=0.9)
    certificate = certify(scene, a_grasp(), path, "coarse", verify=True)
    word = certificate.verification
    assert word is not None
    assert word["reason"] == {"rest": "diverged", "release": "release"}[stage]
    data = json.loads(json.dumps(certificate.to_json(), allow_nan=False))
    assert Certificate.from_json(data).to_json() == data


# --- What is refused


def test_a_grasp_off_the_flap_is_refused() -> None:
    scene = a_scene()
    for x in (-LENGTH - 1e-3, -0.0004, -1e-9):
        grasp = Grasp(x, 1e-3)
        message = one_line(partial(certify, scene, grasp, poses(grasp), "coarse"))
        assert message.startswith(f"grasp.x = {x:g} m, allowed [-0.05, ")
    thick = Grasp(-0.025, HEIGHT)
    path = ctc(scene, a_grasp())
    assert one_line(lambda: certify(scene, thick, path)).startswith("grasp.compression = 0.0044 m, allowed")


def test_a_path_that_does_not_begin_on_the_grasp_is_refused() -> None:
    scene, grasp = a_scene(), a_grasp()
    rows = ctc(scene, grasp).waypoints
    other = ctc(scene, a_grasp(-0.026))
    assert "path.waypoints[0]" in one_line(lambda: certify(scene, grasp, other, "coarse"))
    flat = JawPath(np.delete(rows, 0, axis=0), "ctc")
    assert "path.waypoints[0]" in one_line(lambda: certify(scene, grasp, flat, "coarse"))
    # a motion that hides in the squeeze, which is not judged
    hasty = JawPath(np.delete(rows, 1, axis=0), "ctc")
    assert "path.waypoints[1]" in one_line(lambda: certify(scene, grasp, hasty, "coarse"))
    lighter = Grasp(grasp.x, grasp.compression / 2)
    assert "path.waypoints[1]" in one_line(lambda: certify(scene, lighter, JawPath(rows, "ctc"), "coarse"))


@pytest.mark.parametrize("far", [11.0, 1e9, 1e300])
def test_a_path_out_of_the_world_is_refused_at_once(far: float) -> None:
    path = poses(a_grasp(), (-0.025, far, 0.0, far))
    assert "allowed 10 m" in one_line(lambda: certify(a_scene(), a_grasp(), path, "coarse"))


def test_unknown_resolutions_are_refused() -> None:
    path = ctc(a_scene(), a_grasp())
    message = one_line(lambda: certify(a_scene(), a_grasp(), path, "superb"))
    assert message == "resolution = 'superb', allowed coarse, medium, fine, finer"
    message = one_line(lambda: certify(a_scene(), a_grasp(), path, "finer", verify=True))
    assert message == "resolution = 'finer' has no finer one to verify with, allowed coarse, medium, fine"


# --- Computed again


def test_the_same_retraction_shows_no_differences() -> None:
    scene, grasp = a_scene(), a_grasp()
    again = certify(scene, grasp, ctc(scene, grasp), "coarse")
    said = Certificate.from_json(json.loads(json.dumps(again.to_json())))
    assert differences(said, retraction(scene)) == []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"max_strain": 0.1}, "max_strain = 0.1, recomputed 0.28"),
        ({"reason": "slip", "certified": False}, "certified = False, recomputed True"),
        ({"grasp": {"x": -0.02, "compression": 0.0011}}, "grasp.x = -0.02, recomputed -0.025"),
        ({"scene_hash": "0" * 64}, "scene_hash = '00000"),
        ({"friction_limit": math.inf}, "friction_limit = 'inf', recomputed 5"),
    ],
)
def test_a_certificate_that_was_changed_and_sealed_again_is_found(change: dict[str, Any], named: str) -> None:
    """Whoever changes the content can make a new hash; computing it again is what tells."""
    true = retraction(a_scene())
    found = differences(replace(true, **change), true)
    assert any(line.startswith(named) for line in found)


def test_a_difference_in_the_history_names_its_place() -> None:
    true = retraction(a_scene())
    strain = list(true.history["strain"])
    strain[3] += 1e-3
    found = differences(replace(true, history={**true.history, "strain": strain}), true)
    assert len(found) == 1
    assert found[0].startswith("history.strain[3] = ")


def test_certificates_from_before_peaks_were_looked_for_are_read() -> None:
    old = replace(retraction(a_scene()), peaks=None).to_json()
    assert not {"peaks", "clearance_limit"} & set(old)
    assert Certificate.from_json(json.loads(json.dumps(old))).to_json() == old
