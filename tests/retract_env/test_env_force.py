"""The environments with a grip by force: what the action means, and that one and many agree."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import retract_env
from planners import certify
from retract_env.errors import ConfigError
from retract_env.grasp import Grasp
from retract_env.scene import Jaws, load_scene
from retract_env.spring import by_force, expected_compression
from retract_env.spring.press import PRESSED
from retract_env.task import TaskConfig, actions, default_scene

BY_FORCE = TaskConfig(grip="force")
UNIT = 40e3 * 1e-3 * 4.4e-3
"""E w d of the paper's flap, N"""

assert retract_env.__version__


def pressing(env: Any) -> float:
    state = env.episode.now.state
    return -float((state.reactions * state.normals).sum()) / 2


def test_the_second_number_is_the_force() -> None:
    scene = default_scene()
    light, firm = (actions.to_grasp([0.0, end, 0.0], scene, BY_FORCE) for end in (-1, 1))
    assert [light.force, firm.force] == pytest.approx([0.03 * UNIT, UNIT])
    middle = actions.to_grasp([0.0, 0.0, 0.0], scene, BY_FORCE)
    assert middle.force is not None and middle.force**2 == pytest.approx(0.03 * UNIT**2)
    assert actions.from_grasp(middle, scene, BY_FORCE)[:2] == pytest.approx([0, 0], abs=1e-12)
    with pytest.raises(ValueError, match=r"grasp\.compression = 0\.001, allowed a grasp by force"):
        actions.from_grasp(Grasp(-0.02, 1e-3), scene, BY_FORCE)
    with pytest.raises(ValueError, match=r"grasp\.force = 0\.1, allowed a grasp by compression"):
        actions.from_grasp(Grasp(-0.02, force=0.1), scene)


@pytest.mark.parametrize("physics", ["fem", "rod"])
def test_the_jaws_keep_pressing(physics: str) -> None:
    env = gym.make("TissueRetractFEM-v0", physics=physics, grip="force").unwrapped
    env.reset(seed=0)
    env.step(np.array([-0.1, 0.2, 0.0]))
    force = env.episode.grasp.force  # type: ignore[attr-defined]
    apart = []
    for _ in range(6):
        observation, *_ = env.step(np.array([0.2, 0.6, -0.5]))
        apart.append(observation[6])
        assert pressing(env) == pytest.approx(force, rel=5e-3)
    assert np.ptp(apart) > 1e-4
    env.close()


def test_what_an_episode_did_is_what_a_certifier_finds() -> None:
    env = gym.make("TissueRetractFEM-v0", grip="force").unwrapped
    env.reset(seed=0)
    env.step(np.array([-0.1, 0.4, 0.0]))
    for _ in range(4):
        *_, info = env.step(np.array([0.2, 0.6, -0.5]))
    episode = env.episode  # type: ignore[attr-defined]
    certificate = certify(episode.task.scene, episode.grasp, episode.path, "coarse")
    assert certificate.max_strain == pytest.approx(info["max_strain"], rel=5e-3)
    assert certificate.required_friction == pytest.approx(info["required_friction"], rel=2e-2)
    env.close()


def test_one_and_many_agree_to_the_last_bit() -> None:
    many = gym.make_vec("TissueRetractRod-v0", num_envs=18, scene="random", grip="force")
    one = gym.make("TissueRetractRod-v0", scene="random", grip="force").unwrapped
    rng = np.random.default_rng(5)
    chosen = rng.uniform(-1, 1, (9, 18, 3)) * [1.0, 1.0, 0.6]
    chosen[1:, :, 1] = np.abs(chosen[1:, :, 1])
    seen, rewards = [many.reset(seed=11)[0]], []
    for action in chosen:
        observation, reward, *_ = many.step(action)
        seen.append(observation)
        rewards.append(reward)
    for k in (0, 3, 17):
        assert np.array_equal(one.reset(seed=11 + k)[0], seen[0][k])
        for j, action in enumerate(chosen):
            observation, reward, terminated, truncated, _ = one.step(action[k])
            assert np.array_equal(observation, seen[j + 1][k]) and reward == rewards[j][k]
            if terminated or truncated:
                break
    many.close()


@pytest.mark.parametrize("grasp", ["spring", {"x": -0.03, "force": 0.07}, {"x": -0.03, "compression": 1e-3}])
def test_given_grasps_close_alike_in_one_and_in_many(grasp: Any) -> None:
    scene = load_scene("ten_veins").dump()
    one = gym.make("TissueRetractRod-v0", scene=scene, grip="force", grasp=grasp).unwrapped
    many = gym.make_vec("TissueRetractRod-v0", num_envs=3, scene=scene, grip="force", grasp=grasp)
    assert np.array_equal(one.reset(seed=0)[0], many.reset(seed=0)[0][0])
    move = np.array([0.3, 0.5, -0.5])
    assert np.array_equal(one.step(move)[0], many.step(np.tile(move, (3, 1)))[0][1])
    held = one.episode.grasp  # type: ignore[attr-defined]
    if grasp == "spring" or "force" in grasp:
        assert pressing(one) == pytest.approx(held.force, rel=1e-9)
    else:
        assert held.force is None
    many.close()


def test_a_spring_grasp_by_force_presses_as_its_compression_is_expected_to() -> None:
    scene = default_scene()
    grasp = by_force(scene, Grasp(-0.02, 0.25 * 4.4e-3, 1.0))
    assert grasp.force == pytest.approx(0.25 * PRESSED * UNIT) and grasp.score == 1.0
    assert by_force(scene, grasp) is grasp


def test_the_grip_may_come_with_the_task() -> None:
    env = gym.make("TissueRetractRod-v0", task={"grip": "force", "force": [0.1, 0.2]}).unwrapped
    assert env.task_config.grip == "force"  # type: ignore[attr-defined]
    env.reset(seed=0)
    env.step(np.array([0.0, 1.0, 0.0]))
    assert pressing(env) == pytest.approx(0.2 * UNIT, rel=1e-9)


@pytest.mark.parametrize("name", ["TissueRetractRod-v0", "TissueRetractFEM-v0"])
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"grip": "glue"}, "grip = 'glue', allowed compression, force"),
        ({"task": {"force": [0.5, 0.1]}}, "task.force = [0.5, 0.1], allowed [least, greatest]"),
        ({"task": {"force": [0.0, 0.1]}}, "task.force"),
        ({"grasp": {"x": -0.02, "force": 0.0}}, "grasp.force = 0 N, allowed above 0 N"),
        ({"grasp": {"x": -0.02, "force": 0.1, "compression": 1e-3}}, "grasp = "),
    ],
)
def test_other_grips_are_refused_in_one_line(name: str, arguments: dict[str, Any], said: str) -> None:
    makers: list[Any] = [gym.make, gym.make_vec] if "Rod" in name else [gym.make]
    for make in makers:
        with pytest.raises((ValueError, ConfigError)) as error:
            make(name, **arguments)
        assert said in str(error.value) and "\n" not in str(error.value)


def test_jaws_press_with_the_force_that_the_depth_they_hold_gives_them() -> None:
    scene, grasp = default_scene(), Grasp(-0.03, 0.88e-3)
    narrow = scene.model_copy(update={"jaws": Jaws(depth=scene.tissue.depth / 4)})
    whole, part = by_force(scene, grasp), by_force(narrow, grasp)
    assert whole.force is not None and part.force == pytest.approx(whole.force / 4)
    for one, held in ((scene, whole), (narrow, part)):
        assert expected_compression(one, held) == pytest.approx(grasp.compression)
