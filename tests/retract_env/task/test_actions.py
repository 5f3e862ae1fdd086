"""Actions and what they mean are inverses of each other; nothing else gets through."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.grasp import Grasp
from retract_env.mesh import patch_ends
from retract_env.scene import Scene, sample_scene
from retract_env.task import TaskConfig, actions, default_scene

numbers = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
seeds = st.integers(0, 10_000)
few = settings(max_examples=50, deadline=None)


@few
@given(seeds, numbers)
def test_every_grasp_of_the_action_space_fits_on_the_flap(seed: int, action: Any) -> None:
    scene = sample_scene(np.random.default_rng(seed))
    grasp = actions.to_grasp(action.astype(np.float32), scene)
    patch_ends(scene, grasp.x)
    grasp.check_inside(scene.tissue.length, scene.tissue.height)


@few
@given(seeds, numbers)
def test_a_grasp_and_its_action(seed: int, action: Any) -> None:
    scene = sample_scene(np.random.default_rng(seed))
    there = actions.to_grasp(action, scene)
    assert actions.from_grasp(there, scene)[:2] == pytest.approx(action[:2], abs=1e-12)


def test_the_ends_of_the_range() -> None:
    scene = default_scene()
    first, last = (actions.to_grasp(np.full(3, end), scene) for end in (-1, 1))
    assert (first.x, first.compression) == pytest.approx((-0.05, 0.02 * 4.4e-3))
    assert last.compression == pytest.approx(0.5 * 4.4e-3)
    # nearer to the fixed end a jaw would not fit
    assert last.x == pytest.approx(-0.55e-3, rel=1e-5)
    with pytest.raises(ValueError, match=r"^grasp\.x = "):
        patch_ends(scene, last.x + 1e-8)
    outside = Grasp(-0.06, 4e-3)
    assert actions.from_grasp(outside, scene)[:2].tolist() == [-1, 1]


@few
@given(st.floats(5e-4, 0.02), st.sampled_from(["compression", "force"]), numbers)
def test_the_same_action_holds_thicker_flaps_as_much_more_firmly_as_they_are_harder_to_bend(
    height: float, grip: str, action: Any
) -> None:
    """With the square of height over length, as far as the firmest grip allows; and it has its inverse."""
    config = TaskConfig.from_data({"grip": grip})
    light, firm = config.firmness
    usual = default_scene()
    other = usual.model_copy(update={"tissue": usual.tissue.model_copy(update={"height": height})})
    times = (height / usual.tissue.height) ** 2

    def share(scene: Scene) -> float:
        """Compression over the height, or force over E w d."""
        tissue, (firmness,) = scene.tissue, actions.to_grasp(action, scene, config).firmness.values()
        unit = tissue.modulus * scene.jaws.width * tissue.depth if grip == "force" else tissue.height
        return firmness / unit

    assert light * (1 - 1e-9) <= share(usual) <= firm
    if light * times <= firm / 2:
        if times >= 1:
            assert share(other) == pytest.approx(min(times * share(usual), firm))
        else:  # the range is wider, as its firmest end stays
            assert times * share(usual) * (1 - 1e-9) <= share(other) <= share(usual) * (1 + 1e-9)
    grasp = actions.to_grasp(action, other, config)
    again = actions.to_grasp(actions.from_grasp(grasp, other, config), other, config)
    assert again.x == pytest.approx(grasp.x)
    assert list(again.firmness.values()) == pytest.approx(list(grasp.firmness.values()))


@few
@given(numbers, numbers)
def test_a_move_and_its_action(action: Any, here: Any) -> None:
    pose = np.append(here, 3e-3)
    there = actions.moved(action, pose)
    assert there[3] == pose[3]
    assert np.abs(there - pose)[:3] == pytest.approx(np.abs(action) * [2e-3, 2e-3, math.radians(6)])
    assert actions.move_towards(there, pose) == pytest.approx(action, abs=1e-9)
    # a whole turn more is the same place
    assert actions.move_towards(there + np.array([0, 0, 2 * math.pi, 0]), pose) == pytest.approx(
        action, abs=1e-9
    )


@few
@given(numbers, st.floats(1.0, 100.0))
def test_a_move_to_a_far_pose_goes_straight_towards_it(action: Any, times: float) -> None:
    target = times * np.append(action * TaskConfig().move, 0.0)
    target[2] = np.clip(target[2], -3.0, 3.0)
    step = actions.move_towards(target, np.zeros(4))
    assert np.abs(step).max() <= 1 + 1e-12
    assert np.cross(step, target[:3] / TaskConfig().move) == pytest.approx(np.zeros(3), abs=1e-9)
    assert step @ (target[:3] / TaskConfig().move) >= 0


def test_numbers_outside_are_clipped() -> None:
    assert actions.checked([-3, 1e300, 0.5]).tolist() == [-1, 1, 0.5]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0, 0], r"^action has shape \(2,\), allowed \(3,\)$"),
        ([[0, 0, 0]], r"^action has shape \(1, 3\), allowed \(3,\)$"),
        (0.0, r"^action has shape \(\), allowed \(3,\)$"),
        ([0, math.nan, 0], r"^action = \[0.0, nan, 0.0\], allowed finite numbers$"),
        ([0, 0, -math.inf], r"^action = \[0.0, 0.0, -inf\], allowed finite numbers$"),
        ("up", r"^action = 'up', allowed 3 numbers$"),
        ([0, [1, 2], 0], r"^action = \[0, \[1, 2\], 0\], allowed 3 numbers$"),
        (None, r"^action .* allowed"),
    ],
)
def test_what_is_no_action(action: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        actions.checked(action)
    assert "\n" not in str(caught.value)
