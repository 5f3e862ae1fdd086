"""Frames show what the states say: colours, places, limits. Needs no display."""

from __future__ import annotations

import itertools
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps
from numpy.typing import ArrayLike, NDArray

from retract_env.drawing.palette import (
    INK,
    LIMIT,
    SIGHT,
    STEEL,
    STRAIN,
    VEIN_EDGE,
    WEDGE,
    WHITE,
    Bytes,
    rgb,
)
from retract_env.drawing.renderer import SectionRenderer
from retract_env.drawing.scenery import Scenery
from retract_env.drawing.shapes import SectionTopology
from retract_env.physics.base import TissueState
from tests.retract_env.lifted import ROOT, Retraction, lifted


def strain_colour(strain: ArrayLike, limit: float) -> Bytes:
    """Colours (..., 3) of strain (...,); beyond the limit that of the limit."""
    share = np.asarray(strain, dtype=np.float64) / limit
    return STRAIN[np.clip(share * len(STRAIN), 0, len(STRAIN) - 1).astype(np.intp)]


@pytest.fixture(scope="module")
def lift() -> Retraction:
    return lifted()


def strained(state: TissueState, strain: float) -> TissueState:
    """The same strain everywhere."""
    return replace(state, strain=np.full_like(state.strain, strain), worst_strain=strain)


def moved(state: TissueState, x: float, y: float) -> TissueState:
    by = np.array([x, y])
    return replace(state, points=state.points + by, jaws=state.jaws + np.tile(by, 2))


def scenery(renderer: SectionRenderer) -> Scenery:
    """What its frames are drawn on."""
    frame = renderer._frame
    assert frame is not None
    return frame[0]


def spot(renderer: SectionRenderer, frame: Bytes, at: NDArray[np.float64]) -> tuple[int, ...]:
    """Colour where a point (2,) m is drawn."""
    x, y = np.floor(scenery(renderer).view(at)).astype(int)
    return tuple(int(v) for v in frame[y, x])


def nearby(renderer: SectionRenderer, frame: Bytes, at: NDArray[np.float64], colour: str) -> int:
    """Largest difference, of 255, from a colour at the most alike of nine pixels around a point (2,) m."""
    x, y = np.floor(scenery(renderer).view(at)).astype(int)
    around = frame[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).astype(int)
    return int(abs(around - rgb(colour)).max(axis=1).min())


def test_frames_are_arrays_of_bytes_that_nobody_else_holds(lift: Retraction) -> None:
    renderer = lift.renderer()
    frame = renderer.draw(lift.states[3], lift.states[:4])
    assert frame.shape == (480, 640, 3) and frame.dtype == np.uint8 and frame.flags.c_contiguous
    kept = frame.copy()
    renderer.draw(lift.states[-1], lift.states)
    assert np.array_equal(frame, kept)
    frame[:] = 0
    assert np.array_equal(renderer.draw(lift.states[3], lift.states[:4]), kept)


def test_a_frame_depends_on_its_state_and_history_alone(lift: Retraction) -> None:
    first, second = lift.renderer(), lift.renderer()
    for i in (9, 0, 5):
        second.draw(lift.states[i], lift.states[:i])
        second.pixels(lift.states[i])
    for i in (2, 7):
        assert np.array_equal(
            first.draw(lift.states[i], lift.states[:i]), second.draw(lift.states[i], lift.states[:i])
        )
        assert np.array_equal(first.pixels(lift.states[i]), second.pixels(lift.states[i]))


def test_the_history_may_end_with_the_state_or_before_it(lift: Retraction) -> None:
    renderer = lift.renderer()
    before = renderer.draw(lift.states[4], lift.states[:4])
    assert np.array_equal(before, renderer.draw(lift.states[4], list(lift.states[:5])))
    assert not np.array_equal(before, renderer.draw(lift.states[4]))
    many = lift.states * 40  # far more steps than a curve has room for
    assert renderer.draw(many[-1], many).shape == (480, 640, 3)


@pytest.mark.parametrize("size", [(160, 160), (320, 240), (1280, 720), (400, 900)])
def test_other_sizes(lift: Retraction, size: tuple[int, int]) -> None:
    assert lift.renderer(size).draw(lift.states[5], lift.states[:5]).shape == (size[1], size[0], 3)


