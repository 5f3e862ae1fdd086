"""The picture of the environment in docs/environment.md: python docs/images/environment.py.

The spring model's best grasp on the flap with ten veins and its CTC path, half-way: the section on the finite
elements, the same on Bullet, and Bullet's own picture.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from planners.paths import ctc
from retract_env.env import TissueRetractEnv
from retract_env.rollout import PathPolicy
from retract_env.scene import load_scene
from retract_env.task.episode import spring_grasps

HERE = Path(__file__).resolve().parent
SCENE = HERE.parents[1] / "configs" / "scenes" / "ten_veins.yaml"
VIEWS = (("fem", "section"), ("bullet", "section"), ("bullet", "3d"))
STEPS = 9
GAP = 8
"""px between frames"""


def main() -> None:
    scene = load_scene(SCENE)
    grasp = spring_grasps(scene)[0]
    frames = []
    for physics, camera in VIEWS:
        env = TissueRetractEnv(physics, scene=scene, camera=camera, render_mode="rgb_array")
        policy = PathPolicy(scene, grasp, ctc(scene, grasp))
        seen, _ = env.reset(seed=0)
        for _ in range(STEPS):
            seen, *_ = env.step(policy(seen))
        frames += [env.render(), np.full((480, GAP, 3), 255, np.uint8)]
        env.close()
    row = np.concatenate([frame for frame in frames[:-1] if frame is not None], axis=1)
    Image.fromarray(row).quantize(128, dither=Image.Dither.NONE).save(HERE / "environment.png", optimize=True)


if __name__ == "__main__":
    main()
