"""What a vector environment refuses, in one line, and how it stands afterwards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from retract_env.errors import SceneError
from retract_env.given import read_actions, read_options
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene
from retract_env.task import default_scene
from retract_env.task.actions import checked
from retract_env.vector import TissueRetractVectorEnv
from tests.retract_env.vectors import HELD, Player, alike, play, same, vector


def refused(message: str, error: type[Exception] = ValueError) -> Any:
    """Raised, with that in its one line."""
    return pytest.raises(error, match=rf"(?s)^(?!.*\n).*{message}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0, allowed a whole number from 1 on"),
        ({"num_envs": -3}, "num_envs = -3, allowed"),
        ({"num_envs": 1.5}, "num_envs = 1.5, allowed"),
        ({"num_envs": "3"}, "num_envs = '3', allowed"),
        ({"num_envs": "many"}, "num_envs = 'many', allowed"),
        ({"num_envs": None}, "num_envs = None, allowed"),
        ({"num_envs": True}, "num_envs = True, allowed"),
        ({"num_envs": float("inf")}, "num_envs = inf, allowed"),
        ({"threads": 0}, "threads = 0, allowed"),
        ({"threads": []}, r"threads = \[\], allowed"),
        ({"physics": "fem"}, "physics = 'fem', allowed rod$"),
        ({"resolution": "fine"}, "resolution = 'fine', allowed None, "),
        ({"obs": "pixels"}, "obs = 'pixels', allowed state$"),
        ({"render_mode": "human"}, "render_mode = 'human', allowed None$"),
        ({"autoreset_mode": "never"}, "autoreset_mode = 'never', allowed .*NextStep"),
        ({"grasp": "best"}, "grasp = 'best', allowed"),
        ({"grasp": {"x": 1.0, "compression": 1e-3}}, "grasp.x = 1 m, allowed"),
        ({"task": {"steps": 0}}, "task.steps = 0, allowed"),
        ({"task": {"step": 1}}, "task.step"),
        ({"sensors": {"hide": ["nose"]}}, "sensors.hide"),
        ({"sensors": {"noise": -1}}, "sensors.noise"),
        ({"ranges": {"veins": [1, 2]}}, "ranges: allowed with scene = 'random' alone"),
        ({"ranges": {"veins": [2, 1]}, "scene": "random"}, "ranges.veins"),
        ({"ranges": {"length": [9.0, 9.0]}, "scene": "random"}, "length"),
        ({"unknowns": 3}, "unknowns = 3, "),
        ({"unknowns": {"stiffness": 0.1}}, "unknowns.stiffness: unknown key"),
        ({"unknowns": {"modulus": 2.0}}, r"unknowns.modulus = 2.0, allowed \[0, 0.9\]"),
        ({"scene": "no such scene"}, "no such scene"),
        ({"scene": {}}, "missing"),
    ],
    ids=str,
)
def test_wrong_arguments_say_what_is_allowed(arguments: dict[str, Any], message: str) -> None:
    with refused(message):
        TissueRetractVectorEnv(**arguments)


OFF_THE_FLAP = {"x": -0.2, "compression": 1e-3}
IN_THE_BLOCK = {"x": -1e-4, "compression": 1e-3}


@pytest.mark.parametrize(
    ("seed", "options", "message"),
    [
        ([1, 2], {}, "seed has 2 numbers, allowed 3"),
        (None, {"jaws": 3}, "options: unknown jaws"),
        ([0, 1, -1], {}, "seed of environment 2 = -1, allowed None or a whole number from 0 on"),
        (-1, {}, "seed of environment 0 = -1, allowed"),
        (np.array([0, 1.5, 2]), {}, "seed of environment 0 = .*0.0.*, allowed"),
        (None, {"reset_mask": [True]}, r"options\['reset_mask'\] = \[True\], allowed \(3,\) bool"),
        (None, {"reset_mask": np.zeros(3, bool)}, "at least one of them True"),
        (None, {"reset_mask": np.ones(3)}, "bool"),
        (None, {"grasp": "best"}, "grasp = 'best', allowed"),
        (None, {"grasp": OFF_THE_FLAP}, "grasp.x = -0.2 m, allowed"),
        (None, {"grasp": IN_THE_BLOCK}, "grasp.x = -0.0001 m, allowed"),
        (None, {"grasp": {"x": -0.03, "compression": 1.0}}, "grasp.compression = 1 m, allowed"),
        (None, {"scene": "nowhere"}, "nowhere"),
        (None, {"line_of_sight": None}, "line_of_sight = None, allowed"),
        (None, {"line_of_sight": {"camera": [0.1, 0.1], "target": [-0.01, 0.0]}}, "camera"),
        (None, {"line_of_sight": 3}, "line_of_sight"),
        (None, {"unknowns": None}, r"unknowns have shape \(\), allowed \(11,\) or \(3, 11\) numbers in "),
        (None, {"unknowns": [0.5]}, r"unknowns have shape \(1,\), allowed \(11,\) or \(3, 11\) numbers in "),
        (None, {"unknowns": [2.0] * 11}, r"unknowns = \[2.0, .* allowed \(11,\) or \(3, 11\) numbers in "),
    ],
    ids=str,
)
@pytest.mark.parametrize("scene", ["random", "homogeneous"])
def test_wrong_resets(seed: Any, options: dict[str, Any], message: str, scene: str) -> None:
    """Refused in one line; then either nothing has changed or a reset is asked for, and it is as ever."""
    envs, untouched = vector(3, scene=scene), vector(3, scene=scene)
    seen, _ = (play(one, Player(0, 3), 3)[-1][0] for one in (envs, untouched))
    with refused(message):
        envs.reset(seed=seed, options=options)
    chosen = Player(1, 3)(seen)
    try:
        said = envs.step(chosen)
    except ResetNeeded:
        pass
    else:
        same(said, untouched.step(chosen))
    alike([play(one, Player(2, 3), 4, seed=6) for one in (envs, untouched)])


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros(3), r"actions have shape \(3,\), allowed \(2, 3\)"),
        (np.zeros((3, 2)), r"actions have shape \(3, 2\), allowed"),
        (np.zeros((2, 4)), r"shape \(2, 4\)"),
        ([[0, 0, 0], [0, np.nan, 0]], r"action of environment 1 = \[0.0, nan, 0.0\], allowed finite numbers"),
        ([[np.inf, 0, 0], [0, 0, 0]], "action of environment 0 = .*allowed finite"),
        ([["up", 0, 0], [0, 0, 0]], "actions = .*allowed numbers"),
        ([[0, 0, 0], [0, 0]], "actions = .*allowed numbers"),
        (None, "allowed"),
    ],
    ids=str,
)
def test_what_are_no_actions_changes_nothing(actions: Any, message: str) -> None:
    envs, untouched = vector(2, scene="random"), vector(2, scene="random")
    for one in (envs, untouched):
        one.reset(seed=0)
    with refused(message):
        envs.step(actions)
    same(envs.step(np.zeros((2, 3))), untouched.step(np.zeros((2, 3))))


def test_actions_beyond_the_box_are_clipped() -> None:
    envs, other = vector(2, scene="random"), vector(2, scene="random")
    for one in (envs, other):
        one.reset(seed=0)
    far = np.array([[0.0, -5.0, 9.0], [-0.2, -0.4, 0.0]])
    same(envs.step(far), other.step(np.clip(far, -1, 1)))


def test_a_step_needs_a_reset() -> None:
    envs = vector(3, autoreset_mode="Disabled")
    with refused("reset", ResetNeeded):
        envs.step(np.zeros((3, 3)))
    envs.reset(options={"reset_mask": np.array([True, True, False])})
    with refused("reset", ResetNeeded):
        envs.step(np.zeros((3, 3)))
    envs.reset(options={"reset_mask": np.array([False, False, True])})
    tears = np.array([[0.0, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, -0.5, 0.0]])
    assert envs.step(tears)[2].tolist() == [False, True, False]
    with refused("environments that are over, 1: reset", ResetNeeded):
        envs.step(np.zeros((3, 3)))
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    envs.step(np.zeros((3, 3)))


def test_scenes_for_slots_that_there_are() -> None:
    envs = vector(2)
    for k in (2, -1):
        with refused(rf"k = {k}, allowed 0 to 1"):
            envs.set_scene(k, "random")
    with refused("nowhere"):
        envs.set_scene(0, "nowhere")
    alike([play(one, Player(0, 2), 3) for one in (envs, vector(2))])


def small() -> Scene:
    scene = default_scene().dump()
    scene["tissue"]["length"] = 0.02
    return Scene.from_data(scene)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_grasp_off_a_slots_flap_is_said_whenever_its_episode_begins(mode: str) -> None:
    envs = vector(2, grasp=HELD, autoreset_mode=mode, task={"steps": 2})
    envs.reset(seed=0)
    envs.set_scene(1, small())
    with refused("grasp.x = -0.03 m, allowed"):
        for _ in range(4):
            envs.step(np.zeros((2, 3)))
    with refused("grasp.x = -0.03 m, allowed"):
        envs.reset()
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 3)))
    envs.set_scene(1, None)
    envs.reset(seed=3)
    same(envs.step(np.zeros((2, 3))), _held(mode))


def _held(mode: str) -> Any:
    envs = vector(2, grasp=HELD, autoreset_mode=mode, task={"steps": 2})
    envs.reset(seed=3)
    return envs.step(np.zeros((2, 3)))


def test_a_given_grasp_is_looked_at_on_every_random_flap() -> None:
    """Only some of the flaps are too short for it."""
    ranges = {"length": [0.03, 0.06], "veins": [0, 0]}
    with refused("grasp.x = -0.045 m, allowed"):
        vector(40, scene="random", ranges=ranges, grasp={"x": -0.045, "compression": 1e-3}).reset(seed=0)


def test_where_a_random_flap_fails_to_begin_all_have_to_be_reset() -> None:
    """Else the slot goes on that is over, and others whose first observation nobody has seen."""
    envs = vector(
        16, scene="random", ranges={"height": [1e-4, 4.4e-3], "veins": [5, 10]}, autoreset_mode="SameStep"
    )
    rng = np.random.default_rng(0)
    for seed in range(40):
        try:
            envs.reset(seed=seed)
            for _ in range(30):
                envs.step(rng.uniform(-1, 1, (16, 3)))
        except SceneError:
            with pytest.raises(ResetNeeded):
                envs.step(np.zeros((16, 3)))
            return
    raise AssertionError("every flap had room")


@pytest.mark.parametrize("seed", [1.5, {"a": 1}, "seven"])
def test_a_seed_that_is_none_is_one_line(seed: Any) -> None:
    with refused("seed"):
        vector(3).reset(seed=seed)


def test_wrong_seeds_change_nothing() -> None:
    envs, untouched = vector(2, scene="random"), vector(2, scene="random")
    for one in (envs, untouched):
        one.reset(seed=4)
    with refused("seed of environment 1 = -1, allowed"):
        envs.reset(seed=[0, -1])
    same(envs.step(np.zeros((2, 3))), untouched.step(np.zeros((2, 3))))
    same(envs.reset(), untouched.reset())


def test_numbers_beyond_all_floats_are_one_line() -> None:
    huge = 10**400
    with refused("action"):
        checked([huge, 0, 0])
    with refused("actions"):
        read_actions([[huge, 0, 0]], 1)
    with refused("grasp.x"):
        Grasp(-huge, 1e-3)
    with refused("path.waypoints"):
        JawPath([[huge, 0, 0, 1], [0, 0, 0, 1]], "far")  # type: ignore[arg-type]
    with refused("options: unknown 1"):
        read_options({1: 2})  # type: ignore[dict-item]
    with refused("grasp.x = '-0.03'"):
        Grasp("-0.03", 1e-3)  # type: ignore[arg-type]
