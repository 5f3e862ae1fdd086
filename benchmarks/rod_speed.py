"""Steps a second of the retraction task on rods: python -m benchmarks.rod_speed.

With --soak STEPS instead so many random steps: what memory they take, how many episodes were given up.

Only the environments' own work is timed, on two threads unless told otherwise; what chooses the actions is
not, but for the last line: PPO's rollout as `retract train` makes it, with its untrained network on one
thread, the normalisation of observations and the log, on as many cores as there are.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import retract_env  # noqa: F401, registers the environments
from benchmarks._report import machine, progress, table
from planners import paths
from planners.eased import FIRST, PLACES, RADII, STRETCH, TURN
from retract_env.mesh.jaws import SLIVER
from retract_env.task import SLICES, TaskConfig

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

TASK, LENGTH, HEIGHT, WIDTH = TaskConfig(), 0.05, 4.4e-3, 1e-3
FIRMER = 1.3
"""times the compression that the planner tries first: most flaps hold at once"""
INCREMENTS = 12
ROLLOUT = 256
"""flaps in PPO's rollout"""


def eased_actions(observations: Floats) -> Floats:
    """Actions (n, 3) along eased paths for flaps of `sample_scene`, from observations (n, SIZE)."""
    seen = {name: observations[:, part].astype(np.float64) for name, part in SLICES.items()}
    holding = seen["holding"][:, 0] > 0
    target, slope = seen["target"][:, 0] * LENGTH, seen["slope"][:, 0]
    distance = LENGTH / seen["nearness"][:, 0]
    camera = target - distance * np.cos(slope), distance * np.sin(slope)
    cross = target * camera[1]
    radius = (distance * np.abs(cross) + (camera[0] - target) * cross) / camera[1] ** 2
    place, first = (np.interp(radius / LENGTH, RADII, values) for values in (PLACES, FIRST))
    arc = place * LENGTH
    low, high = (share * HEIGHT for share in TASK.compression)
    nearest = -(0.5 + SLIVER) * WIDTH
    along = (LENGTH - arc) / (LENGTH + nearest)
    strength = np.log(np.clip(FIRMER * first * HEIGHT, low, high) / low) / np.log(high / low)
    closing = np.stack([2 * along - 1, 2 * strength - 1, np.zeros_like(along)], axis=1)

    goal = paths.arc_turn(1 / radius, arc, HEIGHT)  # type: ignore[arg-type]
    theta = np.arctan2(*seen["angle"].T)
    turn = -theta / TURN + goal / INCREMENTS
    x = -arc * np.sinc(turn / np.pi)
    rise = arc * turn / 2 * np.sinc(turn / (2 * np.pi)) ** 2
    factor = 1 + STRETCH * np.minimum(turn / goal, 1.0)
    here = seen["gripper"] * LENGTH
    change = np.stack([factor * x, HEIGHT / 2 + factor * rise, -TURN * turn], axis=1)
    change -= np.stack([here[:, 0], here[:, 1], theta], axis=1)
    wanted = change / TASK.move
    moving = wanted / np.maximum(1.0, np.abs(wanted).max(axis=1, keepdims=True))
    return np.clip(np.where(holding[:, None], moving, closing), -1, 1).astype(np.float32)


def timed(
    envs: gym.vector.VectorEnv, steps: int, act: Callable[[Floats], Floats]
) -> tuple[float, float, float]:
    """Steps a second of all together, steps an episode, share of episodes that end in success."""
    observations, _ = envs.reset(seed=0)
    for _ in range(5):
        observations = envs.step(act(observations))[0]
    seconds, ended, succeeded = 0.0, 0, 0
    for _ in range(steps):
        chosen = act(observations)
        start = time.perf_counter()
        observations, _, terminated, truncated, infos = envs.step(chosen)
        seconds += time.perf_counter() - start
        over = terminated | truncated
        ended += int(over.sum())
        if over.any():
            succeeded += int(infos["final_info"]["is_success"][over].sum())
    return envs.num_envs * steps / seconds, envs.num_envs * steps / max(ended, 1), succeeded / max(ended, 1)


def rollouts(count: int, steps: int) -> tuple[float, float, float]:
    """As `timed`, of PPO's rollouts in `count` environments, but that the last two are of 100 episodes."""
    from baselines.learning.agents import Agent
    from baselines.learning.envs import make_envs
    from baselines.learning.recipe import Recipe, load_recipe

    data = load_recipe("ppo").dump()
    data["task"]["physics"], data["learner"]["rollout"] = "rod", steps
    recipe = Recipe.from_data(data)
    envs = make_envs(recipe, count)
    agent = Agent(recipe, envs, 0)
    agent.model.train = lambda: None
    agent.learn(1, lambda _: None)  # a whole rollout
    start = time.perf_counter()
    agent.learn(1, lambda _: None)
    seconds = time.perf_counter() - start
    envs.close()
    lengths = [episode["l"] for episode in agent.model.ep_info_buffer]
    return count * steps / seconds, float(np.mean(lengths)), float(np.mean(agent.model.ep_success_buffer))


