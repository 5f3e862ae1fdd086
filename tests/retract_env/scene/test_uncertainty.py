"""What a scene may say of what is not known."""

from __future__ import annotations

import pytest

from retract_env.scene import UNKNOWNS, Scene, SceneError, Uncertainty, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("ten_veins")


def test_the_default_prior_leaves_a_scenes_hash_as_it_was(scene: Scene) -> None:
    # of before scenes had an uncertainty
    assert scene.hash == "99fb5f5d8c3420e74326529f2c4983e2f52eda209e3beede19f2c3f65bc2ce14"


def test_another_prior_is_another_scene(scene: Scene) -> None:
    known = scene.model_copy(update={"uncertainty": Uncertainty.none()})
    assert known.hash != scene.hash
    assert Scene.from_data(known.dump()) == known
    assert Scene.from_data(known.dump()).hash == known.hash


def test_with_nothing_unknown_every_range_is_empty() -> None:
    none = Uncertainty.none()
    assert none.poisson is None
    assert all(getattr(none, name) == 0 for name in UNKNOWNS if name != "poisson")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"modulus": -0.1}, "uncertainty.modulus = -0.1, allowed [0, 0.9]"),
        ({"weight": 0.95}, "uncertainty.weight = 0.95, allowed [0, 0.9]"),
        ({"grasp": 1}, "uncertainty.grasp = 1 m, allowed [0, 0.05] m"),
        ({"closing": "much"}, "uncertainty.closing = 'much', not a number"),
        ({"poisson": [0.45, 0.4]}, "uncertainty.poisson = [0.45, 0.4], allowed [least, greatest], ascending"),
        ({"poisson": 0.4}, "uncertainty.poisson = 0.4, allowed [least, greatest] or null"),
        ({"poisson": [0.4, 0.5]}, "uncertainty.poisson = 0.5, allowed [0, 0.49]"),
        ({"stiffness": 0.1}, "uncertainty.stiffness: unknown key"),
    ],
)
def test_a_bad_prior_is_refused_in_one_line(scene: Scene, data: dict[str, object], said: str) -> None:
    with pytest.raises(SceneError) as refused:
        Scene.from_data(scene.dump() | {"uncertainty": data})
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)
