"""Speed and growth of the spring model: python -m benchmarks.spring.

Four families of flaps, from 1,000 to 1,000,000 polygon vertices, timed from outlines in memory to k_eq(x) and
on to ranked grasps, best of some repeats; then the exponent of a power law through all sizes from 10,000 on,
beside that of v log v.
"""

from __future__ import annotations

import argparse
import gc
import math
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from retract_env.spring import SpringModel

Array = NDArray[np.float64]

L, H = 0.05, 0.0044  # m
E, EV = 40e3, 200e3  # Pa
SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
FITTED_FROM = 10_000  # below, fixed costs of some 0.3 ms show


@dataclass(frozen=True)
class _Vein:
    """What the model reads of a scene's vein; scenes themselves ask for gaps that no mesher could fill."""

    outline: Array
    modulus: float = EV


@dataclass(frozen=True)
class _Tissue:
    veins: Sequence[_Vein]
    length: float = L
    height: float = H
    modulus: float = E


def _round_veins(v: int) -> list[Array]:
    """Ellipses of 20 vertices side by side: 5 % of v basins."""
    n = max(1, v // 20)
    angle = 2 * math.pi * (np.arange(20) + 0.3) / 20
    shape = np.column_stack([0.4 * L / n * np.cos(angle), 0.4 * H * np.sin(angle)])
    return [shape + np.array([-L * (i + 0.5) / n, H / 2]) for i in range(n)]


def _one_vein(v: int) -> list[Array]:
    """One star of v vertices, their order in x far from sorted."""
    angle = 2 * math.pi * np.arange(v) / v
    reach = np.random.default_rng(v).uniform(0.6, 0.95, v)
    return [np.column_stack([-L / 2 + L / 2 * reach * np.cos(angle), H / 2 + H / 2 * reach * np.sin(angle)])]


def _nested(v: int) -> list[Array]:
    """Chevrons one inside the other: every column meets most veins, every bounding box many others."""
    n = max(1, v // 6)
    step = 0.4 * H / n
    tip = np.array([(-0.98 * L, 0.0), (-L / 2, 0.55 * H), (-0.02 * L, 0.0)])
    shape = np.vstack([tip, (tip + np.array([0.0, step / 2]))[::-1]])
    return [shape + np.array([0.0, i * step]) for i in range(n)]


def _comb(v: int) -> list[Array]:
    """One comb of v vertices whose teeth are 100 times as steep as they are apart."""
    n = max(1, v // 4)
    pitch = 0.9 * L / n
    foot = -0.95 * L + pitch * np.arange(n)
    height = np.random.default_rng(v).uniform(0.4 * H, 0.9 * H, n)
    x = foot[:, None] + pitch * np.array([0.2, 0.21, 0.7, 0.71])
    y = np.column_stack([np.full(n, 0.2 * H), height, height, np.full(n, 0.2 * H)])
    back = [(x[-1, 3], 0.1 * H), (x[0, 0], 0.1 * H)]
    return [np.vstack([np.column_stack([x.ravel(), y.ravel()]), back])]


def _best(work: Callable[[], object], budget: float) -> float:
    """s, least of several runs within about `budget` s, without garbage collection, as in timeit."""
    best, spent = math.inf, 0.0
    gc.collect()
    gc.disable()
    try:
        while spent < budget:
            start = time.perf_counter()
            work()
            took = time.perf_counter() - start
            best, spent = min(best, took), spent + took
    finally:
        gc.enable()
    return best


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="most vertices")
    parser.add_argument("--seconds", type=float, default=0.5, help="time per row")
    options = parser.parse_args(arguments)
    sizes = [v for v in SIZES if v <= options.largest]
    if sum(v >= FITTED_FROM for v in sizes) < 2:
        parser.error(f"--largest {options.largest}: the fit needs 30000 at least")

    families = {"veins of 20": _round_veins, "one vein": _one_vein, "nested": _nested, "comb": _comb}
    start = time.perf_counter()
    SpringModel(_Tissue([_Vein(o) for o in _round_veins(40)])).stable_grasps()  # type: ignore[arg-type]
    print(f"{platform.machine()}, Python {platform.python_version()}, one core")
    print(f"first call, kernels compiled or loaded: {time.perf_counter() - start:.2f} s\n")
    print(f"{'family':<12}{'vertices':>10}{'basins':>9}{'k_eq ms':>10}{'grasps ms':>11}{'ns / v log2 v':>15}")
    for name, family in families.items():
        times, counts = [], []
        for size in sizes:
            veins = [_Vein(outline) for outline in family(size)]
            v = sum(len(vein.outline) for vein in veins)
            tissue = _Tissue(veins)
            model = SpringModel(tissue)  # type: ignore[arg-type]
            sweep = _best(lambda t=tissue: SpringModel(t), options.seconds)  # type: ignore[misc]
            rank = _best(model.stable_grasps, options.seconds / 2)
            total = sweep + rank
            times.append(total)
            counts.append(v)
            per = 1e9 * total / (v * math.log2(v))
            basins = len(model.basins())
            print(f"{name:<12}{v:>10}{basins:>9}{1e3 * sweep:>10.2f}{1e3 * rank:>11.2f}{per:>15.1f}")
        small = sum(v < FITTED_FROM for v in sizes)
        x, y = np.log(counts[small:]), np.log(times[small:])
        ideal = np.polyfit(x, x + np.log(x), 1)[0]
        print(f"{name:<12}time ~ v^{np.polyfit(x, y, 1)[0]:.2f}, v log v ~ v^{ideal:.2f}\n")


if __name__ == "__main__":
    main()
