"""What is computed aside: the certificate of what was played, and what planners do with the same flap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from baselines.play.aside import Tell
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene


def certificate(task: Mapping[str, Any], tell: Tell) -> dict[str, Any]:
    """The certificate of a plan's file, as plain data; tells how many increments were computed."""
    from planners.base import plan_from_json
    from planners.certify import certify

    scene, grasp, path = plan_from_json(task)
    count = 0

    def counted() -> None:
        nonlocal count
        count += 1
        tell(count)

    return certify(scene, grasp, path, task["resolution"], on_increment=counted).to_json()


def rival(task: Mapping[str, Any], tell: Tell) -> dict[str, Any]:
    """What a planner makes of a scene: {"strain": eps_max}, certified, or {"none": why}; tells how many
    candidates are done."""
    from planners import NoPlan, plan
    from planners.base import Candidate

    def update(candidates: Sequence[Candidate]) -> None:
        tell([sum(c.status == "done" for c in candidates), len(candidates)])

    scene = Scene.from_data(task["scene"])
    try:
        best = plan(scene, task["planner"], task["resolution"], workers=1, on_update=update)
    except NoPlan as none:
        return {"none": str(none)}
    return {"strain": best.certificate.max_strain}


def plan_of(scene: Scene, grasp: Grasp, path: JawPath, resolution: str) -> dict[str, Any]:
    """The content of a plan's file, as `Plan.to_json` has it; nothing else was tried."""
    return {
        "scene": scene.dump(),
        "planner": "person",
        "grasp": {"x": grasp.x, **grasp.firmness},
        "path": path.to_json(),
        "resolution": resolution,
        "candidates": [],
    }
