"""Frames in space, and what the camera A sees: parts are where the eye's law puts them."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from retract_env.drawing.palette import INK, SEEN_BED, SIGHT, STRAIN, UNSEEN_BED, Bytes, rgb
from retract_env.drawing.shapes import SectionTopology
from retract_env.drawing.solids import FlapSolid, bar
from retract_env.drawing.space import SpaceRenderer, eye_at_camera
from retract_env.objectives import seen_spans
from retract_env.physics.base import TissueState
from retract_env.physics.registry import PHYSICS
from retract_env.scene import Scene
from retract_env.task.rest import rest_mesh, rest_state
from tests.retract_env.lifted import Retraction, lifted

MARKED = SIGHT, SEEN_BED, UNSEEN_BED


@pytest.fixture(scope="module")
def lift() -> Retraction:
    return lifted()


@pytest.fixture(scope="module")
def renderer(lift: Retraction) -> SpaceRenderer:
    return SpaceRenderer(lift.scene, lift.physics.section)


def near(frame: Bytes, pixel: Any, colour: str) -> int:
    """Largest difference, of 255, from a colour at the most alike of nine pixels around one."""
    x, y = np.floor(np.asarray(pixel)[:2]).astype(int)
    around = frame[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].reshape(-1, 3).astype(int)
    return int(abs(around - rgb(colour)).max(axis=1).min())


def on_frame(renderer: SpaceRenderer, points: Any) -> np.ndarray:
    frame = renderer._frame
    assert frame is not None
    return frame.place.eye(points) * (0.5, 0.5, 1.0)


def count(frame: Bytes, colour: str, within: int = 24) -> int:
    return int((abs(frame.astype(int) - rgb(colour)).max(axis=-1) <= within).sum())


def moved(state: TissueState, x: float, y: float) -> TissueState:
    by = np.array([x, y])
    return replace(state, points=state.points + by, jaws=state.jaws + np.tile(by, 2))


def test_frames_are_of_their_state_and_history_alone(lift: Retraction, renderer: SpaceRenderer) -> None:
    other = SpaceRenderer(lift.scene, lift.physics.section)
    for k in (9, 0, 5, 2):
        other.draw(lift.states[k], lift.states[:k])
        other.pixels(lift.states[k])
    frame = renderer.draw(lift.states[2], lift.states[:2])
    assert frame.shape == (480, 640, 3) and frame.dtype == np.uint8
    assert np.array_equal(frame, other.draw(lift.states[2], lift.states[:2]))
    assert np.array_equal(renderer.pixels(lift.states[2]), other.pixels(lift.states[2]))
    kept = frame.copy()
    renderer.draw(lift.states[7])
    assert np.array_equal(frame, kept)


@pytest.mark.parametrize("size", [(160, 160), (1280, 720), (400, 900)])
def test_other_sizes(lift: Retraction, size: tuple[int, int]) -> None:
    drawn = SpaceRenderer(lift.scene, lift.physics.section, size)
    assert drawn.draw(lift.states[5]).shape == (size[1], size[0], 3)


def test_a_frame_too_small_to_read_is_refused(lift: Retraction) -> None:
    with pytest.raises(ValueError, match=r"size = \(640, 100\) px, allowed 160 and more"):
        SpaceRenderer(lift.scene, lift.physics.section, (640, 100))


def test_the_flaps_edges_jaws_and_line_are_where_the_eye_has_them(
    lift: Retraction, renderer: SpaceRenderer
) -> None:
    state, half = lift.states[-1], lift.scene.tissue.depth / 2
    frame = renderer.draw(state)
    outline = state.points[renderer._flap.topology.outline]
    edge = np.column_stack((outline, np.full(len(outline), half)))[outline[:, 1] > 1e-3]
    dark = [near(frame, p, INK) for p in on_frame(renderer, edge)]
    assert np.mean(np.array(dark) < 60) > 0.85  # jaws and the block hide some
    lower, upper = state.jaws.reshape(2, 2)
    axis = (upper - lower) / np.hypot(*(upper - lower))
    for end, out in ((lower, -axis), (upper, axis)):
        middle = end + 0.008 * lift.scene.tissue.length * out
        assert near(frame, on_frame(renderer, [(*middle, half)])[0], INK) < 45
    sight = lift.scene.line_of_sight
    along = np.array(sight.target) + np.linspace(0.35, 0.5, 5)[:, None] * (
        np.array(sight.camera) - sight.target
    )
    for point in on_frame(renderer, np.column_stack((along, np.zeros(5)))):
        assert near(frame, point, SIGHT) < 60


def test_the_bed_tells_what_is_in_view(lift: Retraction, renderer: SpaceRenderer) -> None:
    scene, state = lift.scene, lift.states[6]
    frame = renderer.draw(state)
    target = scene.line_of_sight.target[0]
    outline = state.points[renderer._flap.topology.outline]
    ((begin, end),) = seen_spans(outline, scene.line_of_sight.camera, -scene.tissue.length, target)
    front = 0.8 * scene.tissue.depth / 2  # of the band, where the flap does not hide it from the viewer

    def matches(low: float, high: float, colour: str) -> float:
        xs = np.linspace(low, high, 12)[1:-1]
        at = on_frame(renderer, np.column_stack((xs, 0 * xs, np.full(len(xs), front))))
        return float(np.mean([near(frame, p, colour) < 12 for p in at]))

    assert begin == pytest.approx(-scene.tissue.length)
    assert matches(begin, end, SEEN_BED) > 0.7  # grid lines and the lower jaw lie over some
    assert matches(end, target, UNSEEN_BED) > 0.7
    gone = renderer.draw(moved(lift.states[0], 0.0, 10.0))
    assert 10 * count(gone[:388], UNSEEN_BED, 2) < count(frame[:388], UNSEEN_BED, 2)


def test_what_is_nearer_hides_what_is_farther(lift: Retraction, renderer: SpaceRenderer) -> None:
    """A jaw on the flap is seen, and one below the bed is not."""
    state = lift.states[0]
    frame = renderer.draw(replace(state, jaws=np.array([-0.03, -1.0, -0.03, 0.0044])))
    assert near(frame, on_frame(renderer, [(-0.03, 0.0048, 0.0023)])[0], INK) < 45
    holding = renderer.draw(replace(state, jaws=np.array([-0.03, 0.0, -0.03, 0.0044])))
    assert np.array_equal(holding[:388], frame[:388])
    raised = renderer.draw(replace(state, jaws=np.array([-0.03, 0.02, -0.03, 0.03])))
    assert not np.array_equal(raised[:388], frame[:388])


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_strain_chooses_the_colour_and_light_shades_it(
    lift: Retraction, renderer: SpaceRenderer, part: float
) -> None:
    state, limit = lift.states[-1], lift.scene.limits.strain
    frame = renderer.draw(replace(state, strain=np.full_like(state.strain, part * limit)))
    colour = STRAIN[min(int(part * len(STRAIN)), len(STRAIN) - 1)].astype(float)
    shades = np.linspace(0.75, 1.0, 41)[:, None] * colour
    pixels = frame[:388].reshape(-1, 3).astype(float)
    alike = (abs(pixels[:, None] - shades).max(axis=-1) <= 3).any(axis=1)
    tissue = lift.scene.tissue
    corners = on_frame(renderer, [(-tissue.length, 0.0, 0.0), (0.0, 0.0, 0.0)])
    across = tissue.height / tissue.length * np.hypot(*np.diff(corners[:, :2], axis=0)[0])
    assert alike.sum() > 0.5 * across * across * tissue.length / tissue.height


def test_the_cameras_picture_shows_no_line_no_strain_and_what_is_exposed(lift: Retraction) -> None:
    renderer = SpaceRenderer(lift.scene, lift.physics.section)
    pictures = [renderer.pixels(state) for state in lift.states]
    assert {(p.shape, p.dtype) for p in pictures} == {((96, 96, 3), np.dtype(np.uint8))}
    assert all(count(picture, SIGHT, 32) == 0 for picture in pictures)
    assert count(renderer.draw(lift.states[-1])[:388], SIGHT, 32) > 100  # frames do have it
    strained = replace(lift.states[-1], strain=np.full_like(lift.states[-1].strain, 0.5))
    assert np.array_equal(renderer.pixels(strained), pictures[-1])
    bed = [count(picture, SEEN_BED, 4) for picture in pictures]
    assert bed[0] == 0 and np.all(np.diff(bed[2:]) >= 0) and bed[-1] > 200


def test_the_camera_looks_along_the_line_of_sight(lift: Retraction) -> None:
    """B and everything on the line are one pixel for A, and what is beside z = 0 is mirrored."""
    eye = eye_at_camera(lift.scene, (96, 96))
    sight = lift.scene.line_of_sight
    shares = np.array([0.0, 0.4, 0.8])[:, None]
    on_line = np.array([*sight.target, 0.0]) + shares * (
        np.subtract(sight.camera, sight.target) @ np.eye(2, 3)
    )
    assert np.ptp(eye(on_line)[:, :2], axis=0) == pytest.approx(0.0, abs=1e-9)
    left, right = eye(np.array([(-0.03, 0.004, -0.002), (-0.03, 0.004, 0.002)]))
    assert left[0] + right[0] == pytest.approx(96) and left[1] == pytest.approx(right[1])


def test_the_cameras_picture_of_a_flap_without_shadow_is_symmetric(
    lift: Retraction, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("retract_env.drawing.space.SHADOW", 1.0)
    picture = SpaceRenderer(lift.scene, lift.physics.section).pixels(lift.states[-1]).astype(int)
    differs = abs(picture - picture[:, ::-1]).max(axis=-1) > 40
    assert differs.mean() < 0.02  # the light comes from one side


def test_every_physics_looks_the_same_at_rest(lift: Retraction) -> None:
    scene, pictures = lift.scene, []
    for name, kind in PHYSICS.items():
        if kind.needs and find_spec(kind.needs) is None:
            continue
        physics = kind.make(scene, -0.03, "coarse" if name == "bullet" else kind.resolution)
        state = replace(physics.reset(), jaws=np.array([-0.03, -1.0, -0.03, -1.0]))
        drawn = SpaceRenderer(scene, physics.section)
        pictures.append((drawn.draw(state)[:388].astype(int), drawn.pixels(state).astype(int)))
        physics.close()
    assert len(pictures) > 1
    for frame, small in pictures[1:]:
        for one, other in ((frame, pictures[0][0]), (small, pictures[0][1])):
            assert (abs(one - other).max(axis=-1) > 30).mean() < 0.005


def test_a_flap_before_it_is_touched_and_one_out_of_sight(lift: Retraction) -> None:
    scene: Scene = lift.scene
    section = rest_mesh(scene)
    drawn = SpaceRenderer(scene, section)
    state = rest_state(scene, section)
    assert drawn.draw(state).shape == (480, 640, 3)
    for far in (moved(state, 1e4, 1e5), moved(state, -1e9, 1e9), moved(state, -0.08, 0.07)):
        assert drawn.draw(far).shape == (480, 640, 3) and drawn.pixels(far).shape == (96, 96, 3)
    drawn.close()
    drawn.close()
    assert np.array_equal(drawn.draw(state), SpaceRenderer(scene, section).draw(state))


def test_the_skin_is_the_outline_over_the_depth_with_normals_outwards(lift: Retraction) -> None:
    section, tissue = lift.physics.section, lift.scene.tissue
    flap = FlapSolid(SectionTopology(section, tissue.veins), section, tissue.depth)
    skin = flap.skin(section.points)
    a, b, c = (skin.points[skin.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx((2 * tissue.length + tissue.height) * tissue.depth, rel=1e-9)
    middle = np.array([-tissue.length / 2, tissue.height / 2, 0.0])
    assert np.all(((skin.points - middle) * skin.normals).sum(axis=1) > 0)
    assert np.allclose(np.linalg.norm(skin.normals, axis=1), 1)


@pytest.mark.parametrize("turned", [False, True])
def test_a_bar_is_closed_and_its_normals_point_out(turned: bool) -> None:
    shape = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)])
    solid, edges = bar(shape[::-1] if turned else shape, 0.5)
    a, b, c = (solid.points[solid.faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(10.0)
    assert np.all(((solid.points - (1.0, 0.5, 0.0)) * solid.normals).sum(axis=1) > 0.2)
    assert np.isnan(edges).any(axis=1).sum() == 2
