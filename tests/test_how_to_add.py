"""How to add ...: each section's example is run."""

from __future__ import annotations

import re
from pathlib import Path

import gymnasium as gym
import pytest

from retract_env.physics.registry import PHYSICS

ROOT = Path(__file__).resolve().parent.parent
SECTIONS = (ROOT / "docs" / "how-to-add.md").read_text("utf-8").split("\n## ")[1:]


def example(heading: str) -> str:
    (section,) = (section for section in SECTIONS if section.startswith(heading))
    return "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))


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
