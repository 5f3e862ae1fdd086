"""The three objectives of a retraction, defined once: visibility, strain and security. Sec. III-C.

Pure functions of arrays. The certifier, the environment and all reports use these and no others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WORST_FRACTION = 0.01
"""Share of the volume that eps_1% averages over."""


def strain(stretches: ArrayLike) -> Array:
    """Largest principal strain in magnitude, max |stretch - 1|.

    stretches: (..., 3) principal stretches. Returns (...,).
    """
    return np.abs(np.asarray(stretches, float) - 1.0).max(axis=-1)


def worst_mean(strains: ArrayLike, volumes: ArrayLike, fraction: float = WORST_FRACTION) -> float:
    """eps_1%: volume-weighted mean strain of the given fraction of volume that is strained most.

    strains, volumes: (n,), volumes in any unit. The last piece counts with the part of its volume that is
    still needed.
    """
    strains, volumes = np.ravel(strains), np.ravel(volumes)
    wanted = fraction * volumes.sum()
    order = np.argsort(strains)[::-1]
    before = np.concatenate([[0.0], np.cumsum(volumes[order])[:-1]])
    share = np.clip(wanted - before, 0.0, volumes[order])
    return float(share @ strains[order] / wanted)


def required_friction(reaction: ArrayLike, normal: ArrayLike) -> Array:
    """Least Coulomb coefficient that holds each jaw.

    reaction: (..., 2) N, tissue on jaw; normal: (..., 2) unit, into the tissue.
    Returns (...,); inf where a jaw pulls.
    """
    reaction, normal = np.asarray(reaction, float), np.asarray(normal, float)
    pressure = -(reaction * normal).sum(axis=-1)
    tangential = np.abs(reaction[..., 0] * normal[..., 1] - reaction[..., 1] * normal[..., 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(pressure > 0, tangential / pressure, np.inf)


def clearance(points: ArrayLike, camera: ArrayLike, target: ArrayLike) -> float:
    """Signed distance, m, of the lowest point to line AB: negative while one lies below it, on the camera's
    side.

    points: (..., 2) m; camera A and target B: (2,) m.
    """
    points, camera, target = (np.asarray(p, float) for p in (points, camera, target))
    along = (camera - target) / np.hypot(*(camera - target))
    away = points - target
    return float((away[..., 0] * along[1] - away[..., 1] * along[0]).min())
