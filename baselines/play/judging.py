"""What is computed aside: the certificate of what was played, and what planners do with the same flap."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.play.aside import Tell
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


def rival(task: Mapping[str, Any], _: Tell) -> dict[str, Any]:
    """What a planner makes of a scene: {"strain": eps_max}, certified, or {"none": why}."""
    from planners import NoPlan, plan

    scene = Scene.from_data(task["scene"])
    try:
        best = plan(scene, task["planner"], task["resolution"], workers=1, on_update=None)
    except NoPlan as none:
        return {"none": str(none)}
    return {"strain": best.certificate.max_strain}
