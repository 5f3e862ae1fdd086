"""Sensors: what they blur, what they hide, and that a seed names all of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from retract_env.env import TissueRetractEnv
from retract_env.errors import ConfigError
from retract_env.task import HIGH, LOW, SLICES, RetractionTask, Sensors, TaskConfig, default_scene
from tests.retract_env.playing import FEM, digest, play

CONFIG = TaskConfig()


def exact() -> Any:
    rules = RetractionTask(default_scene())
    return rules.observation(rules.begin())


def test_sensors_that_are_exact_change_nothing_and_draw_nothing() -> None:
    nothing: list[dict[str, Any]] = [{}, {"noise": 0}, {"noise": {}}, {"hide": []}]
    for data in nothing:
        rng = np.random.default_rng(0)
        assert np.array_equal(Sensors.from_data(data).read(exact(), CONFIG, rng), exact())
        assert rng.bit_generator.state == np.random.default_rng(0).bit_generator.state


def test_noise_has_the_deviation_asked_for_and_stays_in_bounds() -> None:
    """k_eq lies far from its bounds; holding and time_left are not blurred unless they are named."""
    sensors = Sensors.from_data({"noise": {"k_eq": 0.2, "exposure": 5.0}})
    rng = np.random.default_rng(1)
    seen = np.array([sensors.read(exact(), CONFIG, rng) for _ in range(400)])
    assert seen.dtype == np.float32 and (seen >= LOW).all() and (seen <= HIGH).all()
    off = (seen - exact())[:, SLICES["k_eq"]]
    # 20,000 draws: the deviation is known to 0.5 %, the mean to 0.0014
    assert off.std() == pytest.approx(0.2, rel=0.02) and abs(off.mean()) < 0.006
    others = np.delete(seen, np.r_[SLICES["k_eq"], SLICES["exposure"]], axis=1)
    assert (others == others[0]).all()
    everything = Sensors.from_data({"noise": 0.1}).read(exact(), CONFIG, rng)
    for name in ("gripper", "lower", "k_eq", "nearness"):
        assert not np.array_equal(everything[SLICES[name]], exact()[SLICES[name]])
    assert np.array_equal(everything[:2], exact()[:2])


def test_hidden_parts_are_nought_and_the_others_as_they_are() -> None:
    seen = Sensors.from_data({"hide": ["k_eq", "slope"]}).read(exact(), CONFIG, np.random.default_rng(0))
    for name, part in SLICES.items():
        assert np.array_equal(seen[part], exact()[part] * (name not in ("k_eq", "slope")))


def test_a_seed_names_a_blurred_episode(make: Callable[..., TissueRetractEnv]) -> None:
    noisy = {"sensors": {"noise": 0.01, "hide": ["target"]}, "grasp": "spring", "scene": "random"}
    env, other = make(FEM, **noisy), make(FEM, **noisy)
    said = digest(play(env, 3, steps=2))
    assert digest(play(env, 4, steps=2)) != said
    assert digest(play(other, 3, steps=2)) == said == digest(play(env, 3, steps=2))
    clear = make(FEM, grasp="spring", scene="random")
    seen, blurred = clear.reset(seed=3)[0], env.reset(seed=3)[0]
    assert env.episode.task.scene == clear.episode.task.scene
    assert 0 < np.abs(np.delete(blurred - seen, SLICES["target"])).max() < 0.06  # six deviations
    assert blurred in env.observation_space and blurred[SLICES["target"]] == 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensors": {"hide": ["strian"]}}, r"^sensors\.hide\[0\] = 'strian', allowed holding, time_left"),
        ({"sensors": {"hide": "strain"}}, r"^sensors\.hide = 'strain', not a list$"),
        ({"sensors": {"noise": -1}}, r"^sensors\.noise = -1, allowed \[0, 100\], or a mapping from parts"),
        ({"sensors": {"noise": {"k": 1}}}, r"^sensors\.noise\[0\]\[0\] = 'k', allowed holding"),
        ({"sensors": {"blur": 1}}, r"^sensors\.blur: unknown key"),
        ({"sensors": {"hide": ["k_eq"]}, "obs": "pixels"}, r"^sensors: allowed with obs = 'state' alone"),
        ({"ranges": {"vein": [0, 1]}}, r"^ranges\.vein: unknown key, did you mean veins\?"),
        ({"ranges": {"veins": [3, 1]}, "scene": "random"}, r"^ranges\.veins = \[3, 1\], allowed \[least, "),
        ({"ranges": {"veins": [0, 1.5]}, "scene": "random"}, r"^ranges\.veins = .*, not whole numbers$"),
        ({"ranges": {"veins": [0, 1]}}, r"^ranges: allowed with scene = 'random' alone$"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        TissueRetractEnv("fem", **given)
    assert isinstance(caught.value, ConfigError) or "alone" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_random_scenes_are_drawn_from_the_ranges(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(scene="random", ranges={"veins": [2, 2], "height": [3e-3, 4e-3]})
    for seed in range(5):
        env.reset(seed=seed)
        tissue = env.episode.task.scene.tissue
        assert len(tissue.veins) == 2 and 3e-3 <= tissue.height <= 4e-3
