"""Squeezes on a cheaper mesh: a lower bound, and no trace of it in what is certified."""

from __future__ import annotations

from pathlib import Path

import pytest

from planners.certify import Trial, certify
from planners.generate_and_test import generate_and_test
from planners.paths import ctc
from planners.proposals import stable_grasps
from planners.scouted import DOUBT, Scouted
from retract_env.grasp import Grasp
from retract_env.mesh import MeshError
from retract_env.scene import load_scene

SCENES = Path(__file__).resolve().parents[2] / "configs" / "scenes"
TEN = load_scene(SCENES / "ten_veins.yaml")
GRASPS = stable_grasps(TEN)


@pytest.mark.parametrize("grasp", GRASPS[::2])
def test_the_cheaper_mesh_bounds_the_strain_of_a_squeeze_from_below(grasp: Grasp) -> None:
    scout, trial = (kind(TEN, grasp, ctc(TEN, grasp)) for kind in (Scouted, Trial))
    scout.squeeze()
    trial.squeeze()
    assert scout.physics is not None and trial.physics is not None
    assert len(scout.physics.section.points) < 0.5 * len(trial.physics.section.points)
    assert (1 - 3 * DOUBT) * trial.max_strain < scout.max_strain < trial.max_strain


def test_the_certificate_is_the_one_without_it() -> None:
    grasp = GRASPS[0]
    path = ctc(TEN, grasp)
    scout = Scouted(TEN, grasp, path, "medium")
    scout.squeeze()
    scout.move()
    assert scout.certificate().to_json() == certify(TEN, grasp, path, "medium").to_json()


def test_where_nothing_is_gained_it_is_the_squeeze_itself() -> None:
    homogeneous = load_scene(SCENES / "homogeneous.yaml")
    for scene, resolution in ((homogeneous, "medium"), (TEN, "coarse")):
        grasp = stable_grasps(scene)[0]
        scout, trial = (kind(scene, grasp, ctc(scene, grasp), resolution) for kind in (Scouted, Trial))
        scout.squeeze()
        trial.squeeze()
        assert scout.max_strain == trial.max_strain


def test_a_worse_bound_is_never_moved_and_a_mesh_that_fails_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    proposals = [(g, ctc(TEN, g)) for g in GRASPS[:3]]
    plan = generate_and_test(TEN, proposals, "ctc", "medium", workers=1)
    squeezed = []
    original = Trial.squeeze

    def squeeze(self: Trial) -> None:
        squeezed.append(self.grasp)
        if self.grasp == GRASPS[0]:
            raise MeshError("no mesh")
        original(self)

    monkeypatch.setattr(Trial, "squeeze", squeeze)
    other = generate_and_test(TEN, proposals, "ctc", "medium", workers=1)
    assert plan.candidates[0].reason == "ok" and other.candidates[0].reason == "unmeshable"
    assert other.grasp != GRASPS[0]
    for candidate in other.candidates:
        assert candidate.grasp in squeezed or candidate.max_strain > other.certificate.max_strain
