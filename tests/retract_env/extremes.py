"""Flaps at the corners of what a scene may be."""

from __future__ import annotations

from itertools import product
from typing import Any

from retract_env.scene import Scene
from retract_env.task import default_scene

EXTREMES: dict[str, tuple[float, float]] = {
    "length": (2e-3, 0.5),
    "height": (2e-4, 0.05),
    "depth": (1e-4, 0.5),
    "density": (0.0, 2e4),
    "modulus": (100.0, 1e8),
    "poisson": (0.0, 0.49),
}
CORNERS = list(product((0, 1), repeat=len(EXTREMES)))


def scene_with(**parts: Any) -> Scene:
    """The paper's flap, with parts that differ: mappings change what they name, others replace."""
    data = default_scene().dump()
    for name, value in parts.items():
        data[name] = {**(data.get(name) or {}), **value} if isinstance(value, dict) else value
    return Scene.from_data(data)


def corner(number: int, jaw: float = 1e-3) -> Scene:
    """One of CORNERS, under ten times gravity; jaw: width over the flap's length."""
    sides = CORNERS[number]
    tissue = {name: ends[side] for (name, ends), side in zip(EXTREMES.items(), sides, strict=True)}
    length, height = tissue["length"], tissue["height"]
    line = {"camera": [-1.2 * length, length + height], "target": [-0.3 * length, 0.0]}
    return scene_with(tissue=tissue, line_of_sight=line, jaws={"width": jaw * length}, gravity=100.0)
