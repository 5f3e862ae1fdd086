"""The law of the tissue: what a scene says of it, and who refuses another one than its own."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml

from planners import certify, paths
from planners.certify.robust import Robust
from planners.foresight import NOTHING, foresee
from retract_env.errors import SceneError
from retract_env.grasp import Grasp
from retract_env.scene import Material, Scene, load_scene
from tests.retract_env.descriptions import plain

FUNG = {"law": "fung", "stiffening": 4.0}
GRASP = Grasp(-0.03, 0.0011)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.from_data({**load_scene("homogeneous").dump(), "material": FUNG})


def test_a_scene_file_names_the_law(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(yaml.safe_dump({**plain(), "material": FUNG}))
    scene = load_scene(file)
    assert scene.material == Material(law="fung", stiffening=4.0)
    assert Scene.from_data(scene.dump()) == scene


def test_only_another_law_is_another_scene() -> None:
    laws = [Material(), Material(law="fung", stiffening=4.0), Material(law="fung", stiffening=5.0)]
    hashes = [Scene.from_data({**plain(), "material": law.model_dump()}).hash for law in laws]
    assert hashes[0] == Scene.from_data({k: v for k, v in plain().items() if k != "material"}).hash
    assert len(set(hashes)) == len(laws)


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ({"law": "ogden"}, "material.law = 'ogden', allowed neo-hookean, fung"),
        ({"law": "fung"}, "material.stiffening = 0.0, allowed (0, 20] for law = 'fung'"),
        ({"law": "fung", "stiffening": 21}, "material.stiffening = 21, allowed [0, 20]"),
        ({"stiffening": 2.0}, "material.stiffening = 2.0, allowed 0 for law = 'neo-hookean'"),
        ("fung", "material = 'fung', not a mapping"),
    ],
)
def test_what_a_law_may_not_be(material: object, said: str) -> None:
    with pytest.raises(SceneError) as refused:
        Scene.from_data({**plain(), "material": material})
    assert str(refused.value).startswith(said)


def test_tissue_that_stiffens_is_strained_less_and_needs_less_friction(scene: Scene) -> None:
    """Jaws that close by as much press it harder."""
    plainly = load_scene("homogeneous")
    path = paths.ctc(plainly, GRASP)
    soft, stiff = (certify(s, GRASP, path, "coarse") for s in (plainly, scene))
    assert stiff.max_strain < soft.max_strain
    assert stiff.required_friction < soft.required_friction
    assert np.linalg.norm(stiff.frames[1].reactions) > np.linalg.norm(soft.frames[1].reactions)


def test_who_knows_but_the_neo_hookean_law_says_so(scene: Scene) -> None:
    rod = r"material.law = 'fung', allowed 'neo-hookean' on a planar rod$"
    with pytest.raises(SceneError, match=rod):
        gym.make("TissueRetractRod-v0", scene=scene.dump())
    with pytest.raises(SceneError, match=rod):
        gym.make("TissueRetractRod-v0").reset(seed=0, options={"scene": scene})
    with pytest.raises(SceneError, match=rod):
        gym.make_vec("TissueRetractRod-v0", num_envs=2, scene=scene.dump())
    envs = gym.make_vec("TissueRetractRod-v0", num_envs=2)
    with pytest.raises(SceneError, match=rod):
        envs.unwrapped.set_scene(1, scene)  # type: ignore[attr-defined]
    envs.close()
    pytest.importorskip("pybullet")
    with pytest.raises(SceneError, match=r"allowed 'neo-hookean' on a soft body of PyBullet$"):
        gym.make("TissueRetract-v0", scene=scene.dump())


def test_the_rods_distances_are_relied_on_for_its_own_law_alone(scene: Scene) -> None:
    path = paths.ctc(scene, GRASP)
    assert foresee(scene, [(GRASP, path)]) == [NOTHING]
    with pytest.raises(SceneError, match="allowed 'neo-hookean' for a robust statement"):
        certify(scene, GRASP, path, "coarse", robust=Robust())


def test_the_finite_elements_environment_takes_any_law(scene: Scene) -> None:
    """The same squeeze presses stiffening tissue harder."""
    strained = {}
    for one in (scene, load_scene("homogeneous")):
        env = gym.make("TissueRetractFEM-v0", scene=one.dump(), grasp={"x": GRASP.x, "compression": 0.0011})
        _, info = env.reset(seed=0)
        strained[one.neo_hookean] = info["max_strain"]
        env.close()
    assert 0 < strained[False] < 0.97 * strained[True]
