"""The scene in space, for `camera="3d"`, and what the camera A sees of it, for `view="camera"`.

One drawing for every physics: a state tells where the section is, and the flap is that section over its whole
depth. Drawn in memory, four times as many pixels as are shown; no display and no GPU is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from retract_env.drawing.gauges import Strip
from retract_env.drawing.lettering import Lettering
from retract_env.drawing.palette import (
    GREY,
    GROUND,
    HATCH,
    INK,
    LIMIT,
    SEEN_BED,
    SIGHT,
    STEEL,
    STRAIN,
    TISSUE,
    UNSEEN_BED,
    VEIN_EDGE,
    WALL,
    Bytes,
    rgb,
)
from retract_env.drawing.perspective import Pinhole, axes_ahead, from_afar, from_point
from retract_env.drawing.raster import Canvas
from retract_env.drawing.renderer import LETTERS, STRIP, check_size, unit_of, up_to
from retract_env.drawing.scenery import ABOVE, draw_camera, draw_scale, drawn_length, name_camera
from retract_env.drawing.shapes import JawShapes, SectionTopology
from retract_env.drawing.solids import GLOSS, LIGHT, FlapSolid, Solid, bar, lit
from retract_env.drawing.zbuffer import (
    FLOOR,
    INNER,
    SOLID,
    cast_shadow,
    draw_lines,
    fill_faces,
    halved,
)
from retract_env.objectives import seen_spans

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene

Array = NDArray[np.float64]

AZIMUTH, ELEVATION, OPENING = math.radians(26.0), math.radians(17.0), math.radians(20.0)
"""From where a frame is seen, by the angles of `axes_ahead`, and the angle from its bottom to its top."""
BED_AROUND, BED_BESIDE, BLOCK = 0.1, 1.6, 0.16
"""Over the flap's length, how far the bed is drawn before and behind it, and how long the fixed block is.
BED_BESIDE: how many times as far as before it the bed is drawn beside the flap."""
THROUGH, DIM = 0.55, 0.5
"""How much of a vein shines through the skin that it touches, and over which part of the flap's height that
falls by e."""
SHADOW = 0.86
"""Light of the bed in the flap's shadow, over that beside it."""
ON_TOP = 2e-3
"""Of the distance, by which lines are drawn before the faces that they lie on."""


def _plain(colour: str) -> Bytes:
    return np.array([rgb(colour)], dtype=np.uint8)


