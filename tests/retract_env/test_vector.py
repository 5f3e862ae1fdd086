"""The vector environment on rods says what single ones say, to the last bit: modes, scenes, options."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from retract_env.env import TissueRetractEnv
from retract_env.scene import UNKNOWNS, LineOfSight, load_scene
from retract_env.task import SIZE, TaskConfig, default_scene
from tests.retract_env.extremes import corner, scene_with
from tests.retract_env.playing import ROD
from tests.retract_env.vectors import (  # fmt: skip
    DISABLED,
    HELD,
    NEXT,
    SAME,
    Player,
    alike,
    ends,
    play,
    row,
    same,
    singles,
    vector,
)

SHIPPED = ("homogeneous", "homogeneous_near", "ten_veins", "twenty_veins", "wide")
LINE = {"camera": [-0.09, 0.05], "target": [-0.015, 0.0]}
DRAW = np.linspace(-1, 1, len(UNKNOWNS)).tolist()
LIMITS = default_scene().limits.model_dump()
SHORT: dict[str, Any] = {"steps": 5}
MODES = [NEXT, SAME, DISABLED]

CASES: dict[str, dict[str, Any]] = {
    "random": {"scene": "random"},
    "default": {},
    "veins": {"scene": "twenty_veins"},
    "ranges": {
        "scene": "random",
        "ranges": {"veins": [0, 3], "length": [0.04, 0.06], "height": [0.004, 0.005], "depth": [0.004, 0.03]},
    },
    "spring": {"scene": "random", "grasp": "spring", "task": SHORT},
    "spring on veins": {"scene": "ten_veins", "grasp": "spring"},
    "given": {"scene": "random", "grasp": HELD},
    "given on veins": {"scene": "ten_veins", "grasp": HELD, "task": SHORT},
    "noise": {"scene": "random", "sensors": {"noise": 0.05}, "task": SHORT},
    "noise and grasp": {"scene": "random", "sensors": {"noise": {"strain": 0.1}}, "grasp": HELD},
    "hidden": {"scene": "random", "sensors": {"noise": {"k_eq": 0.5}, "hide": ["lower", "strain"]}},
    "unknown": {"scene": "random", "unknowns": True},
    "unknown, by force": {"scene": "ten_veins", "unknowns": True, "grip": "force", "grasp": "spring"},
    "unknown, held": {"scene": "random", "unknowns": True, "grasp": HELD, "sensors": {"noise": 0.02}},
    "hardly known": {
        "scene": "random",
        "unknowns": {"closing": 2e-3, "thickness": 0.4, "grasp": 0.02, "target": 0.02, "jaw_width": 0.5},
    },
    "hardly known, cost": {
        "scene": "random",
        "unknowns": {"closing": 1e-3},
        "grasp": HELD,
        "task": {"limits": "cost", "steps": 6},
    },
    "cost": {"scene": "random", "task": {"limits": "cost", "steps": 12}},
    "cost, held": {"scene": "random", "grasp": "spring", "task": {"limits": "cost", "steps": 9, "cap": 5.0}},
    "other task": {
        "scene": "random",
        "task": {
            "weights": {"exposure": 0.3, "clearance": -2.0, "strain": 0.0, "success": 7.0, "failure": 0.0},
            "move": [1e-3, 3e-3, 0.2],
            "compression": [0.1, 0.4],
            "cap": 1.5,
        },
    },
}


def both(count: int, mode: AutoresetMode, steps: int, seed: Any = 0, **options: Any) -> list[Any]:
    """Play the same in both; what they say, which is compared, once."""
    native, single = vector(count, autoreset_mode=mode, **options), singles(count, mode, **options)
    said = play(native, Player(1, count), steps, seed)
    same(said, play(single, Player(1, count), steps, seed))
    assert native.np_random_seed == single.np_random_seed
    native.close()
    single.close()
    return said


@pytest.mark.parametrize("mode", MODES, ids=[mode.value for mode in MODES])
@pytest.mark.parametrize("case", CASES)
def test_it_says_what_single_ones_say(case: str, mode: AutoresetMode) -> None:
    """Every case in one mode for long, in the others as long as it takes to begin anew a few times."""
    long = MODES[list(CASES).index(case) % 3] is mode
    both(4, mode, 20 if long else 6, **CASES[case])


def test_episodes_of_every_kind_are_compared() -> None:
    easy = scene_with(
        line_of_sight=LineOfSight.at(-0.03, 0.3).model_dump(), limits=LIMITS | {"friction": 2.0}
    ).dump()
    assert {"ok", "slip", "strain", "release"} <= ends(both(12, SAME, 24, scene=easy))
    assert "time" in ends(both(4, NEXT, 12, task=SHORT))
    broken = both(12, NEXT, 24, scene=easy, task={"limits": "cost", "steps": 16})
    assert {"ok", "slip", "release"} <= ends(broken)
    assert any((one[4]["cost"] > 0).any() for one in broken[1:])


@pytest.mark.parametrize("mode", MODES, ids=[mode.value for mode in MODES])
def test_flaps_that_no_equilibrium_is_found_for(mode: AutoresetMode) -> None:
    scenes = [corner(number) for number in (20, 53, 2)]
    task = {"limits": "cost", "steps": 3}
    native, single = (
        vector(len(scenes), autoreset_mode=mode, task=task),
        singles(len(scenes), mode, scenes, task=task),
    )
    for k, scene in enumerate(scenes):
        native.set_scene(k, scene)
    said = play(native, Player(1, len(scenes)), 6)
    same(said, play(single, Player(1, len(scenes)), 6))
    assert "diverged" in ends(said)


@pytest.mark.parametrize("mode", MODES, ids=[mode.value for mode in MODES])
def test_every_slot_has_a_scene_of_its_own(mode: AutoresetMode) -> None:
    scenes: list[Any] = [*SHIPPED, "random", default_scene().dump(), load_scene("ten_veins"), "random"]
    native = vector(len(scenes), autoreset_mode=mode, scene="random", task={"steps": 7})
    for k, scene in enumerate(scenes):
        native.set_scene(k, scene)
    single = singles(len(scenes), mode, scenes, task={"steps": 7})
    same(play(native, Player(3, len(scenes)), 12), play(single, Player(3, len(scenes)), 12))


@pytest.mark.parametrize(
    "options",
    [
        {"scene": "twenty_veins"},
        {"scene": "random"},
        {"scene": None},
        {"grasp": "spring"},
        {"grasp": HELD},
        {"grasp": "agent"},
        {"line_of_sight": LINE},
        {"unknowns": DRAW},
        {"scene": "random", "unknowns": DRAW, "grasp": HELD},
        {"scene": "ten_veins", "grasp": "spring", "line_of_sight": LINE},
    ],
    ids=str,
)
@pytest.mark.parametrize(
    "own", [{"scene": "random"}, {"scene": "homogeneous_near", "grasp": "spring"}], ids=str
)
def test_options_are_for_one_episode_alone(options: Any, own: Any) -> None:
    """In a mode that goes round with the cases."""
    mode = MODES[(len(str(options)) + len(own)) % 3]
    task: dict[str, Any] = {"task": {"steps": 3}, "sensors": {"noise": 0.01}}
    native, single = vector(3, autoreset_mode=mode, **own, **task), singles(3, mode, **own, **task)
    for seed in (5, None):
        said = [play(envs, Player(2, 3), 6, seed, dict(options)) for envs in (native, single)]
        alike(said)
    alike([play(envs, Player(4, 3), 4, None) for envs in (native, single)])


def test_scenes_change_between_episodes() -> None:
    """Seven veins more than there was room for, then back; another slot does not notice."""
    native, alone = (
        vector(2, scene="random", ranges={"veins": [0, 2]}),
        vector(2, scene="random", ranges={"veins": [0, 2]}),
    )
    first = [play(envs, Player(0, 2), 3) for envs in (native, alone)]
    alike(first)
    native.set_scene(0, "twenty_veins")
    second = [play(envs, Player(0, 2), 6, None) for envs in (native, alone)]
    same(row(second[0], 1), row(second[1], 1))
    expected = play(singles(1, scene="twenty_veins"), Player(0, 1), 6)
    native.set_scene(0, "twenty_veins")
    same(row(play(native, Player(0, 2), 6), 0), row(expected, 0))
    native.set_scene(0, "random")
    alike([play(envs, Player(0, 2), 6) for envs in (native, alone)])


@pytest.mark.parametrize("mode", [NEXT, SAME], ids=["NextStep", "SameStep"])
def test_resets_by_mask_in_the_middle(mode: AutoresetMode) -> None:
    native, single = vector(4, autoreset_mode=mode, scene="random"), singles(4, mode, scene="random")
    for envs in (native, single):
        envs.reset(seed=0)
    rng, player = np.random.default_rng(0), (Player(1, 4), Player(1, 4))
    seen = [envs.reset(seed=3)[0] for envs in (native, single)]
    for k in range(12):
        said: Any = [envs.step(p(s)) for envs, p, s in zip((native, single), player, seen, strict=True)]
        alike(said)
        seen = [one[0] for one in said]
        if k % 3 == 1:
            mask = rng.random(4) < 0.5
            mask[k % 4] = True
            seeds = [None, 7 + k, None, k]
            said = [envs.reset(seed=seeds, options={"reset_mask": mask.copy()}) for envs in (native, single)]
            alike(said)
            seen = [one[0] for one in said]


def test_it_is_made_as_gymnasium_makes_vectors() -> None:
    envs = vector(3)
    single = singles(3)
    for name in ("single_action_space", "action_space", "single_observation_space", "observation_space"):
        assert getattr(envs, name) == getattr(single, name)
    assert (
        envs.metadata["autoreset_mode"] is NEXT
        and vector(1, autoreset_mode="SameStep").metadata["autoreset_mode"] is SAME
    )
    assert (
        envs.spec is not None
        and envs.spec.id == ROD
        and repr(envs) == f"TissueRetractVectorEnv({ROD}, num_envs=3)"
    )
    assert envs.observation_space.shape == (3, SIZE) and envs.task_config == TaskConfig()
    sync = gym.make_vec(ROD, num_envs=3, vectorization_mode="sync")
    assert np.array_equal(sync.reset(seed=0)[0], envs.reset(seed=0)[0])
    sync.close()


def test_gymnasiums_wrappers_run_on_it() -> None:
    wrapped: Any = gym.wrappers.vector.RecordEpisodeStatistics(vector(4, task=SHORT))
    wrapped = gym.wrappers.vector.NormalizeObservation(wrapped)
    wrapped.reset(seed=0)
    for _ in range(6):
        _, _, _, truncated, infos = wrapped.step(np.zeros((4, 3), np.float32))
        if truncated.any():
            assert (infos["episode"]["l"][truncated] == 5).all()


def test_what_it_returns_is_the_callers() -> None:
    """Arrays that are written into change nothing, and later steps do not change them."""
    envs, other = (
        vector(3, scene="random", autoreset_mode="SameStep"),
        vector(3, scene="random", autoreset_mode="SameStep"),
    )
    player, twin = Player(0, 3), Player(0, 3)
    seen, again = envs.reset(seed=0)[0], other.reset(seed=0)[0]
    for _ in range(6):
        said, expected = envs.step(player(seen)), other.step(twin(again))
        same(said, expected)
        seen, again = said[0].copy(), expected[0]
        rows: list[Any] = [*said[:4], *(v for v in said[4].values() if isinstance(v, np.ndarray))]
        for array in rows:
            array[...] = 0 if array.dtype != object else None


def test_the_single_one_runs_through_its_vector_of_one() -> None:
    env = TissueRetractEnv("rod", scene="random")
    envs, player = vector(1, scene="random", autoreset_mode="Disabled"), Player(5, 1)
    seen, told = env.reset(seed=9)
    same(seen, envs.reset(seed=9)[0][0])
    over = False
    while not over:
        action = player(seen[None])
        seen, reward, terminated, truncated, told = env.step(action[0])
        rows = envs.step(action)
        over = terminated or truncated
        same(
            [seen, reward, terminated, truncated],
            [rows[0][0], *(float(rows[1][0]), bool(rows[2][0]), bool(rows[3][0]))],
        )
        assert told["reward_terms"] == {n: rows[4]["reward_terms"][n][0] for n in told["reward_terms"]}