def test_a_frame_too_small_to_read_is_refused(lift: Retraction) -> None:
    with pytest.raises(ValueError, match=r"size = \(640, 100\) px, allowed 160 and more"):
        lift.renderer((640, 100))


def test_strain_has_the_colours_of_the_pictures() -> None:
    from baselines.pictures.drawing import strain_map

    assert abs(STRAIN - colormaps["magma_r"](np.linspace(0.02, 0.86, 256))[:, :3] * 255).max() <= 0.5
    shares = np.linspace(0.0, 1.5, 400)
    expected = strain_map()(shares)[:, :3] * 255
    assert abs(strain_colour(0.4 * shares, 0.4) - expected).max() <= 0.5


@pytest.mark.parametrize("strain", [0.0, 0.1, 0.31, 0.5, 0.9])
def test_tissue_has_the_colour_of_its_strain(strain: float) -> None:
    lift = lifted("medium")
    renderer, state = lift.renderer(), strained(lift.states[-1], strain)
    frame = renderer.draw(state)
    triangles = state.points[lift.physics.section.triangles]
    rest = lift.physics.section.corners
    # away from jaws, veins, outline and the line of sight: large triangles of the inside, at their middles
    sizes = np.abs(np.linalg.det(rest[:, 1:] - rest[:, :1]))
    edge = np.unique(lift.physics.section.boundary)
    inner = ~np.isin(lift.physics.section.triangles, edge).any(axis=1)
    expected = strain_colour(strain, lift.scene.limits.strain).astype(int)
    picked = np.flatnonzero(inner & (sizes > np.quantile(sizes[inner], 0.8)))
    assert len(picked) > 5
    colours = [spot(renderer, frame, triangles[i, :3].mean(axis=0)) for i in picked]
    matching = [abs(np.array(c) - expected).max() <= 3 for c in colours]
    assert np.mean(matching) > 0.9  # the line of sight or a jaw may lie over one


def test_parts_are_where_the_state_has_them(lift: Retraction) -> None:
    renderer, state = lift.renderer(), lift.states[-1]
    frame = renderer.draw(state)
    length = lift.scene.tissue.length
    topology = SectionTopology(lift.physics.section, lift.scene.tissue.veins)
    outline = state.points[topology.outline]
    dark = [nearby(renderer, frame, p, INK) for p in outline if p[1] > 1e-3]
    assert np.mean(np.array(dark) < 40) > 0.9  # jaws and the line of sight lie over some
    veins = topology.vein_lines(state.points)
    veins = veins[np.isfinite(veins).all(axis=1)]
    assert np.mean([nearby(renderer, frame, p, VEIN_EDGE) < 70 for p in veins]) > 0.9
    lower, upper = state.jaws.reshape(2, 2)
    axis = (upper - lower) / np.hypot(*(upper - lower))
    for end, outward in ((lower, -axis), (upper, axis)):
        assert nearby(renderer, frame, end + 0.008 * length * outward, INK) < 20
        assert nearby(renderer, frame, end + 0.1 * length * outward, STEEL) < 20
    assert spot(renderer, frame, np.array([0.1 * length, 0.7 * length])) == rgb(WHITE)
    assert spot(renderer, frame, np.array([-length, 0.3 * length])) == rgb(WEDGE)
    sight = lift.scene.line_of_sight
    along = np.array(sight.target) + 0.3 * (np.array(sight.camera) - sight.target)
    assert nearby(renderer, frame, along, SIGHT) < 40


def bed_colours(renderer: SectionRenderer, frame: Bytes, xs: NDArray[np.float64]) -> list[tuple[int, ...]]:
    still = scenery(renderer)
    columns = np.floor(still.view(np.column_stack((xs, np.zeros_like(xs))))[:, 0]).astype(int)
    return [tuple(int(v) for v in frame[still.view.bed + 3, column]) for column in columns]