class Place:
    """Bed, area of interest and fixed block before one eye: drawn once, then drawn on again and again."""

    def __init__(self, scene: Scene, eye: Pinhole, size: tuple[int, int], unit: float, marked: bool):
        """size: px of the picture that is drawn on; unit: its px in the width of a thin line; marked: whether
        what no camera sees is drawn: strain, what is in view, the line of sight, lines on the bed."""
        self.scene, self.eye, self.unit, self.marked = scene, eye, unit, marked
        width, height = size
        self.image: Bytes = np.empty((height, width, 3), dtype=np.uint8)
        self.depth = np.empty((height, width), dtype=np.float32)
        self.kind: Bytes = np.empty((height, width), dtype=np.uint8)
        tissue = scene.tissue
        self.length = drawn_length(scene)
        self.half = tissue.depth / 2
        self.across = self.half + 0.1 * self.length
        """m, beside the middle, how far the line through B on the bed goes"""
        self.block_half = self.half + 0.06 * self.length
        self.sight = sight_line(scene, eye, self.image.shape)
        """(2, 3) m, what is drawn of the line of sight"""
        self._draw_bed()
        block = [
            (0.0, 0.0),
            (BLOCK * self.length, 0.0),
            (BLOCK * self.length, tissue.height),
            (0.0, tissue.height),
        ]
        solid, edges = bar(np.array(block), self.block_half)
        self.fill(solid, _plain(WALL))
        self.line(edges, GREY, 0.8)
        target, _ = scene.line_of_sight.target
        self.on_bed(-tissue.length, target, UNSEEN_BED if marked else SEEN_BED, 1)
        self._still = self.image.copy(), self.depth.copy(), self.kind.copy()

    def begin(self) -> None:
        """Wipe off the last state."""
        image, depth, kind = self._still
        np.copyto(self.image, image)
        np.copyto(self.depth, depth)
        np.copyto(self.kind, kind)

    def fill(
        self,
        solid: Solid,
        table: Bytes,
        values: Array | None = None,
        gloss: float = 0.0,
        own: int = SOLID,
        through: float = 0.0,
        shaded: bool = True,
    ) -> None:
        """Draw a solid; values (v,) in [0, 1] choose its colours from the table (k, 3), others as
        `fill_faces`. shaded: or in the very colours of the table."""
        light = lit(solid, self.eye.eye, gloss) if shaded else np.ones(len(solid.points))
        shares = np.zeros(len(light)) if values is None else values
        dim = DIM * self.scene.tissue.height
        points = self.eye(solid.points)
        fill_faces(
            self.image, self.depth, self.kind, points, solid.faces, shares, light, table, own, through, dim
        )  # fmt: skip

    def line(
        self, points: Array, colour: str, width: float, nearer: float = ON_TOP, faint: float = 0.0
    ) -> None:
        """Line through points (n, 3) m, width in thin lines; the rest as `draw_lines`."""
        draw_lines(self.image, self.depth, self.eye(points), width * self.unit, *rgb(colour), nearer, faint)

    def on_bed(self, begin: float, end: float, colour: str, layer: int) -> None:
        """Colour the bed below the flap's depth from x = begin to x = end, m; high layers cover low ones."""
        corners = [(x, 0.0, z) for x in (begin, end) for z in (-self.half, self.half)]
        points = self.eye(np.array(corners))
        points[:, 2] *= 1 + 2e-4 * layer
        faces, light = np.array([[0, 1, 2], [1, 3, 2]]), np.ones(4)
        fill_faces(
            self.image,
            self.depth,
            self.kind,
            points,
            faces,
            np.zeros(4),
            light,
            _plain(colour),
            FLOOR,
            0.0,
            1.0,
        )

    def shadow(self, solids: Sequence[tuple[Array, NDArray[np.intp]]]) -> None:
        """Darken the bed below points (v, 3) m with faces (m, 3)."""
        for points, faces in solids:
            down = points - LIGHT * (points[:, 1:2] / LIGHT[1])
            cast_shadow(self.image, self.kind, self.eye(down), faces, SHADOW)

    def _draw_bed(self) -> None:
        """A plane without end, tinted around the flap; beyond its horizon there is nothing."""
        height, width = self.depth.shape
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays, eye = self.eye.rays(np.stack((x, y), axis=-1)), self.eye.eye
        below = rays[..., 1] < -1e-9
        way = np.where(below, -eye[1] / np.where(below, rays[..., 1], -1.0), np.inf)
        self.depth[:] = 1 / way
        around = BED_AROUND * self.length
        at_x, at_z = eye[0] + way * rays[..., 0], eye[2] + way * rays[..., 2]
        over_x = np.maximum(
            np.maximum(-self.length - around - at_x, at_x - BLOCK * self.length - around), 0.0
        )
        over_z = np.maximum(np.abs(at_z) - self.half - BED_BESIDE * around, 0.0)
        inside = below & (over_x <= 0) & (over_z <= 0)
        self.image[:] = 255
        self.image[inside] = rgb(GROUND)
        self.kind[:] = np.where(inside, FLOOR, SOLID)  # no shadow falls beside the bed
        if self.marked:
            step = 10.0 ** math.floor(math.log10(0.4 * self.length))
            far = self.half + BED_BESIDE * around
            lines = [np.empty((0, 3))]
            gap = np.full((1, 3), np.nan)
            begin, end = -self.length - around, BLOCK * self.length + around
            for x0 in np.arange(math.ceil(begin / step), math.floor(end / step) + 1) * step:
                lines += [np.array([(x0, 0.0, -far), (x0, 0.0, far)]), gap]
            for z0 in np.arange(math.ceil(-far / step), math.floor(far / step) + 1) * step:
                lines += [np.array([(begin, 0.0, z0), (end, 0.0, z0)]), gap]
            self.line(np.concatenate(lines), HATCH, 0.6)


