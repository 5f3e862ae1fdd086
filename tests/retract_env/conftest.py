"""Environments for a test, closed after it, without a screen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import pytest

from retract_env.env import TissueRetractEnv
from tests.retract_env.playing import BULLET, FEM


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def make() -> Iterator[Callable[..., TissueRetractEnv]]:
    """Makes bare environments, by id; on the finite elements unless told otherwise, on Bullet coarse ones."""
    made: list[TissueRetractEnv] = []

    def make(name: str = FEM, **options: Any) -> TissueRetractEnv:
        if name == BULLET:
            pytest.importorskip("pybullet")
            options = {"resolution": "coarse"} | options
        env = gym.make(name, **options).unwrapped
        assert isinstance(env, TissueRetractEnv)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()
