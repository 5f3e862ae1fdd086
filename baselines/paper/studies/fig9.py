"""Fig. 9: one certified retraction of the wide flap, with pictures in space. Sec. V-E."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgb
from numpy.typing import NDArray

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.skins import Faces, skins
from baselines.paper.study import Claim, Report, Study, new_figure, number, paper_scene
from baselines.pictures.drawing import MM, strain_map
from planners import plan
from planners.certify import Trial
from retract_env.drawing.palette import GROUND, HATCH, INK, SIGHT, VEIN_EDGE
from retract_env.scene import Scene

Array = NDArray[np.float64]

PALE, INTEREST = "#eef0f2", "#bfe3d5"
WALL_TOP, WALL_FACE, WALL_SIDE = "#d9dde1", HATCH, "#bcc2c8"
LIGHT = np.array([-0.35, 0.8, 0.5])
AZIMUTH, ELEVATION = np.radians(38.0), np.radians(24.0)


class Camera:
    """Orthographic, looking down on the flap from the side of its free end."""

    def __init__(self, azimuth: float, elevation: float):
        """rad: from the z axis towards -x, and above the bed."""
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        self.right = np.array([ca, 0.0, sa])
        self.towards = np.array([-sa * ce, se, ca * ce])
        self.up = np.cross(self.towards, self.right)

    def flat(self, points: Array) -> Array:
        """(..., 3) to (..., 2) on the picture."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


def draw_faces(axes: Axes, faces: Faces, camera: Camera, limit: float, colour: str | None = None) -> None:
    """Draw the faces that look at the camera, the nearest last, in mm.

    Coloured by strain up to `limit`, or all in one colour.
    """
    flat, depth, colours = [], [], []
    tint = strain_map()
    for corners, value in zip(faces["corners"], faces["strain"], strict=True):
        points = np.array(corners, float).reshape(-1, 3) * 1e-3
        normal = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(axis=0)
        if normal @ camera.towards <= 0:
            continue
        light = float(normal @ LIGHT) / float(np.linalg.norm(normal) * np.linalg.norm(LIGHT))
        flat.append(camera.flat(points))
        depth.append(float(points.mean(axis=0) @ camera.towards))
        colours.append(
            np.array(to_rgb(colour or tint(min(value / limit, 1.0)))) * (0.75 + 0.25 * max(0.0, light))
        )
    order = np.argsort(depth)
    axes.add_collection(
        PolyCollection(
            [flat[i] for i in order],
            facecolors=[tuple(colours[i]) for i in order],
            edgecolors="face",
            linewidths=0.3,
            zorder=3,
        )
    )


def cut_edges(faces: Faces) -> Array:
    """(k, 2, 3) mm, where a surface is cut on the near side of the flap: the edges of the faces there that no
    other one has."""
    found: dict[tuple[tuple[int, ...], ...], int] = {}
    for corners in faces["corners"]:
        points = np.array(corners).reshape(-1, 3)
        if len(points) == 6 and points[:, 2].min() > 0:  # a triangle of the section, with its middles
            ring = [tuple(p) for p in points.tolist()]
            for pair in zip(ring, ring[1:] + ring[:1], strict=True):
                edge = tuple(sorted(pair))
                found[edge] = found.get(edge, 0) + 1
    return np.array([edge for edge, count in found.items() if count == 1], float).reshape(-1, 2, 3) * 1e-3


def _draw_cut(axes: Axes, lines: Array, colour: str, width: float) -> None:
    axes.add_collection(
        LineCollection(list(lines), colors=colour, linewidths=width, zorder=3.2, capstyle="round")
    )


def _draw_place(axes: Axes, scene: Scene, camera: Camera) -> None:
    """Bed, area of interest and fixed end, mm."""
    half, length, height = scene.tissue.depth / 2 * MM, scene.tissue.length * MM, scene.tissue.height * MM
    target = scene.line_of_sight.target[0] * MM

    def sheet(corners: Sequence[tuple[float, float, float]], colour: str, zorder: float) -> None:
        flat = camera.flat(np.array(corners))
        axes.add_collection(PolyCollection([flat], facecolors=colour, edgecolors="none", zorder=zorder))

    far = 0.12 * length
    for a, b, reach, colour in ((-length - far, far, 1.25 * half, GROUND), (-length, target, half, INTEREST)):
        sheet([(a, 0, -reach), (b, 0, -reach), (b, 0, reach), (a, 0, reach)], colour, 1)
    sheet([(0, 0, -half), (0, height, -half), (0, height, half), (0, 0, half)], WALL_FACE, 2)
    sheet([(0, height, -half), (far, height, -half), (far, height, half), (0, height, half)], WALL_TOP, 2)
    sheet([(0, 0, half), (far, 0, half), (far, height, half), (0, height, half)], WALL_SIDE, 2)
    x, y = camera.flat(np.array([(target - length) / 2, 0.0, 0.35 * half]))
    axes.text(x, y, "area of interest", color=SIGHT, ha="center", va="center", zorder=2.5)