class SpaceRenderer:
    """Draws states of one section of one scene in space."""

    def __init__(self, scene: Scene, section: SectionMesh, size: tuple[int, int] = (640, 480)):
        """size: width and height of a frame, px. Raises ValueError where that is too small to read."""
        check_size(size)
        self.scene, self.size = scene, size
        self._flap = FlapSolid(SectionTopology(section, scene.tissue.veins), section, scene.tissue.depth)
        self._jaws = JawShapes(scene)
        self._frame: _Frame | None = None
        self._small: dict[tuple[int, int], Place] = {}

    def draw(self, state: TissueState, history: Sequence[TissueState] = ()) -> Bytes:
        """Frame (h, w, 3) of a state, with the curves of the states so far, as `SectionRenderer.draw`."""
        if self._frame is None:
            self._frame = _Frame(self.scene, self.size)
        frame = self._frame
        self._paint(frame.place, state)
        return frame.finished(state, history)

    def pixels(self, state: TissueState, size: tuple[int, int] = (96, 96)) -> Bytes:
        """Small picture (h, w, 3) from the camera A: an observation. It shows what a camera sees, so neither
        strain nor line of sight."""
        if size not in self._small:
            fine = (4 * size[0], 4 * size[1])
            self._small[size] = Place(self.scene, eye_at_camera(self.scene, fine), fine, 2.0, marked=False)
        place = self._small[size]
        self._paint(place, state)
        half = np.empty((2 * size[1], 2 * size[0], 3), dtype=np.uint8)
        halved(place.image, half)
        small = np.empty((size[1], size[0], 3), dtype=np.uint8)
        halved(half, small)
        return small

    def close(self) -> None:
        """Give back the memory that is drawn on; drawing again takes it anew."""
        self._frame = None
        self._small.clear()

    def _paint(self, place: Place, state: TissueState) -> None:
        scene, flap, eye = self.scene, self._flap, place.eye.eye
        points = np.asarray(state.points, dtype=np.float64)
        length, (target, _) = scene.tissue.length, scene.line_of_sight.target
        place.begin()
        if place.marked:
            outline = points[flap.topology.outline]
            for begin, end in seen_spans(outline, scene.line_of_sight.camera, -length, target).tolist():
                place.on_bed(begin, end, SEEN_BED, 2)
            ends = np.array([(target, 0.0, -place.across), (target, 0.0, place.across)])
            place.line(ends, SIGHT, 1.4, nearer=5e-4)
        skin = flap.skin(points)
        cuts = [(side, flap.cut(points, side)) for side in (1, -1)]
        straight = flap.topology.straight
        place.shadow([(skin.points, skin.faces), *((cut.points, straight) for _, cut in cuts)])
        place.fill(flap.veins(points), _plain(VEIN_EDGE), own=INNER)
        table, share, on_skin = _plain(TISSUE), None, None
        if place.marked:
            table, share = STRAIN, flap.topology.smooth(state.strain) / scene.limits.strain
            on_skin = share[flap.skin_vertices]
        place.fill(skin, table, on_skin, gloss=GLOSS, through=THROUGH)
        for side, cut in cuts:
            if side * eye[2] > flap.half:
                place.fill(cut, table, share, shaded=False)
                place.line(flap.vein_lines(points, side), VEIN_EDGE, 1.1)
            place.line(flap.lines(points, side), INK, 1.3)
        self._paint_jaws(place, state.jaws)
        if place.marked:
            place.line(place.sight, SIGHT, 1.8, nearer=1e-4, faint=0.3)

    def _paint_jaws(self, place: Place, jaws: Array) -> None:
        wide = (self.scene.jaws.depth or self.scene.tissue.depth * 1.06) / 2
        slim = min(wide / 3, self.scene.tissue.height / 5)
        for shapes, colour, half in zip(self._jaws.at(jaws), (STEEL, INK), (slim, wide), strict=True):
            for shape in shapes:
                if shape[:-2, 1].max() <= 1e-9:  # its edges would show through the bed
                    continue
                solid, edges = bar(shape[:-2], half)
                place.fill(solid, _plain(colour), gloss=2 * GLOSS)
                place.line(edges, GREY, 0.5)


