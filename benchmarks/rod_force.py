"""How far the rod is from fine finite elements where jaws hold by force: python -m benchmarks.rod_force.

Motions as `benchmarks.rod_motions` has them, ctc and eased, of other random flaps, twice each: closed by a
compression, and by the force with which fine finite elements press then. Each motion counts once, by its
worst error over the states that fine elements find within the limits. Some 15 s a flap.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import machine, on_one_thread, progress, table
from benchmarks.rod_motions import motion
from retract_env.errors import Diverged
from retract_env.grasp import Grasp
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.physics.registry import physics_kind
from retract_env.scene import Scene, sample_scene

Array = NDArray[np.float64]

KINDS, FIRST_SEED = ("ctc", "eased"), 10_000
QUANTITIES = ("strain, relative", "friction", "clearance, over the length")


def pressing(state: TissueState) -> float:
    """N, the mean of both jaws' normal reactions."""
    return -float((state.reactions * state.normals).sum()) / 2


def closed(physics: Physics, scene: Scene, grasp: Grasp) -> TissueState:
    """The state once the jaws have closed."""
    height = scene.tissue.height
    physics.reset()
    for part in (0.25, 0.5, 0.75, 1.0):
        state = physics.move_to(np.array([grasp.x, height / 2, 0, height - part * grasp.compression]), part)
    return state


def states_of(physics: Physics, scene: Scene, grasp: Grasp, poses: Sequence[Array]) -> list[TissueState]:
    """Those since the jaws closed, to the end or, on finite elements, until the target is in view or a limit
    breaks."""
    limits, states = scene.limits, []
    try:
        states.append(closed(physics, scene, grasp))
        for k, pose in enumerate(poses):
            states.append(physics.move_to(pose, 2.0 + k))
            last = states[-1]
            strained, slips = (
                last.worst_strain > limits.strain,
                last.required_friction.max() > limits.friction,
            )
            if isinstance(physics, FemPhysics) and (
                strained or slips or last.overlap or last.clearance > limits.clearance
            ):
                break
    except Diverged:
        pass
    return states


def errors(scene: Scene, grasp: Grasp, poses: Sequence[Array], force: float | None) -> list[float] | None:
    """The worst of each of QUANTITIES, rod less fine elements; None where there is no state to compare."""
    limits = scene.limits
    fine, rod = (
        states_of(physics_kind(name).make(scene, grasp.x, mesh, force=force), scene, grasp, poses)
        for name, mesh in (("fem", "fine"), ("rod", "rod"))
    )
    both = [
        (r, f)
        for r, f in zip(rod, fine, strict=False)
        if f.worst_strain <= limits.strain and f.required_friction.max() <= limits.friction
    ]
    if not both:
        return None
    strain = [max(s.worst_strain for s in states) for states in zip(*both, strict=True)]
    friction = [max(float(s.required_friction.max()) for s in states) for states in zip(*both, strict=True)]
    clearance = [(r.clearance - f.clearance) / scene.tissue.length for r, f in both]
    return [strain[0] / strain[1] - 1, friction[0] - friction[1], max(clearance, key=abs)]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=14)
    options = parser.parse_args(arguments)
    on_one_thread("benchmarks.rod_force", sys.argv[1:] if arguments is None else arguments)
    print(machine())
    found: dict[str, list[list[float]]] = {"compression": [], "force": []}
    for seed in range(FIRST_SEED, FIRST_SEED + options.flaps):
        progress(f"flap {seed - FIRST_SEED + 1} of {options.flaps}")
        scene = sample_scene(np.random.default_rng(seed))
        for kind in KINDS:
            grasp, path = motion(scene, kind, np.random.default_rng([seed, 1]))
            poses = list(path)
            try:
                force = pressing(closed(physics_kind("fem").make(scene, grasp.x, "fine"), scene, grasp))
            except Diverged:
                continue
            for held, by in (("compression", None), ("force", force)):
                if (worst := errors(scene, grasp, poses, by)) is not None:
                    found[held].append(worst)
    rows = []
    for held, motions in found.items():
        for name, values in zip(QUANTITIES, np.array(motions).T, strict=True):
            low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
            size = np.abs(values)
            rows.append(
                (held, name, len(values), f"{low:.4f}/{middle:.4f}/{high:.4f}",
                 f"{np.quantile(size, 0.95):.4f}", f"{values[size.argmax()]:.4f}")
            )  # fmt: skip
    print(table(("held by", "error", "motions", "5/50/95 %", "95 %", "worst"), rows))


if __name__ == "__main__":
    main()
