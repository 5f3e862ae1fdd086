"""docs/how-to-add.md: each section's example, executed as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from rich.console import Console

from baselines.paper.reproduce import names, reproduce
from baselines.paper.studies import STUDIES
from planners.paths import PATHS
from retract_env.physics.registry import PHYSICS

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "how-to-add.md").read_text("utf-8")


def example(heading: str) -> str:
    """The Python of a section, all its blocks."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))


def test_a_path(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(PATHS, "lifted", PATHS["ctc"])  # taken out again after the test
    space: dict[str, Any] = {}
    exec(compile(example("A path"), "a path", "exec"), space)
    assert PATHS["lifted"] is space["lifted"]
    assert space["lifted"](space["scene"], space["grasp"]).kind == "lifted"
    assert capsys.readouterr().out.strip() in ("ok", "strain", "slip", "release", "not_visible")


def test_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "firmer.py").write_text(example("A study"), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(STUDIES, "firmer", "firmer")
    assert names("firmer") == ["firmer"]
    written = reproduce(["firmer"], tmp_path, "coarse", workers=1, console=Console(quiet=True))
    assert [path.name for path in written] == ["firmer.csv", "firmer.png", "firmer.md"]
    assert "| a firmer grip strains the tissue more |" in (tmp_path / "firmer.md").read_text("utf-8")


def test_a_physics(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The toy is listed, has its environment and plays an episode to its end."""
    monkeypatch.setitem(PHYSICS, "sheet", PHYSICS["fem"])  # so that it is taken out again
    registered = set(gym.registry)
    try:
        exec(compile(example("A physics"), "example", "exec"), {})
        assert "sheet" in PHYSICS and PHYSICS["sheet"].env_id in gym.registry
        assert capsys.readouterr().out == "True 12\n"
    finally:
        for name in set(gym.registry) - registered:
            del gym.registry[name]
