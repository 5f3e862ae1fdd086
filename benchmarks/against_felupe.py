"""Speed against felupe on the same hex-27 mesh, motion and tolerance: python -m benchmarks.against_felupe.

felupe is the fastest public finite-element code for such problems that we measured, and pure Python. Both
libraries get the same nodes, elements, quadrature, material, prescribed jaws and relative residual, and one
thread. felupe runs its own Newton method, with SciPy's sparse LU, its default, and with this project's
Cholesky. This project runs its own solver, which extrapolates along the path and factorises seldom, and
felupe's method too.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import triu
from scipy.sparse.linalg import spsolve

from benchmarks._report import machine, on_one_thread, progress, table
from benchmarks.hexes import HexFlap, HexModel, hex_flap
from planners.paths import ctc
from retract_env.fem.linear import cholesky
from retract_env.fem.solver import Equilibrium
from retract_env.grasp import Grasp
from retract_env.physics.fem import MEMORY
from retract_env.scene import load_scene

Array = NDArray[np.float64]

SCENE = "homogeneous"
GRASP = Grasp(x=-0.025, compression=0.0011)
SQUEEZE, MOTION = 4, 12
"""increments"""
TIGHT = 1e-8
"""Tolerance of `Equilibrium`, which measures strain energy: the residual is then below the one asked of
felupe."""
MESHES = {"small": (2, 4), "large": (4, 6)}
"""elements along a jaw, elements over the height"""


@dataclass(frozen=True)
class Outcome:
    """What one code did with the motion."""

    seconds: float
    """of the motion, without setting up, some 0.03 s in either"""
    iterations: int
    factorisations: int
    residual: float
    """the greatest left, relative to the jaws' force"""
    shapes: Array
    """(increments, n, 3) m, displacements"""


def with_felupe(
    flap: HexFlap, jaws: Array, tolerance: float, solver: Callable[[Any, Array], Array]
) -> Outcome:
    """The motion by felupe's own Newton method; jaws: (increments, 4) m."""
    import felupe

    newton = getattr(felupe, "newtonraphson", None) or felupe.newtonrhapson  # its name until version 10.2
    order = ((felupe.TriQuadraticHexahedron().points + 1) @ [9, 3, 1]).astype(int)
    mesh = felupe.Mesh(flap.points, flap.cells[:, order], "hexahedron27")
    region = felupe.RegionTriQuadraticHexahedron(mesh)
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    solid = felupe.SolidBody(felupe.NeoHookeCompressible(*flap.lame), field)

    start = time.perf_counter()
    u, iterations, residual, shapes = np.zeros(3 * len(flap.points)), 0, 0.0, []
    for at in jaws:
        flap.place_jaws(u, at)
        result = newton(
            x0=field, items=[solid], dof0=flap.prescribed, dof1=flap.free, ext0=u[flap.prescribed],
            solver=solver, tol=tolerance, verbose=0,
        )  # fmt: skip
        field = result.x
        iterations += result.iterations
        residual = max(residual, result.fnorms[-1])
        shapes.append(field[0].values.copy())
    seconds = time.perf_counter() - start
    return Outcome(seconds, iterations, iterations, residual, np.array(shapes))


class Cholesky:
    """This project's factorisation as felupe asks for it; keeps the ordering while the pattern stays."""

    def __init__(self) -> None:
        self.pattern: NDArray[np.int32] | None = None

    def __call__(self, matrix: Any, force: Array) -> Array:
        upper = triu(matrix, format="csr")
        upper.sort_indices()
        if self.pattern is None or not np.array_equal(self.pattern, upper.indices):
            self.factor, self.pattern = cholesky(upper.indptr, upper.indices), upper.indices
        self.factor.factorize(upper.data)
        return self.factor.solve(force)


