"""What the rod says of retractions, and what follows from it only with the margins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.base import DISMISSED
from planners.certify import certify
from planners.foresight import NOTHING, Margins, foresee, foreseen, margins
from planners.leads import least_grip
from planners.paths import ctc
from planners.search import generate_and_test
from retract_env.rod.follow import CLEAR, DRAG, FELT, NORMAL, STRAIN, TOUCHES
from retract_env.scene import Limits
from tests.planners.retractions import a_grasp, a_scene

LIMITS, MARGIN = Limits(strain=0.3, friction=0.5), Margins(strain=0.1, friction=0.2, clearance=0.02)
LENGTH = 0.05


def felt(strain: Any, friction: Any, clearance: Any, touches: bool = False) -> NDArray[np.float64]:
    out = np.zeros((len(strain), FELT))
    out[:, STRAIN], out[:, CLEAR], out[:, TOUCHES] = strain, clearance, touches
    out[:, NORMAL], out[:, DRAG] = 1.0, np.array(friction)[:, None]
    return out


def said(strain: Any, friction: Any, clearance: Any, whole: bool = True, touches: bool = False) -> Any:
    return foreseen(felt(strain, friction, clearance, touches), whole, LENGTH, LIMITS, MARGIN)


def test_margins_are_those_of_whole_flaps() -> None:
    found = margins()
    assert 0.1 < found.strain < 0.3 and 0.1 < found.friction < 0.2 and 0.01 < found.clearance < 0.05


@pytest.mark.parametrize(
    ("strain", "friction", "clearance", "hopeless"),
    [
        ([0.1, 0.32, 0.32], [0.1, 0.2, 0.2], [-0.01, -0.005, 0.0], False),  # strain within the margin
        ([0.1, 0.34, 0.34], [0.1, 0.2, 0.2], [-0.01, -0.005, 0.0], True),
        (
            [0.1, 0.2, 0.34],
            [0.1, 0.2, 0.2],
            [-0.01, -0.005, -0.0005],
            False,
        ),  # once it may be in view already
        ([0.1, 0.2, 0.2], [0.1, 0.69, 0.2], [-0.01, -0.005, 0.0], False),
        ([0.1, 0.2, 0.2], [0.1, 0.71, 0.2], [-0.01, -0.005, 0.0], True),
        ([0.1, 0.2, 0.2], [0.1, 0.2, 0.2], [-0.01, -0.005, -0.0009], False),  # nearly in view
        ([0.1, 0.2, 0.2], [0.1, 0.2, 0.2], [-0.01, -0.005, -0.0011], True),
    ],
)
def test_only_what_fails_by_more_than_the_margin_is_hopeless(
    strain: Any, friction: Any, clearance: Any, hopeless: bool
) -> None:
    assert said(strain, friction, clearance).hopeless is hopeless


def test_the_least_strain_is_that_before_the_target_may_be_in_view() -> None:
    found = said([0.1, 0.2, 0.25], [0.1, 0.2, 0.2], [-0.01, -0.005, 0.0])
    assert found.holds and found.strain == 0.25
    assert math.isclose(found.least_strain, 0.9 * 0.2)


def test_a_path_that_the_rod_lost_may_still_show_the_target_and_contact_dismisses_nothing() -> None:
    assert not said([0.1, 0.2], [0.1, 0.2], [-0.01, -0.005], whole=False).hopeless
    touched = said([0.1, 0.2], [0.1, 0.2], [-0.01, 0.0], touches=True)
    assert not touched.hopeless and not touched.holds


def test_the_rod_foresees_what_finite_elements_find() -> None:
    scene = a_scene(friction=0.5)
    grasps = [a_grasp(-0.035, 0.2), a_grasp(-0.03, 0.05), a_grasp(-0.03, 0.6)]
    good, slipping, firm = foresee(scene, [(g, ctc(scene, g, 12)) for g in grasps])
    found = certify(scene, grasps[0], ctc(scene, grasps[0], 12), "coarse")
    assert good.holds and not good.hopeless
    assert math.isclose(good.strain, found.max_strain, rel_tol=margins().strain)
    assert good.least_strain < found.max_strain
    assert slipping.hopeless and firm is NOTHING


def test_what_slips_for_sure_is_dismissed_but_tried_where_nothing_else_holds() -> None:
    scene = a_scene(friction=0.5)
    held, loose = ((g, ctc(scene, g, 12)) for g in (a_grasp(-0.035, 0.2), a_grasp(-0.03, 0.05)))
    plan = generate_and_test(scene, [loose, held], "test", "coarse", 1)
    assert [c.reason for c in plan.candidates] == [DISMISSED, "ok"]
    assert plan.candidates[0].increments == 0 and plan.candidates[0].required_friction > 0.5
    with pytest.raises(Exception, match="1 candidates: 1 slip"):
        generate_and_test(scene, [loose], "test", "coarse", 1)


def test_the_lightest_grip_is_found_between_two_as_friction_goes_with_one_over_it() -> None:
    scene = a_scene()
    c = np.array([1e-4, 2e-4, 4e-4])
    rows = [said([0.1 * k], [2.0 / k], [0.0]) for k in (1, 2, 4)]
    assert not rows[0].holds
    at, strain = least_grip(c, rows, 0.8, scene) or (0.0, 0.0)
    assert math.isclose(at, 2.5e-4) and 0.2 < strain < 0.4
    assert least_grip(c, rows[:2], 0.8, scene) is None
