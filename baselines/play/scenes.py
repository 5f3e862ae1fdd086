"""Which flap is played: a shipped scene, one of the frozen ones, a file, or a random one by its number."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from baselines.learning.demos import demo_scene, episode_seed
from retract_env.errors import ConfigError
from retract_env.scene import Scene, load_scene


@dataclass(frozen=True)
class Dealt:
    """A scene to be played."""

    scene: Scene
    name: str
    """in words"""
    seed: int
    """of the environment's reset"""
    source: str | dict[str, Any]
    """what the environment is told as `scene`"""


def random_scene(number: int) -> Dealt:
    """The scene of that number; `retract demos` numbers them alike, and the benchmark has none of them.

    Raises ConfigError for a number below 0.
    """
    if number < 0:
        raise ConfigError(f"seed = {number}, allowed 0 and more")
    return Dealt(demo_scene(number), f"random flap {number}", episode_seed(number), "random")


def named_scene(name: str) -> Dealt:
    """A scene by the name of a shipped one, by its file, or SPLIT:NUMBER of the benchmark's frozen ones.

    Raises ConfigError, one line.
    """
    frozen = re.fullmatch(r"(\w+):(\d+)", name)
    if frozen is None:
        scene = load_scene(name)
        return Dealt(scene, scene.name, 0, scene.dump())
    from baselines.benchmark.splits import load_benchmark

    split, number = frozen.group(1), int(frozen.group(2))
    splits = load_benchmark("benchmark").splits
    if split not in splits:
        raise ConfigError(f"scene = {name}: no split {split!r}, allowed {', '.join(splits)}")
    if number >= splits[split].count:
        raise ConfigError(f"scene = {name}: allowed {split}:0 to {split}:{splits[split].count - 1}")
    scene = splits[split].scenes()[number]
    return Dealt(scene, f"{split} {number}", 0, scene.dump())
