"""Time of a frame and of a picture that is observed: python -m benchmarks.render_speed.

The flap with ten veins, half-way along the CTC path of the spring model's best grasp, as the environments
draw it: the section, the scene in space, what the camera A sees, and, where it is installed, PyBullet's own
software renderer, of its soft body and bed alone. One thread, processor time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks._report import machine, on_one_thread, table
from planners.paths import ctc
from retract_env.drawing.renderer import SectionRenderer
from retract_env.drawing.space import SpaceRenderer
from retract_env.env import TissueRetractEnv
from retract_env.rollout import PathPolicy
from retract_env.scene import load_scene
from retract_env.task.episode import spring_grasps

STEPS = 9
REPEATS = 200
BUDGET = 10.0
"""ms, for a frame in space"""


def half_way(physics: str) -> TissueRetractEnv:
    """An environment in the middle of a retraction."""
    scene = load_scene("ten_veins")
    grasp = spring_grasps(scene)[0]
    env = TissueRetractEnv(physics, scene=scene)
    policy = PathPolicy(scene, grasp, ctc(scene, grasp))
    seen, _ = env.reset(seed=0)
    for _ in range(STEPS):
        seen, *_ = env.step(policy(seen))
    return env


def pybullets_own(env: TissueRetractEnv) -> Callable[[], Any]:
    """PyBullet's picture of its world, 640 x 480, by its TinyRenderer."""
    world: Any = env.episode.physics
    world, length = world._world, env.episode.task.scene.tissue.length
    b, at = world._bullet, world._at
    view = b.computeViewMatrix(
        [-0.9 * length, 0.8 * length, 1.6 * length], [-0.5 * length, 0.3 * length, 0.0], [0.0, 1.0, 0.0]
    )
    lens = b.computeProjectionMatrixFOV(40.0, 4 / 3, 0.1 * length, 10 * length)
    return lambda: b.getCameraImage(640, 480, view, lens, renderer=b.ER_TINY_RENDERER, **at)


def times(draw: Callable[[], Any], repeats: int) -> np.ndarray:
    """(repeats,) ms."""
    draw()  # compiled, fonts found
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        draw()
        spent.append(1e3 * (time.process_time() - start))
    return np.array(spent)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    repeats = parser.parse_args(argv).repeats
    print(machine())
    bullet = find_spec("pybullet") is not None
    env = half_way("bullet" if bullet else "rod")
    episode = env.episode
    scene, state, history = episode.task.scene, episode.now.state, episode.history[:-1]
    section = SectionRenderer(scene, episode.now.section)
    space = SpaceRenderer(scene, episode.now.section)
    drawn: dict[str, Callable[[], Any]] = {
        "frame, section": lambda: section.draw(state, history),
        "frame, in space": lambda: space.draw(state, history),
        "pixels, section": lambda: section.pixels(state),
        "pixels, camera A": lambda: space.pixels(state),
    }
    if bullet:
        drawn["PyBullet's TinyRenderer"] = pybullets_own(env)
    found = {name: times(draw, repeats) for name, draw in drawn.items()}
    rows = [(name, f"{ms.min():.2f}", f"{np.median(ms):.2f}") for name, ms in found.items()]
    print(table(("picture", "best, ms", "median, ms"), rows))
    env.close()
    return 0 if found["frame, in space"].min() < BUDGET else 1


if __name__ == "__main__":
    on_one_thread("benchmarks.render_speed", sys.argv[1:])
    raise SystemExit(main())
