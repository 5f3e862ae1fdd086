"""The benchmark's frozen scenes: splits drawn from seeds and checked against the hashes in the
configuration."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from os import PathLike
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from retract_env.config import Frozen, Range, config_file, one_of, read_yaml, whole
from retract_env.errors import ConfigError
from retract_env.physics.registry import PHYSICS
from retract_env.scene import Scene, sample_scene
from retract_env.scene.sampling import SceneRanges


class BenchmarkError(ConfigError):
    """A benchmark that cannot be run; the message is one line."""


class _Part(Frozen):
    """Constructors and `from_data` raise `BenchmarkError`."""

    error_type: ClassVar[type[ConfigError]] = BenchmarkError


class Split(_Part):
    """Scenes number 0 ... count - 1, each from the seeds [seed, number]."""

    version: Annotated[int, whole(1, 1000)]
    """Told with every result, as is the hash. Other scenes under the same name are another version."""
    seed: Annotated[int, whole(2, 2**31)]
    """Not 1: demonstrations begin with that."""
    count: Annotated[int, whole(1, 100_000)]
    ranges: SceneRanges = SceneRanges()
    """Where scenes are drawn from; what is left out is its default."""
    hash: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    """Of all scenes, so that a change of them is noticed."""

    def scenes(self, most: int | None = None) -> list[Scene]:
        """The first `most` scenes, or all. All are drawn, as rows tell their hash.

        Raises BenchmarkError, also where there are not so many.
        """
        if most is not None and most > self.count:
            raise BenchmarkError(f"scenes = {most}, allowed {self.count} at most")
        return list(_drawn(self)[:most])


@lru_cache(maxsize=32)
def _drawn(split: Split) -> tuple[Scene, ...]:
    """All scenes of a split, held to its hash. Raises BenchmarkError."""
    rng = np.random.default_rng
    scenes = tuple(sample_scene(rng([split.seed, k]), split.ranges) for k in range(split.count))
    if (found := hash_of(scenes)) != split.hash:
        raise BenchmarkError(
            f"hash = {split.hash!r}, but these scenes have {found!r}: they are not those that results "
            "were measured on"
        )
    return scenes


class Survival(_Part):
    """On what plans are judged that may turn out not quite as the scene says."""

    draws: Annotated[int, whole(1, 100_000)]
    """of the scene's uncertainty, for each plan"""
    seed: Annotated[int, whole(0, 2**31)]
    """of the draws, with the scene's number added; none that a planner draws with"""
    judged: Annotated[int, whole(0, 1000)]
    """draws that finite elements judge, at most, where the rod cannot decide; beyond, its word is taken"""


class Benchmark(_Part):
    """What is compared on what."""

    splits: dict[str, Split]
    resolution: str
    """Of the certifier."""
    policy_resolution: str
    """Of the environment that policies move in."""
    policy_physics: Annotated[str, one_of(PHYSICS)] = "fem"
    """Likewise."""
    lead_out: Annotated[int, whole(0, 64)]
    """Moves like its last that a policy's path goes on for, as the finer mesh may clear later."""
    seed: Annotated[int, whole(0, 2**31)]
    """Of the random policy, and of the bootstrap."""
    bootstrap: Annotated[int, whole(10, 10**6)]
    """Resamples behind an interval."""
    limit: Annotated[float, Range(1.0, 86_400.0, "s")]
    """s that a method has for a scene."""
    survival: Survival
    played: Annotated[int, whole(0, 1000)]
    """Of these draws, so many that a policy is played on; 0: on none."""

    def limited_to(self, seconds: float) -> Benchmark:
        """The same with another limit, s. Raises BenchmarkError."""
        return self.from_data(self.model_dump(mode="json") | {"limit": seconds})

    def played_in(self, physics: str) -> Benchmark:
        """The same with policies that move in another physics, as it comes. Raises BenchmarkError."""
        resolution = PHYSICS[physics].resolution if physics in PHYSICS else ""
        return self.from_data(
            self.model_dump(mode="json") | {"policy_physics": physics, "policy_resolution": resolution}
        )


def hash_of(scenes: Sequence[Scene]) -> str:
    """16 hex digits of the SHA-256 over the scenes' hashes."""
    return hashlib.sha256("".join(scene.hash for scene in scenes).encode()).hexdigest()[:16]


def load_benchmark(path: str | PathLike[str]) -> Benchmark:
    """Benchmark from a YAML file, or the shipped one, "benchmark". Raises BenchmarkError, naming the file."""
    try:
        return Benchmark.from_data(read_yaml(config_file(path, "")))
    except ConfigError as error:
        raise BenchmarkError(f"{path}: {error}") from None
