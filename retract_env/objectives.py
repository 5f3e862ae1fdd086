"""The three objectives of a retraction, defined once: visibility, strain and security. Sec. III-C.

Pure functions of arrays, and the one decision on what has become of a retraction. The certifier, the
environment and all reports use these and no others.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Verdict = Literal["strain", "release", "slip", "contact", "ok"]

WORST_FRACTION = 0.01
"""Share of the volume that eps_1% averages over."""


IN_BLOCK = 0.02
"""Part of the height that tissue has to be inside the fixed block to count. The block's push is a penalty;
flaps like the paper's that come to lie on it sink in by half a hundredth. PyBullet knows no block."""


def strain(stretches: ArrayLike) -> Array:
    """Largest principal strain in magnitude, max |stretch - 1|.

    stretches: (..., 3) principal stretches. Returns (...,).
    """
    off = np.abs(np.asarray(stretches, float) - 1.0)
    return np.maximum(np.maximum(off[..., 0], off[..., 1]), off[..., 2])


def worst_mean(strains: ArrayLike, volumes: ArrayLike, fraction: float = WORST_FRACTION) -> float:
    """eps_1%: volume-weighted mean strain of the given fraction of volume that is strained most.

    strains, volumes: (n,), volumes in any unit. The last piece counts with the part of its volume that is
    still needed.
    """
    strains, volumes = np.ravel(strains), np.ravel(volumes)
    most = float(strains.max())
    if not most < np.inf:  # nor is a share of nothing of it a number
        return most
    wanted = fraction * volumes.sum()
    count = min(len(strains), int(3 * fraction * len(strains)) + 1)
    while True:  # as many of the worst as have that volume; to sort them all would take far longer
        worst = np.argpartition(strains, len(strains) - count)[len(strains) - count :]
        if count == len(strains) or volumes[worst].sum() >= wanted:
            break
        count = min(len(strains), 3 * count)
    strains, volumes = strains[worst], volumes[worst]
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


def inside_block(points: ArrayLike, height: float, least: float) -> bool:
    """Whether a point lies inside the block x > 0, y < height that holds the fixed end, m.

    points: (..., 2) m; least: m, how deep inside it has to be to count.
    """
    points = np.asarray(points, float)
    depth = np.minimum(points[..., 0], height - points[..., 1])
    return bool((depth > least).any())


def bed_hits(points: ArrayLike, camera: ArrayLike) -> Array:
    """Where rays from the camera through points meet the bed y = 0, m.

    points: (..., 2) m, those below the bed count as on it; camera A: (2,) m. Returns (...,), infinite, on the
    point's side, for points that are not below the camera.
    """
    points, (ax, ay) = np.asarray(points, float), np.asarray(camera, float)
    drop = ay - np.maximum(points[..., 1], 0.0)
    aside = points[..., 0] - ax
    below = drop > 0
    found: Array = np.where(below, ax + aside * ay / np.where(below, drop, 1.0), np.copysign(np.inf, aside))
    return found


def seen_spans(outline: ArrayLike, camera: ArrayLike, near: float, far: float) -> Array:
    """Parts of the bed from x = near to x = far, m, that the camera sees past the tissue, ascending.

    outline: (..., k, 2) m, k points in a row of each piece of the tissue's outline; an edge hides the bed
    between the rays through its two ends. camera A: (2,) m. Returns (s, 2) m.
    """
    outline, (ax, ay) = np.asarray(outline, float), np.asarray(camera, float)
    p, q = outline[..., :-1, :].reshape(-1, 2), outline[..., 1:, :].reshape(-1, 2)
    hits = bed_hits(outline, camera)
    a, b = hits[..., :-1].ravel(), hits[..., 1:].ravel()
    crosses = np.isinf(a) != np.isinf(b)
    if crosses.any():  # on its way up past the camera, an edge leaves on the side where it is level with it
        p, q = p[crosses], q[crosses]
        level = p[:, 0] + (q[:, 0] - p[:, 0]) * (ay - p[:, 1]) / (q[:, 1] - p[:, 1])
        away = np.copysign(np.inf, level - ax)
        a[crosses] = np.where(np.isinf(a[crosses]), away, a[crosses])
        b[crosses] = np.where(np.isinf(b[crosses]), away, b[crosses])
    hides = ~(np.isinf(a) & np.isinf(b))
    a, b = np.clip(a[hides], near, far), np.clip(b[hides], near, far)
    begins = np.minimum(a, b)
    order = np.argsort(begins)
    hidden_to = np.maximum.accumulate(np.concatenate([[near], np.maximum(a, b)[order]]))
    next_begins = np.concatenate([begins[order], [far]])
    free = next_begins > hidden_to
    return np.stack([hidden_to[free], next_begins[free]], axis=1)


def exposure(outline: ArrayLike, camera: ArrayLike, target: ArrayLike, near: float) -> float:
    """Fraction of the area of interest, the bed from x = near to the target, that the camera sees.

    outline: as for `seen_spans`; camera A and target B: (2,) m; near: m, where the flap ended at rest. It is
    1 wherever `clearance` is not negative.
    """
    far = float(np.asarray(target, float)[0])
    spans = seen_spans(outline, camera, near, far)
    return float(min(1.0, (spans[:, 1] - spans[:, 0]).sum() / (far - near)))


def verdict(
    max_strain: float,
    required_friction: ArrayLike,
    clearance: float,
    strain_limit: float,
    friction_limit: float,
    clearance_limit: float = 0.0,
    overlap: bool = False,
) -> Verdict | None:
    """What has become of a retraction in one state: a broken limit, success, or None while it goes on.

    max_strain: eps_1%; required_friction: of each closed jaw, 0 for open ones; clearance: m; overlap: whether
    tissue is where something else is. Limits come before success: "strain" torn, "release" a jaw pulls,
    "slip" it slides, "contact" tissue is where other tissue is, which nothing here computes, or deeper in the
    block that holds the fixed end than this yields, "ok" the target is in view.
    """
    friction = float(np.max(required_friction))
    if max_strain > strain_limit:
        return "strain"
    if np.isinf(friction):
        return "release"
    if friction > friction_limit:
        return "slip"
    if overlap:
        return "contact"
    return "ok" if clearance >= clearance_limit else None
