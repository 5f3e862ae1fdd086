"""The table of candidates: complete, narrow enough for a terminal, and plain where there is none."""

from __future__ import annotations

import io

import numpy as np
from rich.console import Console

from baselines.cli.candidates import CandidateTable
from planners.base import Candidate
from retract_env.grasp import Grasp, JawPath


def candidates() -> list[Candidate]:
    grasps = [Grasp(-0.0349, 0.00097, 6.9), Grasp(-0.0495, 0.0011, float("nan")), Grasp(-0.001, 0.001, 1e4)]
    waypoints = [
        [(g.x, 0.0, g.x, 0.0044), (g.x, g.compression / 2, g.x, 0.0044 - g.compression / 2)] for g in grasps
    ]
    made = [
        Candidate(i, g, JawPath(np.array(w), "ctc"))
        for i, (g, w) in enumerate(zip(grasps, waypoints, strict=True))
    ]
    made[1].status, made[1].max_strain = "squeezing", 0.2
    made[2].status, made[2].reason, made[2].required_friction, made[2].clearance = (
        "done",
        "not_visible",
        float("inf"),
        -0.0266,
    )
    return made


def test_the_table_fits_a_terminal_and_says_why_a_candidate_was_dropped() -> None:
    screen = io.StringIO()
    table = CandidateTable(Console(file=screen, force_terminal=True, width=80, color_system=None))
    with table:
        table.update(candidates())
    lines = screen.getvalue().splitlines()
    assert any("squeezing" in line and "0.200" in line and "-49.50" in line for line in lines)
    assert any("not visible" in line and "inf" in line and "-26.60" in line for line in lines)
    assert any("waiting" in line and "nan" not in line for line in lines)
    assert "…" not in screen.getvalue()


def test_elsewhere_each_candidate_is_told_once_and_the_table_comes_last() -> None:
    text = io.StringIO()
    tried = candidates()
    with CandidateTable(Console(file=text, width=20)) as table:
        table.update(tried)
        table.update(tried)
        tried[0].status, tried[0].reason = "done", "ok"
        table.update(tried)
        table.choose(tried[0].grasp)
        assert text.getvalue().splitlines() == [
            "1/3  grasp -1.00 mm, not visible, friction inf, 0.0 s",
            "2/3  grasp -34.90 mm, certified, 0.0 s",
        ]
    assert text.getvalue().count("chosen") == 1
    assert "\x1b" not in text.getvalue()
