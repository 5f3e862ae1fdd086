"""Whatever is done to many flaps: no NaN, all promises of spaces and rewards kept, no memory lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from retract_env.task import SLICES, TaskConfig
from tests.retract_env.extremes import corner
from tests.retract_env.vectors import Player, ends, vector

WEIGHTS = {
    "exposure": -2.0,
    "clearance": 3.0,
    "strain": 1.0,
    "friction": -4.0,
    "success": -1.0,
    "failure": 5.0,
}


class Watched:
    """Steps, and looks at all that is said."""

    def __init__(self, envs: Any):
        self.envs, self.ended, self.diverged, self.returns = envs, 0, 0, np.zeros(envs.num_envs)
        self.low, self.high = envs.task_config.reward_range
        self.seen = envs.reset(seed=0)[0]
        self.most = np.zeros(envs.num_envs)
        self.kinds: set[str] = set()

    def step(self, actions: Any) -> None:
        space, slack = self.envs.single_observation_space, 1e-9
        self.seen, rewards, terminated, truncated, infos = said = self.envs.step(actions)
        assert ((self.seen >= space.low) & (self.seen <= space.high)).all()  # so no NaN
        assert not (terminated & truncated).any()
        assert ((rewards >= self.low - slack) & (rewards <= self.high + slack)).all()
        self.returns += rewards
        assert ((self.returns >= self.low - slack) & (self.returns <= self.high + slack)).all()
        over = terminated | truncated
        told = infos["final_info"] if over.any() else infos
        assert np.isfinite(infos["clearance"]).all() and np.isfinite(infos["max_strain"]).all()
        assert not np.isnan(infos["required_friction"]).any()
        assert ((infos["exposure"] >= 0) & (infos["exposure"] <= 1)).all()
        assert set(np.unique(infos["cost"])) <= {0.0, 1.0, 2.0}
        if over.any():
            for k in np.flatnonzero(over):
                good, failure = told["is_success"][k], told["failure"][k]
                self.kinds.add(failure or ("ok" if good else "time"))
                assert not (good and failure)
                if good:
                    assert terminated[k] and told["exposure"][k] == pytest.approx(1, abs=1e-9)
                    assert told["cost"][k] == 0
            self.diverged += int((told["failure"][over] == "diverged").sum())
            assert (truncated[over] | (told["failure"][over] != "diverged")).all()
            self.ended += int(over.sum())
        self.returns[over] = 0.0
        assert len(said) == 5


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({"scene": "random"}, 80),
        ({"scene": "random", "sensors": {"noise": 1.0}, "task": {"weights": WEIGHTS, "cap": 1.5}}, 40),
        ({"scene": "random", "task": {"limits": "cost", "move": [0.05, 0.05, 1.5]}}, 40),
    ],
    ids=["plain", "noise", "wild"],
)
def test_spaces_and_rewards_keep_their_promise(options: Any, steps: int) -> None:
    envs = vector(128, threads=2, autoreset_mode="SameStep", **options)
    watched, player = Watched(envs), Player(0, 128)
    for _ in range(steps):
        watched.step(player(watched.seen))
    assert watched.ended > 50 and {"strain", "release"} <= watched.kinds
    envs.close()


def test_extreme_flaps_keep_it_too() -> None:
    envs = vector(64, autoreset_mode="SameStep", task={"limits": "cost", "steps": 6})
    for k in range(64):
        envs.set_scene(k, corner(k, 1e-3 if k % 3 else 0.24))
    watched, player = Watched(envs), Player(0, 64)
    for _ in range(8):
        watched.step(player(watched.seen))
    assert "diverged" in watched.kinds


def test_the_steps_left_are_shown() -> None:
    envs = vector(3, task={"steps": 4, "limits": "cost"}, grasp={"x": -0.03, "compression": 1e-3})
    seen = [envs.reset(seed=0)[0]]
    seen += [envs.step(np.zeros((3, 3)))[0] for _ in range(6)]
    left = np.array(seen)[:, :, SLICES["time_left"]].squeeze(-1).T
    assert np.array_equal(left, np.tile(np.array([1, 0.75, 0.5, 0.25, 0, 1, 0.75], np.float32), (3, 1)))
    assert TaskConfig().steps == 64 and ends([]) == set()


@pytest.mark.slow
def test_a_million_random_steps() -> None:
    """No crash, nothing out of bounds, and the memory that the first tenth of them needed."""
    resource = pytest.importorskip("resource")
    envs = vector(1000, threads=2, scene="random", autoreset_mode="SameStep")
    watched, rng, used = Watched(envs), np.random.default_rng(0), []
    for _ in range(1000):
        watched.step(rng.uniform(-1, 1, (1000, 3)))
        used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert watched.diverged / watched.ended < 1e-4
    assert used[-1] - used[100] < 20_000  # of the peak, in kB
    envs.close()
