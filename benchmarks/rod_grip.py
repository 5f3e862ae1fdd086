"""The rod's grip law, fitted to squeezes and motions on fine finite elements: python -m benchmarks.rod_grip.

Needs the sets `fit` and `squeezes` of `benchmarks.rod_motions`. Writes retract_env/rod/grip.json and says how far
off the laws are, on the set `squeezes` also by cross-validation: every flap judged by laws that never saw it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks._report import on_one_thread, progress
from benchmarks.rod_motions import COLUMNS, scene_of, stored
from retract_env.physics.rod import flap_numbers
from retract_env.rod import grip
from retract_env.spring.columns import veins_of

Array = NDArray[np.float64]

OUTLIER = 0.05
"""Residual, of the logarithm, beyond which a squeeze counts for less: light grips on creased tissue."""
OTHER = 0.6
"""What a squeeze of an uncommon flap counts, next to one of the flaps that `sample_scene` draws."""
FOLDS = 5
START = {"normal": (0.11, 0.8, 0.1, 0.07), "strain": (0.09, 0.9, 0.3, 0.12)}
P = {name: i for i, name in enumerate(COLUMNS)}


class Squeezes:
    """All squeezes on disk."""

    def __init__(self) -> None:
        self.flaps: list[tuple[Any, ...]] = []
        rows, weights, groups = [], [], []
        for name in ("fit", "squeezes"):
            for motion in stored(name):
                scene = scene_of(name, motion["seed"])
                tissue = scene.tissue
                unit = tissue.modulus * tissue.depth * scene.jaws.width
                for state in motion["states"]:
                    if state[P["progress"]] > 1:
                        break
                    c = 1 - state[P["separation"]] / tissue.height
                    self.flaps.append((flap_numbers(scene), *veins_of(tissue), motion["x"], c))
                    rows.append(
                        [
                            np.log((state[P["N1"]] + state[P["N2"]]) / 2 / unit / c),
                            np.log(state[P["strain"]] / c),
                        ]
                    )
                    weights.append(1.0 if name == "fit" else OTHER)
                    groups.append(motion["seed"])
        self.target, self.weight, self.group = np.array(rows).T, np.array(weights), np.array(groups)

    def features(self, shape: Array) -> Array:
        """(squeezes, features)."""
        out = np.empty((len(self.flaps), len(grip.FEATURES)))
        for row, (flap, vertices, offsets, moduli, x, c) in zip(out, self.flaps, strict=True):
            grip.features(flap, vertices, offsets, moduli, x, c, shape, row)
        return out


def weighted(X: Array, y: Array, weight: Array) -> Array:
    """Weights of a linear fit that outliers do not pull, (features,)."""
    w = weight
    for _ in range(5):
        found = np.linalg.lstsq(X * w[:, None], y * w, rcond=None)[0]
        w = weight / np.sqrt(1 + ((X @ found - y) / OUTLIER) ** 2)
    return found


def law(squeezes: Squeezes, target: Array, start: Sequence[float]) -> tuple[Array, Array, Array]:
    """Shape, weights, and the residuals of cross-validation, of the logarithm."""

    def residuals(shape: Array) -> Array:
        X = squeezes.features(np.abs(shape))
        return np.arcsinh((X @ weighted(X, target, squeezes.weight) - target) * squeezes.weight / OUTLIER)

    shape = np.abs(least_squares(residuals, start, diff_step=1e-2, max_nfev=15).x)
    X = squeezes.features(shape)
    unseen = np.empty_like(target)
    for fold in range(FOLDS):
        out = squeezes.group % FOLDS == fold
        unseen[out] = X[out] @ weighted(X[~out], target[~out], squeezes.weight[~out]) - target[out]
    return shape, weighted(X, target, squeezes.weight), unseen


def main(arguments: Sequence[str] | None = None) -> None:
    squeezes = Squeezes()
    data: dict[str, Any] = {}
    for name, target in zip(("normal", "strain"), squeezes.target, strict=True):
        progress(f"fitting the law of {name}")
        shape, weights, unseen = law(squeezes, target, START[name])
        data[name] = {"shape": shape.round(5).tolist(), "weights": weights.round(6).tolist()}
        print(name, np.percentile(unseen, [0, 5, 50, 95, 100]).round(4), unseen.std())
    data["held"] = {"weights": [1.0, 0.95, -0.013, -16.0, -12.0, 0.27, -0.6]}
    grip.FITTED.write_text(json.dumps(data, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    on_one_thread("benchmarks.rod_grip", sys.argv[1:])
    main()
