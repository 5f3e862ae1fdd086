"""What the charts show and what they leave out."""

from __future__ import annotations

import numpy as np

from baselines.benchmark.charts import compared, curve_chart, profile_chart
from baselines.benchmark.report import _inline

SCORES = {
    "good": np.full((1, 100), 0.5),
    "some": np.full((1, 4), 1.0),
    "best": np.full((3, 100), 0.9),
    "nothing": np.zeros((1, 100)),
}


def test_curves_are_of_the_same_scenes_best_first() -> None:
    assert compared(SCORES) == (["best", "good"], ["some"], ["nothing"])
    assert compared({"some": SCORES["some"]}) == (["some"], [], [])  # on all that there are
    assert compared({}) == ([], [], [])


def test_methods_on_some_scenes_draw_no_curve() -> None:
    drawn = profile_chart(SCORES)
    assert drawn[:4] == b"\x89PNG"
    worse = SCORES | {"some": np.full((1, 4), 0.1)}
    assert profile_chart(worse) == drawn  # named, not drawn


def test_there_are_lines_for_any_number_of_curves() -> None:
    names = [f"method {k}" for k in range(25)]
    learned = [[{"steps": steps, "success": 0.5, "strain": 0.4} for steps in (1, 2)]]
    assert profile_chart({name: np.full((1, 4), 0.5) for name in names})[:4] == b"\x89PNG"
    assert curve_chart(dict.fromkeys(names, learned))[:4] == b"\x89PNG"


def test_no_markdown_is_left_in_html() -> None:
    assert _inline("**ctc**: `a < b`, 3 * 4") == "<b>ctc</b>: <code>a &lt; b</code>, 3 * 4"
