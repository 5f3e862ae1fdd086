"""A motion and its scene as the data that the page's script reads: lengths in mm, arrays packed small."""

from __future__ import annotations

import base64
import math
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.pictures.page.motion import Motion, depth_rows
from retract_env.drawing.shapes import JawShapes, sight_reach

if TYPE_CHECKING:
    from retract_env.scene import Scene

MM = 1e3
LEVELS = 65535
"""Steps of a coordinate between its least and greatest value: 2 micrometres where a flap moves over 0.1 m."""


def packed(values: ArrayLike, kind: str) -> dict[str, Any]:
    """An array as text: its shape, its kind of number and its bytes, compressed.

    kind: "u1", "i2" or "u4". Of what changes over the first axis, time, second differences are kept, which
    wrap round: they are small where motion is smooth.
    """
    array = np.ascontiguousarray(values, dtype="<" + kind)
    order = 0
    if kind != "u4" and array.ndim > 1:
        order = 2
        for _ in range(order):
            array = np.diff(array, axis=0, prepend=np.zeros_like(array[:1]))
    data = zlib.compress(np.ascontiguousarray(array).tobytes(), 9)
    return {"kind": kind, "shape": list(array.shape), "order": order, "data": base64.b64encode(data).decode()}


def numbers(values: ArrayLike, digits: int = 5) -> list[Any]:
    """Plain rounded numbers; null for nan, "inf" for what has no bound."""
    return [_number(value, digits) for value in np.asarray(values, float).tolist()]


def _number(value: Any, digits: int) -> Any:
    if isinstance(value, list):
        return [_number(one, digits) for one in value]
    if math.isnan(value):
        return None
    return round(value, digits) if math.isfinite(value) else "inf"


def motion_data(motion: Motion) -> dict[str, Any]:
    """All that the page needs to draw a motion."""
    surface, shapes = motion.surface, motion.shapes * MM
    low, high = shapes.min(axis=(0, 1, 2)), shapes.max(axis=(0, 1, 2))
    size = np.maximum(high - low, 1e-6)
    whole = np.round((shapes - low) / size * LEVELS).astype(np.int64) - (LEVELS + 1) // 2
    # between its ends only what lies on a side of the flap or of a vein is seen
    sides = np.unique(surface.nodes[np.concatenate([surface.skin.ravel(), surface.walls.ravel()])])
    plane, along = depth_rows(motion.z)
    top = max(float(motion.strain.max()), 1e-6)
    return {
        "nodes": packed(surface.nodes, "u4"),
        "sides": packed(sides, "u4"),
        "faces": packed(surface.faces, "u4"),
        "inVein": packed(surface.in_vein, "u1"),
        "skin": packed(surface.skin, "u4"),
        "walls": packed(surface.walls, "u4"),
        "rings": [list(ring) for ring in surface.rings],
        "low": numbers(low),
        "size": numbers(size),
        "end": packed(whole[:, -1], "i2"),
        "inner": packed(whole[:, :-1][:, :, sides], "i2"),
        "rows": {"plane": numbers(plane), "along": numbers(along)},
        "strain": packed(np.round(motion.strain / top * 255), "u1"),
        "strainTop": top,
        "frameTime": numbers(motion.time[list(motion.shown)]),
        "time": numbers(motion.time),
        "jaws": numbers(motion.jaws * MM, 4),
        "curves": {
            "strain": numbers(motion.worst),
            "friction": numbers(motion.friction),
            "clearance": numbers(motion.clearance * MM, 4),
        },
    }


def scene_data(scene: Scene) -> dict[str, Any]:
    """What stands around the flap, mm, and the limits."""
    tissue, line, jaws = scene.tissue, scene.line_of_sight, scene.jaws
    camera, target = np.array(line.camera), np.array(line.target)
    distance = float(np.linalg.norm(camera - target))
    away = (camera - target) / distance
    reach = sight_reach(target, away, distance, -1.15 * tissue.length, 0.72 * tissue.length)
    fingers, pads = JawShapes(scene).at((0.0, 0.0, 0.0, 1.0))
    return {
        "length": tissue.length * MM,
        "height": tissue.height * MM,
        "depth": tissue.depth * MM,
        "bed": scene.bed,
        "camera": numbers(camera * MM, 3),
        "target": numbers(target * MM, 3),
        "sight": numbers((target + reach * away) * MM, 3),
        "cameraShown": bool(reach > distance - 1e-9),
        "jawDepth": (jaws.depth or tissue.depth) * MM,
        # of the lower jaw, at the origin and pointing down
        "pad": numbers(pads[0][:-2] * MM, 4),
        "finger": numbers(fingers[0][:-2] * MM, 4),
        "limits": {
            "strain": scene.limits.strain,
            "friction": scene.limits.friction,
            "clearance": scene.limits.clearance * MM,
        },
    }


def palette_data() -> dict[str, Any]:
    """The colours of every picture, for the page."""
    from retract_env.drawing import palette

    names = (
        "INK", "GREY", "STEEL", "TISSUE", "VEIN", "VEIN_EDGE", "SIGHT", "VALUE", "LIMIT", "GROUND", "HATCH",
    )  # fmt: skip
    return {
        **{name: getattr(palette, name) for name in names},
        "STRAIN": palette.STRAIN.tobytes().hex(),
    }


def unpacked(data: dict[str, Any]) -> NDArray[np.int64]:
    """The inverse of `packed`, as the page's script does it."""
    raw = zlib.decompress(base64.b64decode(data["data"]))
    array = np.frombuffer(raw, "<" + data["kind"]).reshape(data["shape"])
    for _ in range(data["order"]):
        array = np.cumsum(array, axis=0, dtype=array.dtype)
    return array.astype(np.int64)
