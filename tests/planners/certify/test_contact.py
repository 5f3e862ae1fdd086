"""Tissue that would be pushed by itself or by the block that holds the fixed end: not certified."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from baselines.verification.flaps import HEIGHT
from baselines.verification.sections import grid_section
from planners.certify import Certificate
from planners.paths import ctc
from retract_env.objectives import inside_block, verdict
from retract_env.physics.measures import EDGE, doubled, outline_ring
from retract_env.scene import LineOfSight, Scene
from tests.planners.retractions import a_grasp, a_scene, judged, poses


def nearly_straight_up(target: float, slope: float) -> Scene:
    """Hardly anything is in the way of such a line but what hangs over the fixed end."""
    scene = a_scene(strain=0.99)
    return scene.model_copy(update={"line_of_sight": LineOfSight.at(target, slope)})


def over_the_block() -> Certificate:
    """The flap is swung about its fixed end, over and down on the other side."""
    grasp = a_grasp(-0.035)
    swings = [math.radians(a) for a in range(6, 180, 6)]
    motion = [(grasp.x * math.cos(a), HEIGHT / 2 - grasp.x * math.sin(a), -a, 0.75 * HEIGHT) for a in swings]
    return judged(nearly_straight_up(-0.0006, 1.57), grasp, poses(grasp, *motion))


def folded() -> Certificate:
    """The flap's end is turned over and pressed down on the flap itself."""
    grasp = a_grasp(-0.045)
    parts = np.linspace(0, 1, 25)[1:].tolist()
    motion = [
        (-0.045 + 0.03 * s, HEIGHT / 2 + 0.012 * math.sin(math.pi * s), -math.pi * s, 0.75 * HEIGHT)
        for s in parts
    ]
    down = np.linspace(0.0005, 0.006, 8).tolist()
    motion += [(-0.015, HEIGHT / 2 - y, -math.pi, 0.75 * HEIGHT) for y in down]
    return judged(nearly_straight_up(-0.001, 1.5), grasp, poses(grasp, *motion))


def test_tissue_in_the_block_is_refused() -> None:
    certificate = over_the_block()
    assert (certificate.certified, certificate.reason) == (False, "contact")
    points = certificate.frames[-1].points
    assert inside_block(points, HEIGHT, 0.0)
    assert not any(f.overlap for f in certificate.frames[:-1])


def test_tissue_in_tissue_is_refused() -> None:
    certificate = folded()
    assert (certificate.certified, certificate.reason) == (False, "contact")
    assert certificate.section is not None
    ring = outline_ring(certificate.section)
    crossing = certificate.frames[-1].points[ring]
    assert not shapely.is_simple(shapely.linearrings(crossing))
    assert certificate.frames[-1].crease > (EDGE * 1e-3) ** 2 > certificate.frames[-2].crease
    assert not inside_block(certificate.frames[-1].points, HEIGHT, 0.0)


def test_a_retraction_that_touches_nothing_has_no_overlap() -> None:
    certificate = judged(a_scene(), a_grasp(), ctc(a_scene(), a_grasp()))
    assert certificate.certified
    assert not any(f.overlap for f in certificate.frames)


@pytest.mark.parametrize(
    ("point", "inside"),
    [((0.001, 0.001), True), ((0.001, -0.02), True), ((0.001, 0.0045), False), ((-0.001, 0.001), False)],
    ids=["inside", "deep down", "above it", "beside it"],
)
def test_the_block_reaches_up_to_the_flaps_height(point: tuple[float, float], inside: bool) -> None:
    assert inside_block([point, (-0.02, 0.0)], HEIGHT, 1e-6) == inside


def test_broken_limits_are_named_before_contact_and_contact_before_success() -> None:
    assert verdict(0.6, 0.1, 1.0, 0.5, 0.5, overlap=True) == "strain"
    assert verdict(0.1, 0.6, 1.0, 0.5, 0.5, overlap=True) == "slip"
    assert verdict(0.1, 0.1, 1.0, 0.5, 0.5, overlap=True) == "contact"
    assert verdict(0.1, 0.1, 1.0, 0.5, 0.5) == "ok"


@pytest.mark.parametrize("turn", [0.0, 1.0, 4.0])
def test_what_is_covered_twice_is_measured(turn: float) -> None:
    """A strip 1 wide that comes round and crosses itself covers the square of the crossing twice."""
    strip = np.array(
        [(0, 0), (6, 0), (6, 4), (2, 4), (2, -2), (3, -2), (3, 3), (5, 3), (5, 1), (0, 1)], float
    )
    cos, sin = math.cos(turn), math.sin(turn)
    turned = strip @ np.array([[cos, sin], [-sin, cos]])
    assert doubled(turned) == pytest.approx(1.0, rel=1e-9)
    assert doubled(turned[[0, 1, 2, 3, 9]]) == 0.0


def test_the_ring_goes_once_round_the_outline() -> None:
    section = grid_section([-0.05, -0.02, 0.0], [0.0, 0.002, HEIGHT], a_scene())
    ring = outline_ring(section)
    assert len(ring) == len(set(ring.tolist())) == 2 * len(section.boundary)
    area = shapely.area(shapely.polygons(section.points[ring]))
    assert area == pytest.approx(np.ptp(section.points[:, 0]) * np.ptp(section.points[:, 1]))


def test_a_path_that_only_squeezes_is_no_contact() -> None:
    assert judged(a_scene(), a_grasp(), poses(a_grasp())).reason == "not_visible"
