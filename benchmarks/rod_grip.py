"""The rod's grip law, fitted to squeezes and motions on fine finite elements: python -m benchmarks.rod_grip.

Needs the sets `fit` and `squeezes` of `benchmarks.rod_motions`. Writes retract_env/rod/grip.json and says how
far off both laws of a squeeze are by cross-validation: every flap is judged by laws that never saw it. The
weights of `held` follow from the motions of `fit`, by states within the limits of strain and friction. With
--held the laws of a squeeze stay as they are.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks._report import on_one_thread, progress, table
from benchmarks.rod_batch import Course, follow, friction
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
START_HELD = np.array([1.16, 0.045, 0.89, 0.937, -0.009, -5.5, 0.163])
LOST = 5.0
"""What counts, after arcsinh, for a state that the rod does not get to."""
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
    return np.asarray(found)


def law(squeezes: Squeezes, target: Array, start: Sequence[float]) -> tuple[Array, Array, Array]:
    """Shape, weights, and the residuals of cross-validation, of the logarithm."""

    def residuals(shape: Array) -> Array:
        X = squeezes.features(np.abs(shape))
        off = X @ weighted(X, target, squeezes.weight) - target
        return np.asarray(np.arcsinh(off * squeezes.weight / OUTLIER))

    shape = np.abs(least_squares(residuals, start, diff_step=[1e-2] * len(start), max_nfev=15).x)
    X = squeezes.features(shape)
    unseen = np.empty_like(target)
    for fold in range(FOLDS):
        out = squeezes.group % FOLDS == fold
        unseen[out] = X[out] @ weighted(X[~out], target[~out], squeezes.weight[~out]) - target[out]
    return shape, weighted(X, target, squeezes.weight), unseen


class Motions:
    """The motions of `fit`: how far the rod is from them."""

    def __init__(self) -> None:
        self.courses, self.states = [], []
        for motion in stored("fit"):
            states = np.array(motion["states"]).reshape(-1, len(COLUMNS))
            scene = scene_of("fit", motion["seed"])
            within = (states[:, P["strain"]] <= scene.limits.strain) & (
                friction(states) <= scene.limits.friction
            )
            states = states[: int(np.argmin(np.append(within, False)))]
            if len(states):
                self.courses.append(Course(scene, motion["x"], states[:, 0], states[:, 1:5]))
                self.states.append(states)

    def residuals(self, laws: Array, held: Array) -> Array:
        """Clearance, normal force, and what friction has to carry, each over what is a usual residual."""
        found = []
        followed = follow(self.courses, (laws, held))
        for course, fine, rod in zip(self.courses, self.states, followed, strict=True):
            out = np.full((len(fine), 4), np.sinh(LOST))
            n = len(rod.states)
            a, b = fine[:n], rod.states
            total = a[:, P["N1"]] + a[:, P["N2"]]
            out[:n, 0] = (b - a)[:, P["clearance"]] / course.scene.tissue.length / 0.003
            out[:n, 1] = ((b - a)[:, P["N1"]] + (b - a)[:, P["N2"]]) / total / 0.03
            out[:n, 2] = ((b - a)[:, P["T1"]] - (b - a)[:, P["T2"]]) / total / 0.03
            out[:n, 3] = ((b - a)[:, P["T1"]] + (b - a)[:, P["T2"]]) / total / 0.03
            found.append(np.arcsinh(out[fine[:, 0] >= 1]))
        return np.concatenate(found).ravel()


def held_weights(motions: Motions, laws: Array, start: Array) -> Array:
    """Weights of HELD, those of START_HELD in size."""
    scale = np.abs(START_HELD)

    def residuals(v: Array) -> Array:
        return motions.residuals(laws, v * scale)

    found = least_squares(residuals, start / scale, diff_step=[0.03] * len(start), max_nfev=5)
    return np.asarray(found.x * scale)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--held", action="store_true", help="fit the weights of `held` alone")
    options = parser.parse_args(arguments)
    if options.held:
        data = json.loads(grip.FITTED.read_text("utf-8"))
    else:
        squeezes = Squeezes()
        data, rows = {}, []
        for name, target in zip(("normal", "strain"), squeezes.target, strict=True):
            progress(f"fitting the law of {name}")
            shape, weights, unseen = law(squeezes, target, START[name])
            data[name] = {"shape": shape.round(5).tolist(), "weights": weights.round(6).tolist()}
            for which, chosen in (
                ("as in retractions", squeezes.weight == 1),
                ("uncommon", squeezes.weight < 1),
            ):
                residual = unseen[chosen]
                quantiles = [f"{100 * v:.1f} %" for v in np.percentile(residual, [5, 50, 95])]
                rows.append(
                    [f"{name}, {which}", len(residual), *quantiles, f"{100 * np.abs(residual).max():.0f} %"]
                )
        print(table(["law, flaps", "squeezes", "5 %", "median", "95 %", "worst"], rows))
    laws = np.array([[*data[name]["shape"], *data[name]["weights"]] for name in ("normal", "strain")])
    progress("fitting the weights of a held flap")
    held = held_weights(Motions(), laws, START_HELD).round(4)
    data["held"] = {"weights": held.tolist()}
    print(table(["held", "weight"], list(zip(grip.HELD, held.tolist(), strict=True))))
    grip.FITTED.write_text(json.dumps(data, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    on_one_thread("benchmarks.rod_grip", sys.argv[1:])
    main(sys.argv[1:])
