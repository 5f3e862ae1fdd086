"""The motion of `benchmarks._rods` by dismech-newton (GPL-3: for the benchmark alone): implicit dynamics.

Its discrete elastic rods do not shear. Steps in time are so long that inertia does not count, and velocities
are taken away after each: what is left is Newton's method on the energy (Gauss and Newton's), or ADMM.
"""

from __future__ import annotations

from typing import Any

import newton
import numpy as np
import warp

from benchmarks._rods import BEND, LENGTH, STRETCH, WEIGHT, Motion, Shapes


def solver() -> Any:
    """dismech-newton's solver.

    Annotations in its release 0.1.0.post4 have `Slots | None`, Slots a struct of Warp's, for which Warp knows
    no `|`. Python evaluates them before 3.14.
    """
    warp.config.log_level = warp.LOG_WARNING
    struct: Any = type(warp.struct(type("Empty", (), {})))
    if "__or__" not in vars(struct):
        struct.__or__ = lambda one, _: one
    from dismech_newton import DiSMechSolver

    return DiSMechSolver


SOLVER = solver()
LONG = 1e3
"""time step, in times in which sound runs along a flap height"""


class DiSMech:
    """Rods with the flap's stiffness and unit mass per length, without bed, on the CPU.

    iterations: in each step; exact: refactorised in each of them, instead of ADMM.
    """

    def __init__(self, motion: Motion, iterations: float, exact: float) -> None:
        length, radius = LENGTH / motion.elements, 0.5
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=-WEIGHT)
        builder.default_shape_cfg.density = 1 / (np.pi * radius**2)
        straight = np.pad(Shapes.straight(motion).nodes, ((0, 0), (0, 0), (0, 1)))
        for points in straight:
            edges = SOLVER.add_rod(
                builder,
                newton.Rod(points, radius=radius),
                stretch_stiffness=STRETCH / length,
                bend_stiffness=BEND / length,
                twist_stiffness=BEND / length,
                collide=False,
                proxies=False,
            )
            SOLVER.fix_segment(builder, edge=edges[0])
            SOLVER.fix_segment(builder, edge=edges[-1])
        self.model = builder.finalize(device="cpu")
        self.solver = SOLVER(self.model, iterations=int(iterations), exact=bool(exact), self_contact=False)
        self.shape = straight.shape
        self.now, self.next, self.initial = (self.model.state() for _ in range(3))

    def place(self, shapes: Shapes) -> None:
        points = np.pad(shapes.nodes, ((0, 0), (0, 0), (0, 1))).reshape(-1, 3)
        self.solver.restart(self.now, self.initial)  # makes the arrays, the first time
        self.now.particle_q.assign(points.astype(np.float32))
        self.now.dismech.edge_q.zero_()
        self.now.dismech.qd.zero_()
        self.solver.restart(self.now, self.initial)

    def advance(self) -> None:
        self.solver.step(self.now, self.next, None, None, LONG)
        self.now, self.next = self.next, self.now
        self.now.dismech.qd.zero_()

    def shapes(self) -> Shapes:
        nodes = self.now.particle_q.numpy().astype(float).reshape(self.shape)[:, :, :2]
        along = np.diff(nodes, axis=1)
        return Shapes(nodes, np.unwrap(np.arctan2(along[..., 1], along[..., 0])[:, ::-1])[:, ::-1])
