"""Bullet's speed, lag and errors against the finite elements: python -m benchmarks.bullet.

Speed: env steps, 2 mm or 6 degrees of the gripper, along the CTC path. Lag: how far the flap is, where a step
ends, from its rest with the jaws there. Errors: where a step ends, against the finite elements at `fine`.
On the flap without veins a larger mesh than the presets' shows how speed falls and locking fades with size.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import machine, progress, table
from planners.paths import ctc
from retract_env.grasp import Grasp
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.bullet.flap import BULLET_RESOLUTIONS, STRIDE, TURN, BulletPhysics, BulletResolution
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, load_scene

Array = NDArray[np.float64]

NAMES = ("homogeneous", "ten_veins")
GRASP = Grasp(-0.025, 1.1e-3)
"""half-way along, a quarter of the height"""
LARGER = BulletResolution("larger", 0.24, 4, 3, 80)
INCREMENTS = 1000
"""of the path, from which steps are picked"""
ON_BED = 3
"""steps after which this flap has left the bed"""
SPEED = (
    "resolution",
    "nodes",
    "tetrahedra",
    "with copies",
    "time steps",
    "Bullet's clock ms",
    "env steps/s",
    "by cpu time",
    "on the bed",
    "lifted",
    "reset ms",
    "greatest lag mm",
    "lag at the end mm",
)
ERRORS = (
    "resolution",
    "eps",
    "eps fine",
    "greatest error %",
    "jaw force over fine",
    "friction",
    "friction fine",
    "clearance error mm",
    "tip error mm",
)


@dataclass
class Run:
    """One retraction, step by step."""

    states: list[TissueState] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    """wall-clock of each step"""
    cpu: list[float] = field(default_factory=list)

    def move(self, physics: Physics, pose: Array) -> None:
        start, cpu = time.perf_counter(), time.process_time()
        self.states.append(physics.move_to(pose))
        self.seconds.append(time.perf_counter() - start)
        self.cpu.append(time.process_time() - cpu)


def steps(scene: Scene) -> list[Array]:
    """Poses after the squeeze and each env step of the CTC path, until an ideal flap is out of sight."""
    poses = ctc(scene, GRASP, INCREMENTS).poses[1 : INCREMENTS + 2]
    out = [poses[0]]
    for pose, after in pairwise(poses[1:]):
        change = np.abs(after - out[-1])
        if max(np.hypot(*change[:2]) / STRIDE, change[2] / TURN) > 1:
            out.append(pose)
    return out


def tip(physics: Physics, state: TissueState) -> Array:
    """Where the free end is, at its bottom, m."""
    points = physics.section.points
    return np.asarray(state.points[np.lexsort((points[:, 1], points[:, 0]))[0]])


def retract(physics: Physics, poses: Sequence[Array]) -> Run:
    run = Run()
    physics.reset()
    for pose in poses:
        run.move(physics, pose)
    return run


def compare(name: str, repeats: int) -> None:
    scene = load_scene(name)
    poses = steps(scene)
    progress(f"{name}, finite elements at fine")
    fine = FemPhysics(scene, GRASP.x, "fine")
    certified = retract(fine, poses).states
    speed, errors = [], []
    for resolution in (*BULLET_RESOLUTIONS.values(), *(() if scene.tissue.veins else (LARGER,))):
        progress(f"{name}, {resolution.name}")
        physics = BulletPhysics(scene, GRASP.x, resolution)
        start = time.perf_counter()
        physics.reset()
        reset = time.perf_counter() - start
        runs = [retract(physics, poses) for _ in range(repeats)]
        # each step by itself, so that what else the machine does disturbs least
        wall, cpu = (np.min([getattr(r, of) for r in runs], axis=0) for of in ("seconds", "cpu"))
        clock = 1e3 * physics.resolution.steps * physics.time_step
        at_rest = []
        physics.reset()
        for pose in poses:
            physics.move_to(pose)
            at_rest.append(physics.settle())
        pairs = zip(runs[0].states, at_rest, strict=True)
        lag = [1e3 * float(np.linalg.norm(a.points - b.points, axis=1).max()) for a, b in pairs]
        mesh = physics.mesh
        size = (len(mesh.points), len(mesh.cells), int(mesh.copies.sum()), physics.resolution.steps)
        rates = [f"{1 / t.mean():.0f}" for t in (wall, cpu, cpu[:ON_BED], cpu[ON_BED:])]
        speed.append((resolution.name, *size, clock, *rates, f"{1e3 * reset:.0f}", max(lag), lag[-1]))
        errors.append((resolution.name, *differences(fine, certified, physics, runs[0].states)))
        physics.close()
    print(f"\n{name}, {len(poses)} env steps\n\n{table(SPEED, speed)}\n\n{table(ERRORS, errors)}", flush=True)


def differences(
    fine: Physics, certified: Sequence[TissueState], physics: Physics, states: Sequence[TissueState]
) -> tuple[object, ...]:
    """At the end of the path, and the greatest error of eps on the way."""
    a, b = certified[-1], states[-1]
    worst = max(
        (t.worst_strain / s.worst_strain - 1 for s, t in zip(certified, states, strict=True)), key=abs
    )
    force = np.linalg.norm(b.reactions, axis=1).sum() / np.linalg.norm(a.reactions, axis=1).sum()
    off = tip(physics, b) - tip(fine, a)
    return (
        f"{b.worst_strain:.3f}",
        f"{a.worst_strain:.3f}",
        f"{100 * worst:+.0f}",
        f"{force:.2f}",
        f"{b.required_friction.max():.2f}",
        f"{a.required_friction.max():.2f}",
        f"{1e3 * (b.clearance - a.clearance):+.2f}",
        f"({1e3 * off[0]:+.2f}, {1e3 * off[1]:+.2f})",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--repeats", type=int, default=3, help="retractions timed; the best time of each step counts"
    )
    parser.add_argument("--scenes", nargs="+", default=list(NAMES), help="names of configs/scenes")
    options = parser.parse_args(arguments)
    print(machine())
    for name in options.scenes:
        compare(name, options.repeats)


if __name__ == "__main__":
    main()
