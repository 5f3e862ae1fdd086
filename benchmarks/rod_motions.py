"""Motions on finite elements to fit the rod to and to compare it with: python -m benchmarks.rod_motions.

Random flaps are retracted on four kinds of paths: ctc and circular ones from random grasps, eased ones a
little firmer than its planner begins with, and random actions of the environment. Each equilibrium is kept:
where the jaws are, what they feel, strain, clearance. Three sets share no flap: `fit` is for the grip law,
`calibration` for the quantiles that the package carries, `test` for what is published. `wide` has flaps of
other sizes, depths and moduli for another test. `squeezes` are squeezes alone, of such flaps with any
Poisson's ratio between jaws of any width, for the grip law.

A line of out/rod/SET-RESOLUTION.jsonl is one motion. What is there already is not computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import on_one_thread
from planners import paths
from planners.eased import FIRST, PLACES, RADII, eased
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp
from retract_env.mesh import jaw_range
from retract_env.objectives import verdict
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.registry import physics_kind
from retract_env.scene import Scene, sample_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.spring import SpringModel
from retract_env.task import actions

Array = NDArray[np.float64]

FOLDER = Path("out/rod")
SETS = {
    "fit": (20_000, 100),
    "calibration": (30_000, 100),
    "test": (40_000, 200),
    "wide": (50_000, 54),
    "squeezes": (60_000, 300),
}
"""First seed and number of flaps."""
WIDE = SceneRanges(
    length=(0.03, 0.08),
    height=(0.003, 0.009),
    depth=(0.003, 0.04),
    tissue_modulus=(2e4, 1e5),
    veins=(0, 12),
)
KINDS = ("ctc", "circular", "eased", "random")
POISSON, JAW_WIDTHS = (0.3, 0.49), (5e-4, 3e-3)
"""of squeezes; m"""
INCREMENTS = 12
"""of a path, up to its goal"""
SQUEEZES = (0.25, 0.5, 1.0)
"""parts of the compression at which the squeeze is kept"""
RANDOM_STEPS = 12


def scene_of(name: str, seed: int) -> Scene:
    """The flap of that seed."""
    rng = np.random.default_rng(seed)
    if name not in ("wide", "squeezes"):
        return sample_scene(rng)
    scene = sample_scene(rng, WIDE)
    if name == "wide":
        return scene
    data = scene.dump()
    data["tissue"]["poisson"] = rng.uniform(*POISSON)
    data["jaws"]["width"] = rng.uniform(*JAW_WIDTHS)
    return Scene.from_data(data)


def kinds_of(name: str) -> Sequence[str]:
    """Kinds of motions in a set."""
    return ("squeeze",) if name == "squeezes" else KINDS


def motion(scene: Scene, kind: str, rng: np.random.Generator) -> tuple[Grasp, Iterator[Array]]:
    """A grasp, and poses (4,) of the jaws after the squeeze, without end for random actions."""
    tissue, line = scene.tissue, scene.line_of_sight
    low, high = jaw_range(tissue.length, scene.jaws.width)
    if kind == "squeeze":
        x = min(rng.uniform(low, high), high)
        return Grasp(float(x), float(tissue.height * 0.03 * 13 ** rng.uniform())), iter(())
    if kind == "random":
        grasp = actions.to_grasp(rng.uniform(-1, 1, 3), scene)
        return grasp, _wander(scene, grasp, rng)
    if kind == "ctc":
        stable = SpringModel(tissue).stable_grasps(scene.limits.strain, scene.jaws.width)
        chosen = stable[int(rng.integers(len(stable)))]
        grasp = Grasp(chosen.x, chosen.compression * rng.uniform(0.3, 1.0))
        path = paths.ctc(scene, grasp, INCREMENTS)
    elif kind == "circular":
        x = rng.uniform(low, max(-0.25 * tissue.length, low))
        grasp = Grasp(float(min(x, high)), float(tissue.height * 0.04 * 7.5 ** rng.uniform()))
        path = paths.circular(scene, grasp, INCREMENTS)
    else:
        radius = paths.goal_radius(line.camera, line.target) / tissue.length
        place, first = (float(np.interp(radius, RADII, values)) for values in (PLACES, FIRST))
        x = float(np.clip(-place * tissue.length * rng.uniform(0.9, 1.1), low, high))
        grasp = Grasp(x, first * tissue.height * rng.uniform(0.9, 1.5))
        path = eased(scene, grasp, INCREMENTS)
    return grasp, iter(path.poses[2:])


def _wander(scene: Scene, grasp: Grasp, rng: np.random.Generator) -> Iterator[Array]:
    height = scene.tissue.height
    pose = np.array([grasp.x, height / 2, 0.0, height - grasp.compression])
    for _ in range(RANDOM_STEPS):
        pose = actions.moved(rng.uniform(-1, 1, 3), pose)
        yield pose


def follow(name: str, seed: int, kind: str, physics_name: str, resolution: str) -> dict[str, Any]:
    """One motion as plain data, up to the first state that settles what becomes of it."""
    scene = scene_of(name, seed)
    rng = np.random.default_rng([seed, (*KINDS, "squeeze").index(kind)])
    grasp, poses = motion(scene, kind, rng)
    found: dict[str, Any] = {"seed": seed, "kind": kind, "x": grasp.x, "compression": grasp.compression}
    states: list[list[float]] = []
    start = time.perf_counter()
    end = ""
    try:
        physics = physics_kind(physics_name).make(scene, grasp.x, resolution)
        end = _move(scene, physics, grasp, poses, states, smooth=kind != "random")
        physics.close()
    except (Diverged, MeshError) as error:
        end = type(error).__name__
    return found | {"end": end, "states": states, "seconds": round(time.perf_counter() - start, 3)}


def _move(
    scene: Scene,
    physics: Physics,
    grasp: Grasp,
    poses: Iterator[Array],
    states: list[list[float]],
    smooth: bool,
) -> str:
    """smooth: whether the poses are of one path, on which equilibria predict the next one."""
    limits, height = scene.limits, scene.tissue.height
    physics.reset()
    for part in SQUEEZES:
        pose = np.array([grasp.x, height / 2, 0.0, height - part * grasp.compression])
        states.append(row(pose, part, physics.move_to(pose, part)))
    for k, pose in enumerate(poses):
        state = physics.move_to(pose, 2.0 + k if smooth else None)
        states.append(row(pose, 2.0 + k, state))
        found = verdict(
            state.worst_strain,
            state.required_friction,
            state.clearance,
            limits.strain,
            limits.friction,
            limits.clearance,
            state.overlap,
        )
        if found is not None:
            return found
    return "end"


def row(pose: Array, progress: float, state: TissueState) -> list[float]:
    """Progress, pose (4), eps_1%, normal and tangential force of both jaws (N1, N2, T1, T2; N), clearance m,
    and whether tissue overlaps."""
    normal = -(state.reactions * state.normals).sum(axis=1)
    across = np.stack([-state.normals[:, 1], state.normals[:, 0]], axis=1)
    tangential = (state.reactions * across).sum(axis=1) * np.array([1.0, -1.0])
    numbers = [progress, *pose, state.worst_strain, *normal, *tangential, state.clearance, state.overlap]
    return [float(f"{v:.9g}") for v in numbers]


COLUMNS = (
    "progress",
    "x",
    "y",
    "theta",
    "separation",
    "strain",
    "N1",
    "N2",
    "T1",
    "T2",
    "clearance",
    "overlap",
)
"""of a state's row; both tangential forces point to the same side, along the flap towards its fixed end when
it lies at rest"""


def stored(name: str, resolution: str = "fine") -> list[dict[str, Any]]:
    """The motions of a set that are on disk."""
    file = FOLDER / f"{name}-{resolution}.jsonl"
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="*", default=list(SETS), help=f"of {', '.join(SETS)}")
    parser.add_argument("--resolution", help="fine for the finite elements, otherwise the physics' own")
    parser.add_argument("--physics", default="fem")
    parser.add_argument("--flaps", type=int, help="only the first so many of each set")
    options = parser.parse_args(arguments)
    FOLDER.mkdir(parents=True, exist_ok=True)
    resolution = options.resolution or (
        "fine" if options.physics == "fem" else physics_kind(options.physics).resolution
    )
    label = resolution if options.physics == "fem" else options.physics
    work = [
        (name, seed, kind)
        for name in options.sets
        for seed in range(SETS[name][0], SETS[name][0] + min(SETS[name][1], options.flaps or 10**9))
        for kind in kinds_of(name)
    ]
    there = {(n, m["seed"], m["kind"]) for n in options.sets for m in stored(n, label)}
    work = [item for item in work if item not in there]
    start = time.perf_counter()
    for done, (name, seed, kind) in enumerate(work):
        found = follow(name, seed, kind, options.physics, resolution)
        with (FOLDER / f"{name}-{label}.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(found) + "\n")
        if done % 20 == 19:
            left = (time.perf_counter() - start) / (done + 1) * (len(work) - done - 1)
            minutes = math.ceil(left / 60)
            print(
                f"{name}: {done + 1} of {len(work)} motions, {minutes} min left", file=sys.stderr, flush=True
            )


if __name__ == "__main__":
    on_one_thread("benchmarks.rod_motions", sys.argv[1:])
    main()
