"""Veins with fewer corners for coarse meshes, whose elements must meet every corner.

Ten veins of ten corners make a mesh of 500 triangles, however coarse; as quadrilaterals of the same area they
make 220. Strain and friction of a retraction then differ from the true outlines' by less than the coarse mesh
errs anyway (tests/retract_env/mesh/test_outlines.py).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from retract_env.mesh.jaws import patch_ends
from retract_env.mesh.resolutions import Resolution
from retract_env.mesh.section import SectionMesh, section_mesh
from retract_env.scene import Scene
from retract_env.scene.veins import MIN_GAP, Outline

Array = NDArray[np.float64]


def area(points: Array) -> float:
    """Signed area, m^2, of a polygon (k, 2) m, positive counter-clockwise."""
    x, y = points.T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def with_corners(outline: Outline, corners: int) -> Outline:
    """The outline with that many corners at most, of the same area and centroid.

    Corners are left out one at a time, the one whose triangle with its neighbours is smallest first
    (Visvalingam 1993). The result may cross itself where the outline is far from convex.
    """
    points = np.array(outline)
    while len(points) > corners:
        edges = np.roll(points, 1, axis=0) - points, np.roll(points, -1, axis=0) - points
        triangle = np.abs(edges[0][:, 0] * edges[1][:, 1] - edges[0][:, 1] * edges[1][:, 0])
        points = np.delete(points, int(triangle.argmin()), axis=0)
    if len(points) == len(outline):
        return outline
    ratio = area(np.array(outline)) / area(points)
    if not ratio > 0:
        return outline
    points = (points - _centroid(points)) * np.sqrt(ratio) + _centroid(outline)
    return tuple((x, y) for x, y in points.tolist())


def _centroid(points: ArrayLike) -> Array:
    found: Array = shapely.get_coordinates(shapely.centroid(shapely.polygons(np.asarray(points).tolist())))[0]
    return found


def reaching(scene: Scene, low: float, high: float) -> set[int]:
    """Indices of the veins that have part of the flap's length in common with [low, high], m."""
    spans = [[corner[0] for corner in vein.outline] for vein in scene.tissue.veins]
    return {i for i, x in enumerate(spans) if min(x) <= high and max(x) >= low}


def fewer_corners(scene: Scene, corners: int, kept: Collection[int] = ()) -> Scene:
    """The scene with veins of that many corners at most, one by one, where the mesher still has room.

    kept: indices of veins that stay as they are. A vein also keeps its outline where it lies on the flap's
    own outline, or where the simpler one would come nearer than `MIN_GAP` to another vein or to the flap's
    outline, or cross itself.
    """
    veins = list(scene.tissue.veins)
    simplified = [i for i, vein in enumerate(veins) if len(vein.outline) > corners and i not in kept]
    if not simplified:
        return scene
    inside = shapely.box(-scene.tissue.length + MIN_GAP, MIN_GAP, -MIN_GAP, scene.tissue.height - MIN_GAP)
    polygons = np.array([shapely.polygons(vein.outline) for vein in veins])
    for i in simplified:
        vein = veins[i]
        outline = with_corners(vein.outline, corners)
        polygon = shapely.polygons(outline)
        near = shapely.dwithin(polygon, polygons, MIN_GAP)
        near[i] = False
        if inside.contains(polygon) and not near.any() and polygon.is_valid:
            polygons[i] = polygon
            veins[i] = vein.model_copy(update={"outline": outline})
    # what was checked above need not be checked again
    return scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"veins": tuple(veins)})})


def resolved_section(scene: Scene, jaw_x: float, resolution: Resolution) -> SectionMesh:
    """The section with jaws at jaw_x, m, its veins as exact there and elsewhere as the resolution asks.

    Raises MeshError, and ValueError as `patch_ends`.
    """
    height, (low, high) = scene.tissue.height, patch_ends(scene, jaw_x)
    near, far = resolution.true_veins * height, resolution.followed * height
    smeared = set(range(len(scene.tissue.veins))) - reaching(scene, low - far, high + far)
    drawn = scene
    if resolution.vein_corners is not None:
        as_drawn = smeared | reaching(scene, jaw_x - near, jaw_x + near)
        drawn = fewer_corners(scene, resolution.vein_corners, as_drawn)
    return section_mesh(drawn, jaw_x, resolution, smeared)
