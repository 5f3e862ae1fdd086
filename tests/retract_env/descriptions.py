"""Scenes as plain data, changed here and there, and the one line in which they are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from retract_env.errors import SceneError

LENGTH, HEIGHT = 0.05, 0.0044  # m
SQUARE = [[-0.026, 0.001], [-0.024, 0.001], [-0.024, 0.003], [-0.026, 0.003]]


def plain(**changes: Any) -> dict[str, Any]:
    """A scene as data; a key like tissue__height replaces one value, and ... removes it."""
    data: dict[str, Any] = {
        "name": "case",
        "tissue": {
            "length": LENGTH,
            "height": HEIGHT,
            "depth": 0.0044,
            "density": 1000.0,
            "modulus": 4e4,
            "poisson": 0.45,
            "veins": [],
        },
        "line_of_sight": {"camera": [-0.0825, 0.07], "target": [-0.0125, 0.0]},
    }
    for path, value in changes.items():
        *parents, key = path.split("__")
        place = data
        for parent in parents:
            place = place.setdefault(parent, {})
        if value is ...:
            del place[key]
        else:
            place[key] = value
    return data


def with_veins(*outlines: Any) -> dict[str, Any]:
    return plain(tissue__veins=[{"outline": outline, "modulus": 2e5} for outline in outlines])


def moved(outline: Any, dx: float = 0.0, dy: float = 0.0) -> list[list[float]]:
    return [[x + dx, y + dy] for x, y in outline]


def box(left: float, right: float, low: float, high: float) -> list[list[float]]:
    return [[left, low], [right, low], [right, high], [left, high]]


def complaint(call: Callable[[], object]) -> str:
    """The message of the SceneError that call raises: one line."""
    with pytest.raises(SceneError) as caught:
        call()
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message