def resident() -> float:
    """MB of memory that this process has now; nan where the system is not Linux."""
    statm = Path("/proc/self/statm")
    return (
        int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if statm.exists() else math.nan
    )


def soak(envs: gym.vector.VectorEnv, steps: int) -> None:
    """Random steps of all together, as many as asked or a few more; raises where one is out of bounds."""
    rng, space = np.random.default_rng(0), envs.single_observation_space
    assert isinstance(space, gym.spaces.Box)
    rounds = -(-steps // envs.num_envs)
    ended, diverged, memory = 0, 0, [0.0, 0.0]
    envs.reset(seed=0)
    start = time.perf_counter()
    for k in range(rounds):
        chosen = rng.uniform(-1, 1, (envs.num_envs, 3))
        observations, rewards, terminated, truncated, infos = envs.step(chosen)
        if not ((observations >= space.low) & (observations <= space.high)).all() or np.isnan(rewards).any():
            raise ArithmeticError(f"round {k}: an observation or a reward out of bounds")
        over = terminated | truncated
        ended += int(over.sum())
        if over.any():
            diverged += int((infos["final_info"]["failure"][over] == "diverged").sum())
        if k == rounds // 100:  # by then all code has been loaded, all room taken
            memory[0] = resident()
        if (k + 1) % (rounds // 10 + 1) == 0:
            progress(f"{(k + 1) * envs.num_envs:,} steps")
    memory[1], seconds = resident(), time.perf_counter() - start
    rows: list[tuple[object, ...]] = [
        ("steps", f"{rounds * envs.num_envs:,}"),
        ("seconds, with choosing and checking", f"{seconds:,.0f}"),
        ("episodes", f"{ended:,}"),
        ("of them diverged", f"{diverged:,}, {1e6 * diverged / max(ended, 1):.1f} in a million"),
        ("memory after 1 % of the steps, MB", f"{memory[0]:.1f}"),
        ("memory at the end, MB", f"{memory[1]:.1f}"),
    ]
    print(table(("", ""), rows))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--envs", type=int, default=1024)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--soak", type=int, metavar="STEPS")
    options = parser.parse_args(arguments)
    print(machine())
    envs = gym.make_vec(
        "TissueRetractRod-v0",
        num_envs=options.envs,
        scene="random",
        threads=options.threads,
        autoreset_mode="SameStep",
    )
    if options.soak:
        soak(envs, options.soak)
        envs.close()
        return
    envs.action_space.seed(0)
    rows: list[tuple[object, ...]] = []
    for name, act in (("eased paths", eased_actions), ("random", lambda _: envs.action_space.sample())):
        progress(f"{options.envs} flaps, {name}")
        speed, long, success = timed(envs, options.steps, act)
        rows.append((f"{options.envs} flaps, {name}", f"{speed:,.0f}", f"{long:.1f}", f"{100 * success:.0f}"))
    envs.close()
    progress("one flap")
    env = gym.make("TissueRetractRod-v0", scene="random", grasp="agent")
    observation, _ = env.reset(seed=0)
    env.step(eased_actions(observation[None])[0])  # all that is compiled is loaded by then
    observation, _ = env.reset(seed=0)
    seconds, count, ends = 0.0, 0, 0
    while count < 20 * options.steps:
        action = eased_actions(observation[None])[0]
        start = time.perf_counter()
        observation, _, terminated, truncated, _ = env.step(action)
        seconds += time.perf_counter() - start
        count += 1
        if terminated or truncated:
            observation, _ = env.reset()
            ends += 1
    rows.append(
        ("one flap, resets not counted", f"{count / seconds:,.0f}", f"{count / max(ends, 1):.1f}", "")
    )
    progress(f"{ROLLOUT} flaps, PPO")
    speed, long, success = rollouts(ROLLOUT, options.steps)
    name = f"{ROLLOUT} flaps, PPO's rollout with its network"
    rows.append((name, f"{speed:,.0f}", f"{long:.1f}", f"{100 * success:.0f}"))
    print(table(("", "steps/s", "steps an episode", "successes, %"), rows))


if __name__ == "__main__":
    main()
