"""What a search leaves out: grips that are closed once for all paths, and what the rod knows to fail."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import pytest

from planners import search
from planners.base import DISMISSED, Candidate, NoPlan
from planners.certify import Retraction, Trial, certify
from planners.foresight import Foreseen, foresee
from planners.proposals import along
from planners.search import generate_and_test
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import Resolution, SectionMesh, outlines, section_mesh
from retract_env.scene import Scene
from tests.planners.retractions import a_grasp, a_scene

KINDS = ("ctc", "circular", "linear75")
Proposals = Sequence[tuple[Grasp, JawPath]]

# --- Grips that several paths begin with


@pytest.mark.parametrize(
    "grasp", [a_grasp(-0.035, 0.2), Grasp(-0.035, force=0.06)], ids=["position", "force"]
)
def test_what_goes_on_from_closed_jaws_ends_in_the_same_bits(grasp: Grasp) -> None:
    scene = a_scene(friction=0.5)
    one, other = (path for _, path in along(scene, [grasp], ["ctc", "circular"]))
    first = Trial(scene, grasp, one, "coarse")
    first.squeeze()
    closed, strain, friction = first.closed(), first.max_strain, first.required_friction
    first.move()  # what was kept is not touched by that
    second = Trial(scene, grasp, other, "coarse")
    second.close_as(closed)
    assert (second.max_strain, second.required_friction, second.physics) == (strain, friction, None)
    second.go_on(closed)
    second.move()
    assert second.certificate().to_json() == certify(scene, grasp, other, "coarse").to_json()


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("pruning", ["none", "squeeze", "rod"])
def test_paths_with_one_grip_close_the_jaws_once(
    pruning: str, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = a_scene(friction=0.5)
    grasps = [a_grasp(-0.035, 0.2), a_grasp(-0.03, 0.2)]
    trials = along(scene, grasps, KINDS)
    each = [certify(scene, grasp, path, "coarse") for grasp, path in trials]
    squeezed: list[Grasp] = []
    squeeze = Retraction.squeeze

    def counted(self: Retraction, *args: Any) -> None:
        squeezed.append(self.grasp)
        squeeze(self, *args)

    monkeypatch.setattr(Retraction, "squeeze", counted)
    plan = generate_and_test(scene, trials, "test", "coarse", workers, pruning=pruning)
    if workers == 1:
        assert sorted(g.x for g in squeezed) == sorted(g.x for g in grasps)
    best = min((c for c in each if c.certified), key=lambda c: c.max_strain)
    assert plan.certificate.to_json() == best.to_json()
    for candidate, certificate in zip(plan.candidates, each, strict=True):
        if candidate.reason not in ("pruned", DISMISSED):
            assert candidate.reason == certificate.reason
            assert candidate.max_strain == certificate.max_strain
            assert candidate.increments == certificate.increments


# --- Where nothing holds


def loose(scene: Scene) -> Proposals:
    """Grips that slip for sure."""
    return along(
        scene, [a_grasp(x, part) for x, part in ((-0.03, 0.03), (-0.035, 0.05), (-0.025, 0.03))], ["ctc"]
    )


def reasons(scene: Scene, trials: Proposals, pruning: str = "rod") -> list[str | None]:
    with pytest.raises(NoPlan) as none:
        generate_and_test(scene, trials, "test", "coarse", 1, pruning=pruning)
    return [candidate.reason for candidate in none.value.candidates]


def test_where_nothing_can_hold_one_failure_confirms_the_rod() -> None:
    scene = a_scene(friction=0.5)
    trials = loose(scene)
    found = foresee(scene, trials)
    assert all(f.hopeless for f in found)
    least = min(range(3), key=lambda i: found[i].excess)
    assert reasons(scene, trials) == ["slip" if i == least else DISMISSED for i in range(3)]
    assert reasons(scene, trials, "none") == ["slip"] * 3


def test_what_says_nothing_of_the_motion_does_not_confirm_the_rod(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = a_scene(friction=0.5)
    trials = loose(scene)
    found = foresee(scene, trials)
    first, second, last = sorted(range(3), key=lambda i: found[i].excess)
    mesh, unlucky = section_mesh, trials[first][0].x

    def failing(scene: Scene, jaw_x: float, resolution: Resolution, smeared: Collection[int]) -> SectionMesh:
        if jaw_x == unlucky:
            raise MeshError("no mesh")
        return mesh(scene, jaw_x, resolution, smeared)

    monkeypatch.setattr(outlines, "section_mesh", failing)
    said = reasons(scene, trials)
    assert (said[first], said[second], said[last]) == ("unmeshable", "slip", DISMISSED)


@pytest.mark.parametrize("workers", [1, 2])
def test_where_the_rod_is_wrong_all_are_tried(workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that is tried first holds, so that the margins do not cover this flap."""
    scene = a_scene(friction=0.5)
    trials = along(scene, [a_grasp(x, 0.2) for x in (-0.03, -0.035, -0.04)], ["ctc"])
    whole = generate_and_test(scene, trials, "test", "coarse", 1, pruning="none")

    def gloomy(scene: Scene, proposals: Proposals) -> list[Foreseen]:
        return [Foreseen(0.9, 0.9, -0.01, holds=False, excess=float(3 - i)) for i in range(len(proposals))]

    monkeypatch.setattr(search, "foresee", gloomy)
    seen: list[str] = []

    def watch(candidates: Sequence[Candidate]) -> None:
        seen.extend(str(c.index) for c in candidates if c.status == "squeezing" and str(c.index) not in seen)

    plan = generate_and_test(scene, trials, "test", "coarse", workers, watch)
    assert plan.certificate.to_json() == whole.certificate.to_json()
    assert seen[0] == "2" and len(seen) == 3
