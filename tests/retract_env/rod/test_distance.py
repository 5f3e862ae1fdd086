"""The rod's distance from fine finite elements: ranks, and what is read from the package."""

from __future__ import annotations

import math

import numpy as np
import pytest

from retract_env.rod import distance


def test_the_rank_is_that_of_split_conformal_prediction() -> None:
    nine = [5.0, 1.0, 9.0, 3.0, 7.0, 2.0, 8.0, 4.0, 6.0]
    assert distance.quantile(nine, 0.9) == 9.0  # rank (9 + 1) .9
    assert distance.quantile(nine, 0.8) == 8.0
    assert distance.quantile(nine, 0.5) == 5.0
    assert distance.quantile(nine, 0.75) == 8.0  # rank 7.5, rounded up
    assert math.isinf(distance.quantile(nine, 0.95))
    assert distance.quantile(range(99), 0.99) == 98.0


def test_another_error_is_covered_as_often_as_is_said() -> None:
    rng = np.random.default_rng(0)
    errors = rng.standard_cauchy((4000, 20))
    covered = np.mean([one[-1] <= distance.quantile(one[:-1], 0.9) for one in errors])
    assert covered == pytest.approx(0.9, abs=3 * math.sqrt(0.9 * 0.1 / 4000))


def test_higher_levels_have_wider_margins() -> None:
    levels = distance.measured()["levels"]
    found = np.array([distance.margins(level) for level in levels])
    assert (np.diff(found, axis=0) >= 0).all()
    assert (found[-2:] > 0).all()


def test_a_flap_of_four_motions_needs_more_than_one_motion() -> None:
    assert (np.array(distance.margins(0.9, "flap")) >= np.array(distance.margins(0.9))).all()


def test_a_level_that_is_not_there_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"^level = 0.97, allowed 0.5, .*0.99$") as refused:
        distance.margins(0.97)
    assert "\n" not in str(refused.value)