class _Frame:
    """What a frame is drawn on, with its words and gauges."""

    def __init__(self, scene: Scene, size: tuple[int, int]):
        width, height = size
        unit = unit_of(size)
        self.top = height - round(STRIP * unit)
        eye = eye_beside(scene, (2 * width, 2 * self.top), 2 * unit)
        self.place = Place(scene, eye, (2 * width, 2 * self.top), 2 * unit, marked=True)
        self.canvas = Canvas(np.full((height, width, 3), 255, dtype=np.uint8))
        self._letters = Lettering(self.canvas.surface, LETTERS * unit)
        self._strip = Strip(scene, (0, self.top, width, height), unit)
        self._strip.draw_behind(self.canvas, self._letters)
        self._draw_words(scene, eye, unit)
        self._words = self.canvas.image.copy()
        above = self._words[: self.top].reshape(-1, 3)
        self._written: NDArray[np.intp] = np.flatnonzero((above != 255).any(axis=1))
        """pixels above the strip that words cover"""
        self._letters_there: Bytes = above[self._written]

    def finished(self, state: TissueState, history: Sequence[TissueState]) -> Bytes:
        """The frame (h, w, 3) of what was painted on `place`."""
        image, top = self.canvas.image, self.top
        halved(self.place.image, image[:top])
        image.reshape(-1, 3)[self._written] = self._letters_there
        image[top:] = self._words[top:]
        self._strip.draw(self.canvas, self._letters, up_to(state, history))
        return image.copy()

    def _draw_words(self, scene: Scene, eye: Pinhole, unit: float) -> None:
        canvas, letters, place = self.canvas, self._letters, self.place
        line = eye(place.sight)[:, :2] / 2
        away = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
        reached = math.dist(place.sight[1][:2], scene.line_of_sight.camera) < 1e-9
        draw_camera(canvas, line[1], away, reached, unit)
        name_camera(letters, line[1], away, unit)
        x, y, _ = eye((scene.line_of_sight.target[0], 0.0, place.across))
        letters.write("B", x / 2, y / 2 + 9 * unit, SIGHT, 0.5)
        x, y, _ = eye((BLOCK / 2 * place.length, 0.0, place.block_half))
        letters.write("fixed end", x / 2, y / 2 + 10 * unit, GREY, 0.5)
        at, below = 14 * unit, self.top - 12 * unit
        for word, colour in (("area of interest:", GREY), ("in view", SIGHT), ("hidden", LIMIT)):
            at += letters.write(word, at, below, colour) + 9 * unit
        draw_scale(canvas, letters, scene.limits.strain, unit)


def eye_beside(scene: Scene, size: tuple[int, int], unit: float) -> Pinhole:
    """The eye of a frame: beside the free end, a little above, so that it sees all that a flap can reach."""
    tissue = scene.tissue
    length, half = drawn_length(scene), tissue.depth / 2
    turn = np.linspace(0.0, math.asin(ABOVE), 8)
    reach = [(-length * math.cos(a), length * math.sin(a)) for a in turn]
    around = BED_AROUND * length
    points = [(x, y, z) for x, y in reach for z in (-half, half)]
    points += [
        (x, 0.0, z * (half + BED_BESIDE * around))
        for x in (-length - around, BLOCK * length + around)
        for z in (-1, 1)
    ]
    box = (10 * unit, 10 * unit, size[0] - 10 * unit, size[1] - 18 * unit)
    return from_afar(np.array(points), axes_ahead(AZIMUTH, ELEVATION), OPENING, box)


def eye_at_camera(scene: Scene, size: tuple[int, int]) -> Pinhole:
    """The camera A, turned and focused so that the flap at rest and the area of interest fill its picture."""
    tissue, (x, y) = scene.tissue, scene.line_of_sight.camera
    half = tissue.depth / 2
    box = [
        (a, b, c)
        for a in (-1.06 * tissue.length, 0.06 * tissue.length)
        for b in (0.0, tissue.height)
        for c in (-1.3 * half, 1.3 * half)
    ]
    return from_point(np.array([x, y, 0.0]), np.array(box), (0.0, 0.0, float(size[0]), float(size[1])))


def sight_line(scene: Scene, eye: Pinhole, shape: Sequence[int]) -> Array:
    """(2, 3) m, the line of sight from B to A, or to where it leaves a picture of that shape, rows first."""
    sight = scene.line_of_sight
    target, camera = (np.array([*point, 0.0]) for point in (sight.target, sight.camera))
    shares = np.linspace(0.0, 1.0, 401)
    seen = eye(target + shares[:, None] * (camera - target))[:, :2]
    inside = 0.02 * shape[1]
    within = (seen > inside).all(axis=1) & (seen < (shape[1] - inside, shape[0] - inside)).all(axis=1)
    last = len(shares) - 1 if within.all() else max(int(np.argmin(within)) - 1, 1)
    return np.stack([target, target + shares[last] * (camera - target)])
