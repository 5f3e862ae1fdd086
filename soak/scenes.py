"""Scenes from ranges far wider than those of `sample_scene`, as plain data: some are to be refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Outline = list[list[float]]

SEED = 141_000_000
MOST_VEINS = 40
GAP = 1e-4
"""m, between veins that do not touch"""
NARROWEST = 2e-4
"""m, of a vein; thinner ones are refused"""


def wide_scene(number: int) -> dict[str, Any]:
    """One of endlessly many, always the same for a number.

    0.5 to 20 mm thick, 500 Pa to 10 MPa, veins up to 1000 times as stiff or as soft as 1/10, none to 40 of
    them: inside, at a surface, through the whole height or touching one another. Lines of 5 to 90 degrees, B
    near either end, gravity up to 50 m/s^2, with or without a bed, jaws of every width, friction .01 to 3. A
    tenth is of Fung's law.
    """
    rng = np.random.default_rng(SEED + number)
    height = _log(rng, 5e-4, 2e-2)
    length = height * _log(rng, 4.0, 30.0)
    modulus = _log(rng, 5e2, 1e7)
    width = length * _log(rng, 2e-3, 0.249)
    depth = _log(rng, 1e-3, 5e-2)
    target = -length * float(
        rng.choice([rng.uniform(0.005, 0.1), rng.uniform(0.1, 0.9), rng.uniform(0.9, 0.995)])
    )
    slope = math.radians(rng.uniform(5.0, 90.0))
    far = 2.0 * length + height / math.sin(slope)
    return {
        "name": f"wide {number}",
        "tissue": {
            "length": length,
            "height": height,
            "depth": depth,
            "density": float(rng.choice([0.0, 1000.0, 2000.0], p=[0.1, 0.8, 0.1])),
            "modulus": modulus,
            "poisson": float(rng.choice([rng.uniform(0.0, 0.4), 0.45, 0.49])),
            "veins": _veins(rng, length, height, modulus),
        },
        "line_of_sight": {
            "camera": [target - far * math.cos(slope), far * math.sin(slope)],
            "target": [target, 0.0],
        },
        "limits": {"strain": float(rng.uniform(0.05, 0.95)), "friction": _log(rng, 0.01, 3.0)},
        "jaws": {
            "width": width,
            "depth": None if rng.random() < 0.7 else depth * float(rng.uniform(0.1, 1.0)),
            "in_sight": bool(rng.random() < 0.2),
        },
        "gravity": float(rng.choice([0.0, 9.8, rng.uniform(0.0, 50.0)])),
        "bed": bool(rng.random() < 0.8),
        "material": {"law": "fung", "stiffening": _log(rng, 0.5, 20.0)} if number % 10 == 9 else {},
    }


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _veins(rng: np.random.Generator, length: float, height: float, modulus: float) -> list[dict[str, Any]]:
    """Side by side along the flap, each in a part of the length of its own."""
    count = int(rng.integers(0, MOST_VEINS + 1)) if rng.random() < 0.85 else 0
    if count == 0:
        return []
    ends = np.sort(rng.uniform(-length, 0.0, count + 1))
    touching = rng.random() < 0.1  # which no scene may have
    gap = 0.0 if touching else GAP
    veins = []
    for left, right in zip(ends[:-1] + gap / 2, ends[1:] - gap / 2, strict=True):
        if right - left < NARROWEST:
            continue
        right = min(right, left + 1.5 * height)
        outline = _outline(rng, float(left), float(right), height)
        stiffer = _log(rng, 1.0, 1e3) if rng.random() < 0.85 else _log(rng, 0.1, 1.0)
        veins.append(
            {"outline": outline, "modulus": min(1e8, max(100.0, stiffer * modulus)), "poisson": 0.45}
        )
    return veins


def _outline(rng: np.random.Generator, left: float, right: float, height: float) -> Outline:
    """An oval inside the flap, a strip through its height, or a box at one of its surfaces."""
    kind = rng.choice(["oval", "strip", "floor", "roof"], p=[0.7, 0.1, 0.1, 0.1])
    if kind == "oval":
        thick = max(float(rng.uniform(0.2, 0.8)) * height, (right - left) / 6, 0.4 * NARROWEST)
        low = float(rng.uniform(0.1, 0.9 - thick / height)) * height
        high = low + thick
        turns = np.linspace(0.0, 2 * math.pi, int(rng.integers(5, 24)), endpoint=False)
        x = (left + right) / 2 + (right - left) / 2 * np.cos(turns)
        y = (low + high) / 2 + (high - low) / 2 * np.sin(turns)
        found: Outline = np.stack([x, y], axis=-1).tolist()
        return found
    reach = float(rng.uniform(0.1, 0.9)) * height
    low, high = {"strip": (0.0, height), "floor": (0.0, reach), "roof": (height - reach, height)}[str(kind)]
    return [[left, low], [right, low], [right, high], [left, high]]
