"""docs/how-to-add.md: each section's example, executed as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from planners import PLANNERS, certify

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "how-to-add.md").read_text("utf-8")


def example(heading: str) -> str:
    """The Python of a section, all its blocks."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))


def test_a_planner(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(PLANNERS, "firmer", PLANNERS["ctc"])  # taken out again after the test
    space: dict[str, Any] = {}
    exec(compile(example("A planner"), "a planner", "exec"), space)
    assert PLANNERS["firmer"] is space["plan_firmer"]
    assert capsys.readouterr().out.strip() == "ok 3"
    best = space["best"]
    judged = certify(space["scene"], best.grasp, best.path, "coarse")
    assert judged.to_json() == best.certificate.to_json()
