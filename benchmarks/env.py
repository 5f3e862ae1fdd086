"""Speed of the environments: python -m benchmarks.env.

Each line plays the spring model's best grasp and its CTC path, again and again, in one thread. Times are CPU
times of that thread: steps a second in the retract phase, observation, reward and exposure included; a reset
that closes the jaws, on a new flap and on the same again; and the first action of an episode with
`grasp="agent"`, which meshes and squeezes. The last rows say what a
frame, the exposure and an observation cost.

A second table plays the best plan of each scene on both physics and says what becomes of it there.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners import plan
from planners.paths import ctc
from retract_env.env import TissueRetractEnv
from retract_env.objectives import exposure
from retract_env.physics.registry import PHYSICS
from retract_env.rollout import PathPolicy, rollout
from retract_env.scene import Scene, load_scene, sample_scene

RUNS = (
    ("fem", "coarse", "homogeneous"),
    ("fem", "coarse", "random"),
    ("fem", "coarse", "ten_veins"),
    ("fem", "coarse", "twenty_veins"),
    ("fem", "medium", "homogeneous"),
    ("fem", "medium", "ten_veins"),
    ("fem", "fine", "homogeneous"),
    ("bullet", "coarse", "homogeneous"),
    ("bullet", "coarse", "ten_veins"),
    ("bullet", "medium", "homogeneous"),
    ("bullet", "medium", "ten_veins"),
    ("bullet", "fine", "homogeneous"),
)


PLANS = ("homogeneous", "homogeneous_near", "ten_veins", "twenty_veins", "wide")
PLAYED = (("fem", "coarse"), ("fem", "fine"), ("bullet", "coarse"), ("bullet", "medium"))


@dataclass
class Times:
    """s each."""

    new: list[float]
    again: list[float]
    grasp: list[float]
    steps: list[float]


def timed(work: Callable[[], object]) -> float:
    start = time.thread_time()
    work()
    return time.thread_time() - start


def scene_of(name: str, seed: int) -> Scene:
    """A shipped scene, or a random one."""
    if name == "random":
        return sample_scene(np.random.default_rng(seed))
    return load_scene(name)


def episode(env: TissueRetractEnv, scene: Scene, times: Times) -> None:
    """One episode, timed."""
    options: dict[str, Any] = {"scene": scene}
    env.close()  # forget the flap
    times.new.append(timed(lambda: env.reset(options=options)))
    times.again.append(timed(lambda: env.reset(options=options)))
    grasp = env.episode.grasp
    assert grasp is not None
    policy = PathPolicy(scene, grasp, ctc(scene, grasp))
    seen, _ = env.reset(options=options)
    over = False
    while not over:
        action = policy(seen)
        start = time.thread_time()
        seen, _, terminated, truncated, _ = env.step(action)
        times.steps.append(time.thread_time() - start)
        over = terminated or truncated
    env.close()
    first = policy(env.reset(options=options | {"grasp": "agent"})[0])
    times.grasp.append(timed(lambda: env.step(first)))


def measure(physics: str, resolution: str, name: str, seconds: float) -> tuple[Times, TissueRetractEnv]:
    """Play episodes until steps have taken that long."""
    env = TissueRetractEnv(physics, grasp="spring", resolution=resolution)
    times = Times([], [], [], [])
    seed = 0
    while seed == 0 or sum(times.steps) < seconds:
        episode(env, scene_of(name, seed), times)
        seed += 1
    return times, env


def play(name: str) -> None:
    """Play the planner's best plan of one scene on each physics, a line each."""
    scene = load_scene(name)
    best = plan(scene, "ctc", "coarse", workers=1)
    for physics, resolution in PLAYED:
        env = TissueRetractEnv(physics, scene=scene, resolution=resolution)
        played = rollout(env, PathPolicy.of(best), seed=0)
        env.close()
        info = played.infos[-1]
        end = "success" if played.success else info["failure"] or "time"
        figures = f"{info['max_strain']:.3f} | {info['required_friction']:.2f} | {played.total:.2f}"
        print(f"| {name} | {physics} | {resolution} | {end} | {len(played)} | {figures} |", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="of steps a line")
    parser.add_argument("--physics", choices=list(PHYSICS), help="only this one")
    parser.add_argument("--plans", nargs="*", default=PLANS, help="scenes whose plans are played, or none")
    options = parser.parse_args(arguments)
    print(f"{platform.machine()}, Python {platform.python_version()}, CPU time of one thread\n")
    print("| physics | resolution | scene | nodes | reset, ms | again | first action | steps/s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for physics, resolution, name in RUNS:
        if options.physics not in (None, physics):
            continue
        measure(physics, resolution, name, 0.0)  # compile or load the kernels
        times, env = measure(physics, resolution, name, options.seconds)
        nodes = len(env.episode.now.section.points)
        new, again, grasp = (1e3 * float(np.median(t)) for t in (times.new, times.again, times.grasp))
        rate = len(times.steps) / sum(times.steps)
        figures = f"{nodes} | {new:.0f} | {again:.0f} | {grasp:.0f} | {rate:.0f}"
        print(f"| {physics} | {resolution} | {name} | {figures} |", flush=True)
        env.close()
    env = TissueRetractEnv("fem", grasp="spring", render_mode="rgb_array")
    env.reset(seed=0)
    now, line = env.episode.now, env.episode.task.scene.line_of_sight
    outline = now.state.points[now.section.boundary]
    for label, work in (
        ("frame of 640 x 480", env.render),
        ("exposure", lambda: exposure(outline, line.camera, line.target, -0.05)),
        ("observation", lambda: env.episode.task.observation(now)),
    ):
        work()
        print(f"{label}: {1e3 * float(np.median([timed(work) for _ in range(50)])):.2f} ms")
    env.close()
    print("\n| scene | physics | resolution | end | steps | eps_max | friction | return |")
    print("| --- | --- | --- | --- | ---: | ---: | ---: | ---: |")
    for name in options.plans:
        play(name)


if __name__ == "__main__":
    main()
