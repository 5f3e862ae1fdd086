"""What of a scene is not known: all of it in a word, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from retract_env.errors import SceneError
from retract_env.scene import UNKNOWNS, Scene, Uncertainty, load_scene
from tests.retract_env.descriptions import plain


def test_a_scene_file_says_in_a_word_that_all_is_known(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(yaml.safe_dump({**plain(), "uncertainty": "none"}))
    scene = load_scene(file)
    assert scene.uncertainty == Uncertainty.none()
    assert Scene.from_data(scene.dump()) == scene


def test_with_nothing_unknown_every_range_is_empty() -> None:
    none = Uncertainty.none()
    assert none.poisson is None
    assert all(getattr(none, name) == 0 for name in UNKNOWNS if name != "poisson")


def test_the_default_leaves_a_scenes_hash_as_it_was() -> None:
    # of before scenes had an uncertainty
    assert load_scene("ten_veins").hash == "99fb5f5d8c3420e74326529f2c4983e2f52eda209e3beede19f2c3f65bc2ce14"


def test_only_another_uncertainty_is_another_scene() -> None:
    said = {name: Scene.from_data({**plain(), "uncertainty": u}) for name, u in _SAID.items()}
    unsaid = Scene.from_data({k: v for k, v in plain().items() if k != "uncertainty"})
    assert said["default"].hash == unsaid.hash
    assert len({scene.hash for scene in said.values()}) == len(said)


_SAID = {"default": Uncertainty().model_dump(mode="json"), "none": "none", "less": {"modulus": 0.1}}


@pytest.mark.parametrize(
    ("uncertainty", "said"),
    [
        ("nothing", "uncertainty = 'nothing', allowed none or a mapping of modulus, "),
        (["none"], "uncertainty = ['none'], not a mapping"),
        (None, "uncertainty = None, not a mapping"),
        ({"modulus": -0.1}, "uncertainty.modulus = -0.1, allowed [0, 0.9]"),
        ({"grasp": 1}, "uncertainty.grasp = 1 m, allowed [0, 0.05] m"),
        ({"closing": "much"}, "uncertainty.closing = 'much', not a number"),
        ({"poisson": [0.4, 0.5]}, "uncertainty.poisson = 0.5, allowed [0, 0.49]"),
        ({"modulos": 0.1}, "uncertainty.modulos: unknown key, did you mean modulus?"),
        ({"poisson": [0.45, 0.4]}, "uncertainty.poisson = [0.45, 0.4], allowed [least, greatest], ascending"),
    ],
)
def test_what_else_it_may_not_be(uncertainty: object, said: str) -> None:
    with pytest.raises(SceneError) as refused:
        Scene.from_data({**plain(), "uncertainty": uncertainty})
    assert str(refused.value).startswith(said)
