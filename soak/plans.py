"""Every planner on wide random scenes, and jaws that move at random: a certificate, reasons, or a refusal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from baselines.jobs.journal import Row, WorkItem
from planners import PLANNERS, NoPlan
from planners.base import Candidate
from planners.certify import certify
from retract_env.errors import ConfigError, MeshError, SceneError
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from soak.outcomes import apart, refused, sound
from soak.scenes import wide_scene

LIMIT = 300.0
"""s for one planner on one scene, on a busy machine."""
RESOLUTION = "coarse"
POSES = 8
"""of a random path"""


def plan_tasks(scenes: int, code: str) -> list[dict[str, Any]]:
    """Every planner on so many scenes."""
    return [
        {"part": "plans", "number": number, "planner": name, "limit": LIMIT, "code": code}
        for number in range(scenes)
        for name in PLANNERS
    ]


def planned(task: WorkItem) -> Row:
    """What a planner makes of a scene."""
    return apart(_planned, task, task["limit"])


def _planned(task: dict[str, Any]) -> Row:
    try:
        scene = Scene.from_data(wide_scene(task["number"]))
    except SceneError as problem:
        return refused(problem)
    try:
        found = PLANNERS[task["planner"]](scene, resolution=RESOLUTION, workers=1, on_update=None)
    except NoPlan as none:
        counted = _counted(none.candidates)
        return {"outcome": "no plan" if counted else "unsound", "detail": "no reasons", "tried": counted}
    except (ConfigError, MeshError) as problem:
        return refused(problem)
    said = found.certificate
    judged = certify(scene, found.grasp, found.path, RESOLUTION)
    same = judged.certified and judged.to_json() == said.to_json()
    numbers = said.max_strain, said.required_friction, said.clearance
    outcome = "certified" if same and sound(*numbers) else "unsound"
    return {"outcome": outcome, "detail": "" if same else "judged again", "tried": _counted(found.candidates)}


def _counted(candidates: Sequence[Candidate]) -> dict[str, int]:
    """How many candidates ended for each reason."""
    return dict(Counter(str(candidate.reason) for candidate in candidates))


def path_tasks(scenes: int, code: str) -> list[dict[str, Any]]:
    """A random path on each of so many scenes."""
    return [{"part": "paths", "number": number, "limit": LIMIT, "code": code} for number in range(scenes)]


def followed(task: WorkItem) -> Row:
    """What becomes of jaws that move at random."""
    return apart(_followed, task, task["limit"])


def random_path(scene: Scene, rng: np.random.Generator) -> tuple[Grasp, JawPath]:
    """A grasp anywhere, and poses that wander off by up to a tenth of the length and .6 rad at a time."""
    length, height = scene.tissue.length, scene.tissue.height
    half = scene.jaws.width / 2
    x = float(rng.uniform(-length + half, -half))
    closed = height * float(rng.uniform(0.03, 0.4))
    steps = rng.uniform(-1, 1, (POSES, 3)) * [0.1 * length, 0.1 * length, 0.6]
    where = np.cumsum(steps, axis=0)
    poses = np.empty((POSES + 2, 4))
    poses[0] = x, height / 2, 0.0, height
    poses[1] = x, height / 2, 0.0, height - closed
    poses[2:, :3] = poses[1, :3] + where
    poses[2:, 3] = height - closed
    return Grasp(x, closed), JawPath.from_poses(poses, "random")


def _followed(task: dict[str, Any]) -> Row:
    try:
        scene = Scene.from_data(wide_scene(task["number"]))
        grasp, path = random_path(scene, np.random.default_rng([task["number"], 1]))
        judged = certify(scene, grasp, path, RESOLUTION)
    except ValueError as problem:
        return refused(problem)
    outcome = judged.reason if sound(judged.max_strain) else "unsound"
    return {"outcome": outcome, "detail": "", "increments": judged.increments}
