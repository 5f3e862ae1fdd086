"""The flap before it is touched: no physics is needed to know it."""

from __future__ import annotations

import numpy as np

from retract_env.mesh import RESOLUTIONS, SectionMesh, section_mesh
from retract_env.objectives import clearance
from retract_env.physics.base import TissueState
from retract_env.scene import Scene


def rest_section(scene: Scene) -> SectionMesh:
    """The flap's outline as a mesh of two triangles, without its veins: enough for a flap at rest."""
    length, height = scene.tissue.length, scene.tissue.height
    x, y = np.meshgrid([-length, -length / 2, 0.0], [0.0, height / 2, height], indexing="ij")
    ends = np.array([0, 6], np.int32)
    return SectionMesh(
        points=np.stack([x.ravel(), y.ravel()], axis=1),
        triangles=np.array([[0, 6, 8, 3, 7, 4], [0, 8, 2, 4, 5, 1]], np.int32),
        vein=np.full(2, -1, np.int32),
        fixed=np.array([6, 7, 8], np.int32),
        patches=(ends[:0], ends[:0]),
        bottom=np.array([0, 3, 6], np.int32),
        bottom_length=length * np.array([1, 4, 1]) / 6,
    )


def rest_state(scene: Scene, section: SectionMesh) -> TissueState:
    """The flap at rest on any section, the gripper open in front of its free end."""
    length, height, width = scene.tissue.length, scene.tissue.height, scene.jaws.width
    line = scene.line_of_sight
    return TissueState(
        points=section.points,
        strain=np.zeros(len(section.triangles)),
        jaws=np.array([-length - width, 0.0, -length - width, height]),
        reactions=np.zeros((2, 2)),
        normals=np.array([[0.0, 1.0], [0.0, -1.0]]),
        worst_strain=0.0,
        worst_at=np.array([0.0, 0.0]),
        required_friction=np.zeros(2),
        clearance=clearance(section.points, line.camera, line.target),
        progress=0.0,
    )


def rest_mesh(scene: Scene) -> SectionMesh:
    """The flap with its veins before the jaws touch it, to be drawn. Raises MeshError."""
    return section_mesh(scene, None, RESOLUTIONS["coarse"])
