"""Errors of coarse against fine on random flaps: python -m benchmarks.coarse.

Each line follows the CTC path of the spring model's best grasp on one random flap, the squeeze and 23 more
poses, on both meshes: the greatest strain, jaw force, needed friction and clearance at any of them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import machine, progress, table
from planners.paths import ctc
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, sample_scene
from retract_env.spring import SpringModel

Array = NDArray[np.float64]

POSES = 24


def follow(scene: Scene, resolution: str) -> tuple[Array, int, float]:
    """(POSES, 4) eps_1%, greatest jaw force [N], friction, clearance over the length; nodes; s for it all."""
    grasp = SpringModel(scene.tissue).stable_grasps()[0]
    poses = ctc(scene, grasp).poses
    start = time.thread_time()
    physics = FemPhysics(scene, grasp.x, resolution)
    physics.reset()
    rows = []
    for k in range(1, POSES + 1):
        state = physics.move_to(poses[k], float(k))
        force = np.hypot(*state.reactions.T).max()
        friction = min(float(state.required_friction.max()), 1.0)
        rows.append((state.worst_strain, force, friction, state.clearance / scene.tissue.length))
    return np.array(rows), len(physics.section.points), time.thread_time() - start


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=20, help="how many, by seeds from 0")
    options = parser.parse_args(arguments)
    rows: list[tuple[object, ...]] = []
    errors = []
    for seed in range(options.flaps):
        progress(f"flap {seed}")
        scene = sample_scene(np.random.default_rng(seed))
        (coarse, nodes, seconds), (fine, fine_nodes, fine_seconds) = (
            follow(scene, resolution) for resolution in ("coarse", "fine")
        )
        most = 100 * (coarse[:, 0].max() / fine[:, 0].max() - 1)
        force = 100 * abs(coarse[:, 1] / fine[:, 1] - 1).max()
        friction, clearance = abs(coarse - fine)[:, 2:].max(axis=0)
        errors.append((abs(most), force, friction, 100 * clearance))
        sizes = f"{nodes} / {fine_nodes}", f"{seconds:.2f} / {fine_seconds:.2f}"
        figures = f"{most:.1f}", f"{force:.1f}", f"{friction:.3f}", f"{100 * clearance:.2f}"
        rows.append((seed, len(scene.tissue.veins), *sizes, *figures))
    for name, summary in (("median", np.median(errors, axis=0)), ("greatest", np.max(errors, axis=0))):
        rows.append((name, "", "", "", *(f"{value:.2g}" for value in summary)))
    print(machine())
    heads = ("flap", "veins", "nodes", "s", "eps_max %", "force %", "friction", "clearance, % of length")
    print(table(heads, rows))


if __name__ == "__main__":
    main()
