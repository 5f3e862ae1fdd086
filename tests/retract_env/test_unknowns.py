"""Episodes on flaps that are not quite what their scene says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.env import TissueRetractEnv
from retract_env.scenarios import scenario
from retract_env.scene import UNKNOWNS, Uncertainty, load_scene
from retract_env.task import SLICES
from tests.retract_env.playing import BULLET, FEM, LIFT, ROD, digest, play
from tests.retract_env.vectors import Player, row, same, vector
from tests.retract_env.vectors import play as play_many

Make = Callable[..., TissueRetractEnv]
CLOSE = np.array([-0.2, 0.1, 0.0])
HELD: dict[str, dict[str, Any]] = {"compression": {}, "force": {"grip": "force"}}
STATED = ("target", "slope", "nearness", "k_eq", "time_left")
"""parts of an observation that are those of the scene as it is stated"""
NOWHERE = {"closing": 4e-3}


def z_of(**named: float) -> NDArray[np.float64]:
    z = np.zeros(len(UNKNOWNS))
    for name, value in named.items():
        z[UNKNOWNS.index(name)] = value
    return z


def known(name: str) -> dict[str, Any]:
    scene = load_scene(name)
    return scene.model_copy(update={"uncertainty": Uncertainty.none()}).dump()


def act(env: TissueRetractEnv, moves: int, **options: Any) -> list[Any]:
    said: list[Any] = [env.reset(seed=1, options=options or None), env.step(CLOSE)]
    for k in range(moves):
        if said[-1][2] or said[-1][3]:
            break
        said.append(env.step(LIFT * (1 - 0.1 * k)))
    return said


@pytest.mark.parametrize("grip", HELD)
@pytest.mark.parametrize("name", [FEM, ROD, BULLET])
def test_where_nothing_is_unknown_an_episode_is_the_certain_one(make: Make, name: str, grip: str) -> None:
    """To the last bit, also with a grasp at the free end, which has half a patch."""
    scene = known("ten_veins")
    certain, unknown = (make(name, scene=scene, unknowns=on, **HELD[grip]) for on in (False, True))
    said = act(unknown, 2)
    for one in said:
        assert np.abs(one[-1].pop("unknowns")).max() <= 1
    assert digest(said) == digest(act(certain, 2))
    end = np.array([-1.0, 0.3, 0.0])
    for env in (certain, unknown):
        env.reset()
    assert np.array_equal(unknown.step(end)[0], certain.step(end)[0])


def test_many_where_nothing_is_unknown() -> None:
    none = dict.fromkeys((*UNKNOWNS, "force_floor"), 0.0) | {"poisson": None}
    certain = play_many(vector(9, scene="random", autoreset_mode="Disabled"), Player(1, 9), 1)
    unknown = play_many(vector(9, scene="random", unknowns=none, autoreset_mode="Disabled"), Player(1, 9), 1)
    for one in unknown:
        assert one[-1].pop("unknowns").shape == (9, len(UNKNOWNS)) and one[-1].pop("_unknowns").all()
    same(unknown, certain)


@pytest.mark.parametrize("grip", HELD)
@pytest.mark.parametrize("name", [FEM, ROD])
def test_an_episode_is_the_certain_one_on_the_scenarios_flap(make: Make, name: str, grip: str) -> None:
    """Driven to the same poses. The commanded path, through `scenario`, is the true one."""
    scene, z = load_scene("ten_veins"), np.random.default_rng(4).uniform(-1, 1, len(UNKNOWNS))
    env, twin = make(name, scene=scene.dump(), **HELD[grip]), make(name, scene=scene.dump(), **HELD[grip])
    said, meant = act(env, 3, unknowns=z), act(twin, 3)
    assert "unknowns" not in meant[0][1] and said[0][1]["unknowns"] == pytest.approx(z, abs=0)
    grasp, path = twin.episode.grasp, twin.episode.path
    assert grasp is not None and path is not None and env.episode.path is not None
    there = scenario(scene, grasp, path, z)
    assert there is not None
    drawn, held, true = there
    assert drawn == env.episode.task.scene and env.episode.task.stated == scene
    assert env.episode.grasp is not None and env.episode.grasp.x == held.x
    ours, theirs = env.episode.path.poses, true.poses
    columns = slice(0, 4 if grip == "compression" else 3)
    assert ours[1:, columns] == pytest.approx(theirs[1:, columns], abs=1e-12)

    certain = make(name, scene=drawn, **HELD[grip])
    expected: list[Any] = [certain.reset(options={"grasp": {"x": held.x, **held.firmness}})]
    expected += [certain.step(LIFT * (1 - 0.1 * k)) for k in range(len(said) - 2)]
    for one, other in zip(said[1:], expected, strict=True):
        for value in ("max_strain", "required_friction", "clearance", "exposure"):
            # what the jaws were sent to is rounded differently; by force they are searched for
            assert one[-1][value] == pytest.approx(other[-1][value], rel=1e-6, abs=1e-9), value
        assert one[-1]["failure"] == other[-1]["failure"]
        forces, unit = one[0][SLICES["forces"]], drawn.tissue.modulus / scene.tissue.modulus
        assert forces == pytest.approx(unit * other[0][SLICES["forces"]], rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("grip", HELD)
@pytest.mark.parametrize("name", [FEM, ROD, BULLET])
def test_what_is_known_does_not_depend_on_the_draw(make: Make, name: str, grip: str) -> None:
    """Where the jaws were sent to is the same but for rounding; by force they feel where they close."""
    env = make(name, scene="ten_veins", **HELD[grip])
    rng = np.random.default_rng(0)
    zs = [np.zeros(len(UNKNOWNS)), *rng.uniform(-1, 1, (3, len(UNKNOWNS)))]
    told = [act(env, 2, unknowns=z) for z in zs]
    for step in range(4):
        for other in told[1:]:
            seen, first = other[step][0], told[0][step][0]
            for part in STATED:
                assert np.array_equal(seen[SLICES[part]], first[SLICES[part]]), part
            sent = ["gripper", "angle"] + ["separation"] * (grip == "compression" or step == 0)
            for part in sent:
                assert seen[SLICES[part]] == pytest.approx(first[SLICES[part]], abs=1e-6), part
            assert not np.array_equal(seen[SLICES["upper"]], first[SLICES["upper"]])
            assert seen in env.observation_space


def test_a_force_sensor_feels_what_the_jaws_hold_by(make: Make) -> None:
    """Both press with the mean that was asked for, as it turned out; before the grasp nothing is felt."""
    for name, part in ((ROD, 1e-6), (FEM, 1e-3), (BULLET, 0.03)):
        env = make(name, scene="ten_veins", grip="force")
        scene = env.reset(options={"grasp": {"x": -0.03, "force": 0.05}, "unknowns": z_of(force=1.0)})
        tissue, jaws = env.episode.task.stated.tissue, env.episode.task.stated.jaws
        forces = scene[0][SLICES["forces"]]
        unit = tissue.modulus * jaws.width * tissue.depth
        assert (forces[0] + forces[2]) / 2 == pytest.approx(1.1 * 0.05 / unit, rel=part)
        assert (env.reset()[0][SLICES["forces"]] == 0).all()


@pytest.mark.parametrize("name", [FEM, ROD, BULLET])
def test_a_seed_names_the_draw(make: Make, name: str) -> None:
    env, other = make(name, scene="random", unknowns=True), make(name, scene="random", unknowns=True)
    said = play(env, 3, 2)
    assert digest(play(other, 3, 2)) == digest(said)
    first = said[0][1]["unknowns"]
    assert all(np.array_equal(one[-1]["unknowns"], first) for one in said)
    assert not np.array_equal(env.reset()[1]["unknowns"], first)
    # the same episode again, by its draw
    again = make(name, scene="random")
    again.reset(seed=3, options={"unknowns": first})
    assert again.episode.task.scene == other.episode.task.scene


def test_many_draw_what_single_ones_draw_and_take_what_they_are_given() -> None:
    """A draw for each, or one for all; then they go on with their own."""
    envs, again = (vector(3, scene="random", unknowns=True, autoreset_mode="Disabled") for _ in range(2))
    _, infos = envs.reset(seed=5)
    for k in range(3):
        env = TissueRetractEnv("rod", scene="random", unknowns=True)
        assert np.array_equal(env.reset(seed=5 + k)[1]["unknowns"], infos["unknowns"][k])
    z = np.random.default_rng(0).uniform(-1, 1, (3, len(UNKNOWNS)))
    for given in (z, z[0]):
        _, told = envs.reset(options={"unknowns": given, "reset_mask": np.array([True, False, True])})
        assert np.array_equal(told["unknowns"][[0, 2]], np.broadcast_to(given, z.shape)[[0, 2]])
        assert told["_unknowns"].tolist() == [True, False, True] and (told["unknowns"][1] == 0).all()
    again.reset(seed=5)
    assert np.array_equal(envs.reset(seed=6)[1]["unknowns"], again.reset(seed=6)[1]["unknowns"])
    assert "unknowns" not in vector(2).reset(seed=0)[1]


def test_ranges_that_are_given_count_instead_of_the_scenes(make: Make) -> None:
    for given, modulus, target in (
        (True, 1.3, 5e-4), ({"modulus": 0.5}, 1.5, 5e-4), ({"target": 2e-3, "modulus": 0}, 1.0, 2e-3),
        ("none", 1.0, 0.0),
    ):  # fmt: skip
        env = make(ROD, unknowns=given)
        env.reset(options={"unknowns": z_of(modulus=1.0, target=1.0)})
        stated, there = env.episode.task.stated, env.episode.task.scene
        assert there.tissue.modulus == pytest.approx(modulus * stated.tissue.modulus)
        shift = there.line_of_sight.target[0] - stated.line_of_sight.target[0]
        assert shift == pytest.approx(target, abs=1e-15)


@pytest.mark.parametrize("limits", ["end", "cost"])
@pytest.mark.parametrize("name", [FEM, ROD, BULLET])
def test_jaws_that_do_not_close_on_the_flap_have_let_go(make: Make, name: str, limits: str) -> None:
    env = make(name, unknowns={"closing": 4e-3}, task={"limits": limits})
    z = z_of(closing=-1.0)
    before, told = env.reset(options={"unknowns": z})
    assert told["failure"] == "" and told["required_friction"] == 0
    seen, reward, terminated, truncated, told = env.step(CLOSE)
    assert terminated and not truncated and seen in env.observation_space
    assert told["failure"] == "release" and not told["is_success"] and np.isinf(told["required_friction"])
    # a limit that breaks, and friction as high as it counts
    assert reward == pytest.approx(-1 - 0.25 * 2) and told["cost"] == 1
    untouched = ["gripper", "lower", "upper", "exposure", "clearance", "forces", "holding"]
    assert all(np.array_equal(seen[SLICES[part]], before[SLICES[part]]) for part in untouched)
    assert env.episode.grasp is None and env.episode.path is None
    # one that begins so ends with its first step
    held = {"grasp": {"x": -0.03, "compression": 1e-3}, "unknowns": z}
    assert env.reset(options=held)[1]["failure"] == ""
    state = env.get_state()
    ended = env.step(LIFT)
    assert ended[2] and ended[4]["failure"] == "release"
    env.set_state(state)
    assert digest([env.step(LIFT)]) == digest([ended])


def test_a_grasp_that_misses_ends_in_the_same_step_for_many() -> None:
    envs = vector(8, unknowns=NOWHERE, autoreset_mode="SameStep")
    envs.reset(options={"unknowns": z_of(closing=-1.0)})
    *_, terminated, truncated, infos = envs.step(np.tile(CLOSE, (8, 1)))
    assert terminated.all() and not truncated.any()
    assert set(infos["final_info"]["failure"]) == {"release"}


def test_a_state_carries_the_draw(make: Make) -> None:
    """Also into an environment for which nothing is unknown, whose next episode then is a certain one."""
    for name in (ROD, FEM):
        env, other = make(name, unknowns=True), make(name)
        env.reset(seed=0)
        env.step(CLOSE)
        other.set_state(env.get_state())
        assert digest([other.step(LIFT)]) == digest([env.step(LIFT)])
        assert "unknowns" not in other.reset()[1] and "unknowns" in env.reset()[1]


def test_repeated_states_carry_the_draw() -> None:
    envs, many = vector(4, scene="random", unknowns=True), vector(3, scene="random", unknowns=True)
    seen = envs.reset(seed=0)[0]
    envs.step(Player(0, 4)(seen))
    many.set_state(envs.get_state().repeated(2, 3))
    lift = np.tile(LIFT, (4, 1))
    said, told = envs.step(lift), many.step(lift[:3])
    for k in range(3):
        for one, other in zip(row([said[:4]], 2), row([told[:4]], k), strict=True):
            same(one, other)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([0.0] * 10, r"^unknowns have shape \(10,\), allowed \(11,\) numbers in \[-1, 1\]$"),
        ([[0.0] * 11], r"^unknowns have shape \(1, 11\), allowed \(11,\) numbers"),
        ([0.0] * 10 + [1.5], r"^unknowns = \[0.0, .*1.5\], allowed \(11,\) numbers in \[-1, 1\]$"),
        ([0.0] * 10 + [float("nan")], r"^unknowns = .*nan\], allowed"),
        ("modulus", r"^unknowns = 'modulus', allowed \(11,\) numbers"),
        (None, r"^unknowns"),
    ],
    ids=str,
)
def test_what_is_no_draw_is_said_in_one_line(make: Make, given: Any, message: str) -> None:
    env = make(ROD)
    with pytest.raises(ValueError, match=message) as caught:
        env.reset(options={"unknowns": given})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stiffness": 0.1}, r"^unknowns\.stiffness: unknown key"),
        ({"modulus": -0.1}, r"^unknowns\.modulus = -0.1, allowed \[0, 0.9\]$"),
        ("all", r"^unknowns = 'all', allowed none or a mapping of modulus"),
        (3, r"^unknowns"),
    ],
    ids=str,
)
def test_what_are_no_ranges_is_said_in_one_line(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        TissueRetractEnv("rod", unknowns=given)
    assert "\n" not in str(caught.value)
