"""The pictures show what the states say; the flap here is bent by formula, so that no solver is needed."""

from __future__ import annotations

import dataclasses
import io
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from PIL import Image

from baselines.animation import animate_retraction
from baselines.drawing import SectionTopology, hidden_area, strain_map
from baselines.pictures import draw_retraction, ranked, retraction_figure, verdict
from planners.spring import SpringModel
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, SectionMesh, section_mesh
from retract_env.physics.base import TissueState
from retract_env.scene import LineOfSight, Scene, Tissue, Vein

LENGTH, HEIGHT = 0.05, 0.0044


def scene_with(veins: int) -> Scene:
    """The paper's flap with round veins along it; B at 25 % of the length from the fixed end."""
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    pitch = LENGTH / (veins + 1)
    outlines = []
    for i in range(veins):
        radius = min(0.36 * pitch, 1.5e-3) * (0.75 + 0.25 * math.sin(3.0 * i + 1.0))
        centre = (-LENGTH + (i + 1) * pitch, HEIGHT / 2 + 0.5e-3 * math.cos(2.0 * i))
        outlines.append(tuple((centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in turn))
    tissue = Tissue(
        length=LENGTH, height=HEIGHT, depth=HEIGHT, density=1000.0, modulus=40e3, poisson=0.45,
        veins=tuple(Vein(outline=o, modulus=200e3) for o in outlines),
    )  # fmt: skip
    return Scene(
        name=f"{veins}_veins", tissue=tissue, line_of_sight=LineOfSight.at(-0.25 * LENGTH, math.pi / 4)
    )


def bent(scene: Scene, section: SectionMesh, grasp: Grasp, squeeze: float, curvature: float, progress: float) -> TissueState:
    """Constant curvature of the medial axis (Sec. IV-D), pinched near the jaws; strain from curvature and pinch."""
    arc, y = -section.points[:, 0], section.points[:, 1]
    delta = squeeze * grasp.compression

    def place(s: Any, y: Any) -> np.ndarray:
        pinch = np.exp(-(((s + grasp.x) / (0.8 * HEIGHT)) ** 2)) * delta / HEIGHT
        radius = 1.0 / max(curvature, 1e-9)
        across = HEIGHT / 2 + (y - HEIGHT / 2) * (1 - pinch)
        phi = s / (radius - HEIGHT / 2)
        # R - (R - y) cos(phi), without the cancellation at large R
        return np.stack((-(radius - across) * np.sin(phi), 2 * radius * np.sin(phi / 2) ** 2 + across * np.cos(phi)), -1)

    points = place(arc, y)
    jaws = np.concatenate((place(-grasp.x, 0.0), place(-grasp.x, HEIGHT)))
    axis = (jaws[2:] - jaws[:2]) / np.linalg.norm(jaws[2:] - jaws[:2])
    at = section.points[section.triangles].mean(axis=1)
    strain = abs(at[:, 1] - HEIGHT / 2) * curvature * 0.9 + delta / HEIGHT * np.exp(-(((at[:, 0] - grasp.x) / (0.8 * HEIGHT)) ** 2))
    strain = strain * np.where(section.vein >= 0, 0.4, 1.0)
    camera, target = np.array(scene.line_of_sight.camera), np.array(scene.line_of_sight.target)
    along = (target - camera) / np.linalg.norm(target - camera)
    clearance = float(np.min((points - target) @ np.array([-along[1], along[0]])))
    return TissueState(
        points=points, strain=strain, jaws=jaws, reactions=np.stack((-axis, axis)), normals=np.stack((axis, -axis)),
        max_strain=float(np.quantile(strain, 0.99)), worst_at=at[np.argmax(strain)],
        required_friction=np.array([0.05 + 0.004 * curvature, 0.04 + 0.003 * curvature]) if squeeze else np.zeros(2),
        clearance=clearance, progress=progress,
    )  # fmt: skip


def plan_with(veins: int, reason: str = "ok", squeezes: int = 8, motions: int = 42, last: float = 48.0) -> Any:
    scene = scene_with(veins)
    model = SpringModel(scene.tissue)
    grasps = model.stable_grasps() if veins else [Grasp(x, 0.25 * HEIGHT) for x in np.linspace(-0.045, -0.01, 10)]
    grasp = min(grasps, key=lambda g: abs(g.x + 0.036))
    section = section_mesh(scene, grasp.x, RESOLUTIONS["fine"])
    frames = [bent(scene, section, grasp, p, 0.0, p) for p in np.linspace(0.0, 1.0, squeezes + 1)]
    frames += [bent(scene, section, grasp, 1.0, last * p, 1.0 + p) for p in np.linspace(0.0, 1.0, motions + 1)[1:]]
    end = frames[-1]
    certificate = SimpleNamespace(
        certified=reason == "ok", reason=reason, max_strain=max(f.max_strain for f in frames), strain_limit=0.5,
        required_friction=float(np.max(end.required_friction)), friction_limit=0.5, clearance=end.clearance,
        increments=len(frames), frames=tuple(frames), section=section,
    )  # fmt: skip
    path = JawPath(np.array([frames[0].jaws, *(f.jaws for f in frames[squeezes:])]), "ctc")
    candidates = tuple(SimpleNamespace(grasp=g, reason=None, max_strain=0.3) for g in grasps)
    return SimpleNamespace(scene=scene, planner="ctc", grasp=grasp, path=path, certificate=certificate, candidates=candidates)
