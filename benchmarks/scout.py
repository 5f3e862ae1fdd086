"""How well a cheaper mesh says how much a squeeze will strain: python -m benchmarks.scout.

All stable grasps of random flaps, as agents are trained on and as in the benchmark's split `shifted`, and
those of configs/scenes that have veins, squeezed at `fine` and on the mesh of planners/scouted.py. A better
retraction could be dropped where the cheaper mesh strained DOUBT more than `fine`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from baselines.splits import load_benchmark
from benchmarks._report import machine, progress, table
from planners.certify import Trial
from planners.paths import ctc
from planners.proposals import stable_grasps
from planners.scouted import DOUBT, Scouted
from retract_env.scene import Scene, load_scene, sample_scene

CONFIGS = Path(__file__).resolve().parent.parent / "configs"


def errors(scene: Scene) -> tuple[list[float], float, float]:
    """% by which the cheaper mesh strains more, for each grasp; CPU s of one squeeze on it, and at `fine`."""
    found, cheap, dear = [], 0.0, 0.0
    for grasp in stable_grasps(scene):
        begin = time.thread_time()
        scout = Scouted(scene, grasp, ctc(scene, grasp))
        scout.squeeze()
        middle = time.thread_time()
        trial = Trial(scene, grasp, ctc(scene, grasp))
        trial.squeeze()
        cheap, dear = cheap + middle - begin, dear + time.thread_time() - middle
        found.append(100 * (scout.max_strain / (1 - DOUBT) / trial.max_strain - 1))
    return found, cheap / len(found), dear / len(found)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=10, help="random ones, of each kind")
    options = parser.parse_args(arguments)
    groups = {
        "random": [sample_scene(np.random.default_rng(seed)) for seed in range(options.flaps)],
        "shifted": load_benchmark(CONFIGS / "benchmark.yaml").splits["shifted"].scenes(options.flaps),
    }
    for name in ("ten_veins", "twenty_veins", "wide"):
        groups[name] = [load_scene(CONFIGS / "scenes" / f"{name}.yaml")]
    rows = []
    for name, scenes in groups.items():
        progress(name)
        measured = [errors(scene) for scene in scenes if scene.tissue.veins]
        all_errors = np.concatenate([found for found, _, _ in measured])
        seconds = np.mean([times for _, *times in measured], axis=0)
        figures = f"{all_errors.min():.2f}", f"{all_errors.max():.2f}", *(f"{s:.2f}" for s in seconds)
        rows.append((name, len(measured), len(all_errors), *figures))
    print(machine())
    print(table(("flaps", "how many", "squeezes", "least %", "greatest %", "s", "s at fine"), rows))
    print(f"\nallowed {100 * DOUBT:g} %")


if __name__ == "__main__":
    main()
