"""Infos of many environments, as `gymnasium.vector` has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.task.arrays import (
    COST,
    COST_FRICTION,
    COST_STRAIN,
    DRAW,
    EXPOSURE,
    FAILURE,
    IS_DRAWN,
    MOST_FRICTION,
    MOST_STRAIN,
    REWARD_TERMS,
    SUCCESS,
    TO_LINE,
)
from retract_env.task.rules import FAILURES, TERMS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_NAMES = np.array(FAILURES, dtype=object)


def infos_of(rows: Array, mask: Flags) -> dict[str, Any]:
    """Infos as `gymnasium.vector` has them, from rows (n, INFO); mask: (n,) which environments have any."""

    def told(values: NDArray[Any], kind: Any = np.float64) -> NDArray[Any]:
        out = values.astype(kind)
        out[~mask] = kind()
        return out

    failure = _NAMES[rows[:, FAILURE].astype(np.int64)]
    failure[~mask] = None
    cost = {"strain": told(rows[:, COST_STRAIN]), "friction": told(rows[:, COST_FRICTION])}
    terms = {name: told(rows[:, REWARD_TERMS + i]) for i, name in enumerate(TERMS)}
    plain = {
        "is_success": told(rows[:, SUCCESS], np.bool_),
        "failure": failure,
        "cost": told(rows[:, COST]),
        "cost_terms": _masked(cost, mask),
        "max_strain": told(rows[:, MOST_STRAIN]),
        "required_friction": told(rows[:, MOST_FRICTION]),
        "clearance": told(rows[:, TO_LINE]),
        "exposure": told(rows[:, EXPOSURE]),
        "reward_terms": _masked(terms, mask),
    }
    infos, drawn = _masked(plain, mask), mask & (rows[:, IS_DRAWN] > 0)
    if drawn.any():
        infos["unknowns"], infos["_unknowns"] = np.where(drawn[:, None], rows[:, DRAW:], 0.0), drawn
    return infos


def _masked(values: Mapping[str, Any], mask: Flags) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in values.items():
        out[name], out[f"_{name}"] = value, mask.copy()
    return out