def test_the_bed_is_green_where_the_camera_sees_it(lift: Retraction) -> None:
    renderer = lift.renderer()
    target, length = lift.scene.line_of_sight.target[0], lift.scene.tissue.length
    inside = np.linspace(-length, target - 0.03 * length, 50)[1:]
    at_rest = bed_colours(renderer, renderer.draw(lift.states[0]), inside)
    assert set(at_rest) == {rgb(LIMIT)}
    gone = bed_colours(renderer, renderer.draw(moved(lift.states[0], 2 * length, 0.0)), inside)
    assert set(gone) == {rgb(SIGHT)}
    half = bed_colours(renderer, renderer.draw(lift.states[6]), inside)
    green = [colour == rgb(SIGHT) for colour in half]
    assert green == sorted(green, reverse=True) and set(half) == {rgb(SIGHT), rgb(LIMIT)}
    outside = bed_colours(renderer, renderer.draw(lift.states[0]), np.array([-1.05, -0.1, 0.2]) * length)
    assert not {rgb(SIGHT), rgb(LIMIT)} & set(outside)


@pytest.mark.parametrize("by", [(0.0, 0.2), (-0.3, 0.0), (0.3, -0.3), (1e4, 1e5), (-1e9, 1e9)])
def test_a_flap_out_of_view_leaves_an_empty_stage(lift: Retraction, by: tuple[float, float]) -> None:
    renderer, far = lift.renderer(), moved(lift.states[-1], *by)
    frame = renderer.draw(far)
    top = scenery(renderer).view.bed
    dark = (frame[:top] == rgb(STEEL)).all(axis=-1)
    assert not dark.any()
    assert spot(renderer, frame, np.array([-0.03, 0.03])) in (rgb(WHITE), rgb(WEDGE))
    assert renderer.pixels(far).shape == (96, 96, 3)


def test_small_pictures(lift: Retraction) -> None:
    renderer = lift.renderer()
    pictures = [renderer.pixels(state) for state in lift.states]
    assert {(p.shape, p.dtype) for p in pictures} == {((96, 96, 3), np.dtype(np.uint8))}
    assert renderer.pixels(lift.states[0], (64, 48)).shape == (48, 64, 3)
    for before, after in itertools.pairwise(pictures[1:]):
        assert np.sum(abs(before.astype(int) - after).max(axis=-1) > 40) > 50  # an agent sees every move
    relaxed, strong = (renderer.pixels(strained(lift.states[-1], s)) for s in (0.0, 0.4))
    changed = np.sum(abs(relaxed.astype(int) - strong).max(axis=-1) > 60)
    tissue = lift.scene.tissue
    area = tissue.length * tissue.height * (96 / (1.3 * tissue.length)) ** 2
    assert changed > 0.6 * area  # the outline takes some


HEADLESS = """
import os, sys
os.environ["SDL_VIDEODRIVER"] = "none of these"
import numpy as np
from retract_env.mesh import RESOLUTIONS, section_mesh
from retract_env.physics.base import TissueState
from retract_env.drawing.renderer import SectionRenderer
from retract_env.scene import load_scene
import pygame
scene = load_scene("configs/scenes/ten_veins.yaml")
section = section_mesh(scene, -0.035, RESOLUTIONS["coarse"])
state = TissueState(section.points, np.zeros(len(section.triangles)), np.array([-0.035, 0, -0.035, 0.0044]),
    np.zeros((2, 2)), np.array([[0, 1.0], [0, -1.0]]), 0.0, np.zeros(2), np.zeros(2), -0.03, 0.0)
renderer = SectionRenderer(scene, section)
print(renderer.draw(state).shape, renderer.pixels(state).shape)
renderer.close()
print(pygame.display.get_init(), "matplotlib" in sys.modules)
"""


def test_frames_need_neither_display_nor_matplotlib_and_print_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HEADLESS], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == ["(480, 640, 3) (96, 96, 3)", "False False"], done.stderr


def test_many_frames_take_no_more_memory(lift: Retraction) -> None:
    renderer = lift.renderer()

    def draw(times: int) -> None:
        for i in range(times):
            state = replace(lift.states[i % 10], worst_strain=1e-3 * (i % 500))
            renderer.draw(state, lift.states)
            renderer.pixels(state)

    draw(20)
    tracemalloc.start()
    try:
        draw(20)
        before = tracemalloc.get_traced_memory()[0]
        draw(200)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 200_000  # one frame has 921 600 bytes


def test_a_closed_renderer_can_be_closed_again_and_draws_anew(lift: Retraction) -> None:
    renderer = lift.renderer()
    frame = renderer.draw(lift.states[2])
    renderer.close()
    renderer.close()
    assert np.array_equal(renderer.draw(lift.states[2]), frame)
