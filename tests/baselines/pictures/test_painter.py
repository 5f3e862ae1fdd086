"""The process that draws: the same pictures as drawn here, none of it left behind, and done without where it
fails."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import planners
from baselines.pictures.film import film
from baselines.pictures.painter import Painter
from baselines.pictures.still import picture
from planners.base import Plan
from retract_env.scene import load_scene

NAMES = ["retraction.png", "retraction.gif"]


@pytest.fixture(scope="module")
def plan() -> Plan:
    return planners.plan(load_scene("homogeneous"), "ctc", "coarse", workers=1)


@pytest.fixture(scope="module")
def expected(plan: Plan) -> dict[str, bytes]:
    return {"retraction.png": picture(plan), "retraction.gif": film(plan, "gif")}


def test_what_the_painter_draws_is_what_is_drawn_here(plan: Plan, expected: dict[str, bytes]) -> None:
    with Painter() as painter:
        process = painter._process
        assert painter.begin(plan, NAMES)() == expected
    assert process is not None and process.returncode is not None


@pytest.mark.parametrize("at", ["before", "after"])
def test_a_painter_that_dies_is_done_without(plan: Plan, expected: dict[str, bytes], at: str) -> None:
    """Whether it is killed before it is asked, or while it draws."""
    with Painter() as painter:
        assert painter._process is not None
        if at == "before":
            painter._process.kill()
            painter._process.wait()
        drawn = painter.begin(plan, NAMES)
        painter._process.kill()
        assert drawn() == expected


def test_a_painter_that_cannot_be_started_is_done_without(
    plan: Plan, expected: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with Painter() as painter:
        assert painter.begin(plan, NAMES)() == expected


def test_what_cannot_be_drawn_is_told_here(plan: Plan) -> None:
    bare = replace(plan, certificate=replace(plan.certificate, frames=()))
    with Painter() as painter, pytest.raises(ValueError, match="holds no frames"):
        painter.begin(bare, NAMES)()


def test_an_interrupt_ends_the_painter(plan: Plan) -> None:
    process = None

    def interrupted() -> None:
        nonlocal process
        with Painter() as painter:
            process = painter._process
            painter.begin(plan, NAMES)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert process is not None and process.returncode is not None


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("from baselines.pictures import painter; painter._get_ready()", ("numba", "scipy", "planners")),
        ("import baselines.pictures.painter, baselines.pictures.stiffness", ("matplotlib",)),
    ],
)
def test_neither_side_imports_what_the_other_needs(statement: str, heavy: tuple[str, ...]) -> None:
    code = f"import sys; {statement}; print(sorted(set({heavy!r}) & set(sys.modules)))"
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.stdout == "[]\n", done.stderr
