"""The picture of the environment in docs/environment.md: python docs/images/environment.py.

The spring model's best grasp on the flap with ten veins and its CTC path, half-way on the finite elements:
the section, the scene in space, and what the camera A sees of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from planners.paths import ctc
from retract_env.drawing.stage import CAMERAS
from retract_env.env import TissueRetractEnv
from retract_env.grasp import Grasp
from retract_env.rollout import PathPolicy
from retract_env.scene import Scene, load_scene
from retract_env.task.episode import spring_grasps

HERE = Path(__file__).resolve().parent
SCENE = HERE.parents[1] / "configs" / "scenes" / "ten_veins.yaml"
STEPS = 9
GAP = 8
"""px between frames"""


def main() -> None:
    scene = load_scene(SCENE)
    grasp = spring_grasps(scene)[0]
    frames = []
    for camera in CAMERAS:
        env = TissueRetractEnv("fem", scene=scene, camera=camera, render_mode="rgb_array")
        retract(env, scene, grasp)
        frames += [env.render(), np.full((480, GAP, 3), 255, np.uint8)]
        env.close()
    env = TissueRetractEnv("fem", scene=scene, obs="pixels", view="camera")
    seen = retract(env, scene, grasp)
    env.close()
    larger = Image.fromarray(seen).resize((480, 480), Image.Resampling.NEAREST)
    row = np.concatenate([*(frame for frame in frames if frame is not None), np.asarray(larger)], axis=1)
    Image.fromarray(row).save(HERE / "environment.png", optimize=True)


def retract(env: TissueRetractEnv, scene: Scene, grasp: Grasp) -> Any:
    """Half-way along the CTC path; returns what is observed there."""
    policy = PathPolicy(scene, grasp, ctc(scene, grasp))
    seen, _ = env.reset(seed=0)
    exact = env.episode.task.observation(env.episode.now)
    for _ in range(STEPS):
        seen, *_ = env.step(policy(exact))
        exact = env.episode.task.observation(env.episode.now)
    return seen


if __name__ == "__main__":
    main()
