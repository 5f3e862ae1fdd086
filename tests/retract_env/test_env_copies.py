"""Copies of an environment in the middle of an episode go on as the original does, to the last bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from retract_env.env import TissueRetractEnv
from tests.retract_env.playing import BULLET, FEM, LIFT, ROD, digest

COPY: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


def go_on(env: TissueRetractEnv, steps: int) -> list[Any]:
    """All that it says of some steps more, then of the next episode, whose scene its own generator draws."""
    said: list[Any] = []
    for k in range(steps):
        said.append(env.step(LIFT * (1 - 0.1 * k)))
        if said[-1][2] or said[-1][3]:
            break
    said.append(env.reset())
    said.append(env.step(env.action_space.sample()))
    return said


@pytest.mark.parametrize("how", COPY.values(), ids=COPY)
@pytest.mark.parametrize(
    ("name", "options"),
    [
        (FEM, {"scene": "random", "grasp": "spring"}),
        (FEM, {"scene": "random", "sensors": {"noise": 0.01}, "obs": "state"}),
        (BULLET, {"grasp": {"x": -0.03, "compression": 1e-3}}),
        (ROD, {"scene": "random", "sensors": {"noise": 0.01}}),
        (FEM, {"scene": "random", "unknowns": True}),
        (BULLET, {"unknowns": True, "grasp": {"x": -0.03, "compression": 1e-3}}),
        (ROD, {"scene": "random", "unknowns": True, "grip": "force"}),
    ],
    ids=["fem", "noisy", "bullet", "rod", "unknown", "unknown on bullet", "unknown on the rod"],
)
def test_a_copy_goes_on_as_the_original(
    make: Callable[..., TissueRetractEnv], how: Any, name: str, options: dict[str, Any]
) -> None:
    env = make(name, **options)
    env.reset(seed=2)
    env.action_space.seed(5)
    for action in (np.array([-0.2, 0.1, 0.0]), LIFT, LIFT / 2):
        env.step(action)
    first, second = how(env), how(env)
    expected = digest(go_on(env, 3))
    assert digest(go_on(first, 3)) == expected
    third = how(second)  # of one that has not moved yet
    assert digest(go_on(second, 3)) == digest(go_on(third, 3)) == expected
    for copied in (first, second, third):
        copied.close()


@pytest.mark.parametrize("how", COPY.values(), ids=COPY)
def test_a_copy_before_and_after_an_episode(make: Callable[..., TissueRetractEnv], how: Any) -> None:
    env = make()
    fresh = how(env)
    env.reset(seed=0)
    begun = how(env)
    env.step(np.array([0.0, 1.0, 0.0]))  # tears
    over = how(env)
    assert digest([fresh.reset(seed=0)]) == digest([env.reset(seed=0)])
    assert begun.step(np.array([0.0, 1.0, 0.0]))[2]
    with pytest.raises(ResetNeeded):
        over.step(LIFT)
    for copied in (fresh, begun, over):
        copied.close()


def test_a_copy_draws_what_the_original_draws(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(BULLET, camera="3d", render_mode="rgb_array", grasp={"x": -0.03, "compression": 1e-3})
    env.reset(seed=0)
    env.step(LIFT)
    copied = copy.deepcopy(env)
    assert np.array_equal(copied.render(), env.render())  # type: ignore[arg-type]
    copied.close()
