"""Where jaws may sit: one range for all who propose grasps, and the mesh takes its ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.verification.flaps import flap
from retract_env.mesh import jaw_range, patch_ends
from retract_env.scene import Jaws
from retract_env.spring import SpringModel
from retract_env.task import actions
from retract_env.task.episode import spring_grasps

lengths = st.floats(1e-3, 0.5)
shares = st.floats(1e-3, 0.2499)
many = settings(max_examples=300, deadline=None)


@many
@given(lengths, shares)
def test_the_mesh_takes_grasps_at_both_ends_and_none_beyond(length: float, share: float) -> None:
    width = share * length
    scene = flap(length=length, jaws=Jaws(width=width))
    low, high = jaw_range(length, width)
    assert -length < low < high < -width / 2
    for x in (low, high):
        begin, end = patch_ends(scene, x)
        assert end - begin == pytest.approx(width)
        assert -length <= begin and end < 0
    with pytest.raises(ValueError, match=r"^grasp\.x = "):
        patch_ends(scene, math.nextafter(high, 0.0))


@many
@given(lengths, shares)
def test_all_who_propose_grasps_stay_within(length: float, share: float) -> None:
    """The spring model's, also at its ends, and every action's."""
    width = share * length
    scene = flap(length=length, jaws=Jaws(width=width))
    low, high = jaw_range(length, width)
    model = SpringModel(scene.tissue).stable_grasps(scene.limits.strain, width)
    assert all(low <= grasp.x <= high for grasp in model)
    assert spring_grasps(scene) == model  # the environment's best is the planners' best
    for action in (-1.0, 1.0):
        patch_ends(scene, actions.to_grasp(np.full(3, action), scene).x)


@pytest.mark.parametrize("width", [7.7e-3, 1e-3, 0.6e-3])
def test_grasps_moved_to_the_nearest_place_are_taken(width: float) -> None:
    """0.55 x 7.7 mm and 0.5 x 7.7 mm + 0.05 x 7.7 mm differ in the last bit."""
    scene = flap(jaws=Jaws(width=width))
    grasps = SpringModel(scene.tissue).stable_grasps(0.5, width, samples=200)
    nearest = max(grasps, key=lambda grasp: grasp.x)
    assert nearest.x == jaw_range(scene.tissue.length, width)[1]
    patch_ends(scene, nearest.x)


def test_flaps_as_short_as_the_jaws_leave_one_place() -> None:
    low, high = jaw_range(0.01, 0.01)
    assert low == high == pytest.approx(-0.0055)