def _draw_jaws(axes: Axes, row: Row, scene: Scene, camera: Camera) -> None:
    """Both jaws as bars over the depth; the flap hides the one behind it."""
    ends = np.array(row["jaws"]).reshape(2, 2) * MM
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.array([axis[1], -axis[0]]) * scene.jaws.width * MM / 2
    half = (scene.jaws.depth or scene.tissue.depth) / 2 * MM
    for end, out in ((ends[1], 0.9 * axis), (ends[0], -0.9 * axis)):
        before = float(out @ camera.towards[:2]) > 0
        loop = np.array([end - across, end + across, end + across + out, end - across + out])
        near, far = (np.column_stack([loop, np.full(4, z)]) for z in (half, -half))
        sides = [near] + [np.array([near[i], far[i], far[i - 1], near[i - 1]]) for i in range(4)]
        sides.sort(key=lambda side: float(side.mean(axis=0) @ camera.towards))
        flat = [camera.flat(side) for side in sides]
        axes.add_collection(
            PolyCollection(
                flat, facecolors=INK, edgecolors="white", linewidths=0.4, zorder=3.5 if before else 2.8
            )
        )


def solid(resolution: str, scene: Any) -> Row:
    """One retraction of a deep flap, from the grasp that is best where the flap is as deep as high."""
    deep = Scene.from_data(scene)
    narrow = deep.tissue.model_copy(update={"depth": deep.tissue.height})
    best = plan(deep.model_copy(update={"tissue": narrow}), "ctc", resolution, 1)
    start, cpu = time.perf_counter(), time.process_time()
    trial = Trial(deep, best.grasp, best.path, resolution)
    trial.squeeze()
    trial.move()
    spent, spent_cpu = time.perf_counter() - start, time.process_time() - cpu
    certificate = trial.certificate()
    skin, veins = skins(trial)
    return {
        "x": trial.grasp.x,
        "compression": trial.grasp.compression,
        "reason": certificate.reason,
        "max_strain": certificate.max_strain,
        "narrow_strain": best.certificate.max_strain,
        "required_friction": certificate.required_friction,
        "clearance": certificate.clearance,
        "increments": certificate.increments,
        "nodes": certificate.mesh["nodes"],
        "cpu_seconds": spent_cpu,
        "wall_seconds": spent,
        "jaws": trial.frames[-1].jaws.tolist(),
        "skin": skin,
        "veins": veins,
    }


def _experiments() -> list[Experiment]:
    return [Experiment(solid, {"scene": paper_scene("wide").dump()})]


def _report(rows: Sequence[Row]) -> Report:
    (row,) = rows
    scene = paper_scene("wide")
    limit = scene.limits.strain
    figure = new_figure(8.0, 9.0)
    camera = Camera(AZIMUTH, ELEVATION)
    panels = figure.subplots(2, 1)
    for axes, title in zip(panels, ("strain on the surface", "strain on the veins"), strict=True):
        _draw_place(axes, scene, camera)
        axes.set_title(title)
        axes.set_aspect("equal")
        axes.set_axis_off()
    draw_faces(panels[0], row["skin"], camera, limit)
    _draw_jaws(panels[0], row, scene, camera)
    draw_faces(panels[1], row["skin"], camera, limit, colour=PALE)
    draw_faces(panels[1], row["veins"], camera, limit)
    veins, skin = (camera.flat(cut_edges(row[name])) for name in ("veins", "skin"))
    for axes in panels:
        _draw_cut(axes, veins, VEIN_EDGE, 0.8)
        _draw_cut(axes, skin, INK, 0.9)
        axes.autoscale_view()
    bar = ScalarMappable(Normalize(0.0, limit), strain_map())
    figure.colorbar(bar, ax=list(panels), shrink=0.5, label="strain, up to its limit")
    certified = row["reason"] == "ok"
    strain, friction = number(row["max_strain"]), number(row["required_friction"])
    found = (
        f"{'certified' if certified else row['reason']}: grasp at {row['x'] * MM:.1f} mm, strain "
        f"{strain:.3f} of {limit:g}, friction {friction:.2f} of {scene.limits.friction:g}"
    )
    flap = f"{scene.tissue.depth * MM:.0f} mm"
    claims = [
        Claim(f"a flap {flap} deep with 20 veins is retracted", found, "yes" if certified else "no"),
    ]
    notes = [
        f"{row['nodes']} nodes over half the depth, {row['increments']} increments, "
        f"{row['cpu_seconds']:.0f} s of processor time. The same grasp strains the flap that is as deep as "
        f"high by {number(row['narrow_strain']):.3f}.",
    ]
    return Report(
        "Fig. 9: the wide flap",
        f"The flap of twenty veins, {flap} deep, is retracted by CTC with jaws over its whole depth, from "
        "the grasp that is best where it is 4.4 mm deep. Above the surface, below the veins in the pale "
        "flap; where the flap ends, its outline and those of the veins.",
        [{k: v for k, v in row.items() if k not in ("skin", "veins", "jaws")}],
        figure,
        claims,
        notes,
    )


STUDY = Study("fig9", "the wide flap", _experiments, _report)