def with_retract(flap: HexFlap, jaws: Array, tolerance: float, seldom: bool) -> Outcome:
    """The motion by this project's kernels.

    seldom: with its own solver, which extrapolates through the last equilibria and keeps a factorisation
    while it serves; otherwise by felupe's method, whose first step from the last equilibrium moves the jaws.
    """
    model = HexModel(flap)
    with patch("retract_env.fem.solver.STRAIN_TOLERANCE", TIGHT):
        solver = Equilibrium(model)  # type: ignore[arg-type]  # it has what the solver asks of a FlapModel

    start = time.perf_counter()
    shapes, iterations, residual = [np.zeros(model.assembly.size)], 0, 0.0
    for increment, at in enumerate(jaws):
        past = shapes[SQUEEZE if increment >= SQUEEZE else 0 :][-MEMORY:]  # the path has a corner
        moved = _next(past) if seldom and len(past) > 1 else shapes[-1].copy()
        flap.place_jaws(moved, at)
        if not seldom or len(past) == 1:
            solver.factorize(shapes[-1])
            change = solver.step(shapes[-1], moved - shapes[-1])
            if not seldom:
                change[flap.free] -= solver.factor.solve(model.residual(shapes[-1])[1][flap.free])
            moved, iterations = shapes[-1] + change, iterations + 1
        if seldom:
            u, force = solver.solve(moved)
        else:
            u, force = moved, model.residual(moved)[1]
            while _relative(force, flap) > tolerance:
                solver.factorize(u)
                u[flap.free] -= solver.factor.solve(force[flap.free])
                iterations, force = iterations + 1, model.residual(u)[1]
        shapes.append(u)
        residual = max(residual, _relative(force, flap))
    iterations += solver.counts["iterations"]
    fields = np.array(shapes[1:]).reshape(len(jaws), -1, 3)
    seconds = time.perf_counter() - start
    return Outcome(seconds, iterations, solver.counts["factorisations"], residual, fields)


def _relative(force: Array, flap: HexFlap) -> float:
    """felupe's measure of convergence; the last term is in N."""
    held = float(np.linalg.norm(force[flap.prescribed]))
    return float(np.linalg.norm(force[flap.free])) / (held + 1e-3)


def _next(past: Sequence[Array]) -> Array:
    """The polynomial through k equally spaced values (n,), one step further on."""
    k = len(past)
    return np.array([-((-1) ** i) * math.comb(k, i) for i in range(k, 0, -1)]) @ np.array(past)


def compare(mesh: str, repeats: int, tolerance: float) -> None:
    """Print one table."""
    flap = hex_flap(load_scene(SCENE), GRASP.x, *MESHES[mesh])
    progressing = np.concatenate([np.arange(1, SQUEEZE + 1) / SQUEEZE, np.arange(2, MOTION + 2)])
    jaws = ctc(flap.scene, GRASP, increments=MOTION).jaws_at(progressing)
    runs: dict[str, Callable[[], Outcome]] = {
        "retract": lambda: with_retract(flap, jaws, tolerance, seldom=True),
        "retract, felupe's method": lambda: with_retract(flap, jaws, tolerance, seldom=False),
        "felupe, retract's Cholesky": lambda: with_felupe(flap, jaws, tolerance, Cholesky()),
        "felupe, its default solver": lambda: with_felupe(flap, jaws, tolerance, spsolve),
    }
    best: dict[str, Outcome] = {}
    for name, run in runs.items():
        progress(f"{mesh}: {name}")
        try:
            best[name] = min((run() for _ in range(repeats)), key=lambda outcome: outcome.seconds)
        except ImportError:
            print("felupe is not installed: pip install felupe")
    ours = best["retract"]
    rows = []
    for name, o in best.items():
        apart = 1e9 * float(np.linalg.norm(o.shapes - ours.shapes, axis=2).max())
        ratio = f"{o.seconds / ours.seconds:.1f}"
        rows.append((name, o.seconds, ratio, o.iterations, o.factorisations, f"{o.residual:.0e}", apart))
    print(f"\n{mesh}: {len(flap.points)} nodes, {len(flap.cells)} hex-27, {len(flap.free)} free unknowns;")
    print(f"{SQUEEZE} increments of squeeze, {MOTION} of CTC; relative residual {tolerance:g}; one thread\n")
    head = ("code", "motion s", "ratio", "iterations", "factorised", "residual", "apart nm")
    print(table(head, rows), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--mesh", choices=list(MESHES), nargs="+", default=list(MESHES), help="default: all")
    parser.add_argument("--repeats", type=int, default=3, help="the fastest counts; default: %(default)s")
    parser.add_argument(
        "--tolerance", type=float, default=1e-6, help="relative residual; default: %(default)s"
    )
    options = parser.parse_args(arguments)
    if options.repeats < 1 or not options.tolerance > 0:
        parser.error("--repeats and --tolerance: allowed above 0")
    on_one_thread("benchmarks.against_felupe", sys.argv[1:] if arguments is None else arguments)
    print(machine())
    warm = hex_flap(load_scene(SCENE), GRASP.x, 1, 2)
    with_retract(warm, np.array([[GRASP.x, 1e-5, GRASP.x, 4.39e-3]]), 1e-3, seldom=True)  # compiles kernels
    for mesh in options.mesh:
        compare(mesh, options.repeats, options.tolerance)


if __name__ == "__main__":
    main()
