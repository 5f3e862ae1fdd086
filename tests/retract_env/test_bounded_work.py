"""Flaps far outside what is drawn: work ends after a number of steps, with a reason in one line."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from baselines.verification.flaps import HEIGHT, square_vein
from retract_env.env import TissueRetractEnv
from retract_env.errors import Diverged, FlapRefused, MeshError
from retract_env.fem import solver
from retract_env.grasp import Grasp
from retract_env.physics import fem
from retract_env.physics.fem import FemPhysics
from retract_env.scene import LineOfSight, Scene, Tissue, Vein
from retract_env.task import default_scene, episode


def flap(length: float, height: float, depth: float, modulus: float, *veins: Vein) -> Scene:
    tissue = Tissue(
        length=length, height=height, depth=depth, density=1000.0, modulus=modulus, poisson=0.45, veins=veins
    )
    return Scene(name="far out", tissue=tissue, line_of_sight=LineOfSight.at(-length / 4, 0.8))


def test_a_move_that_takes_too_long_has_diverged_and_leaves_the_last_good_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A move that has to be cut again and again."""
    physics = FemPhysics(default_scene(), -0.03, "coarse")
    physics.reset()
    squeezed = physics.move_to(np.array([-0.03, HEIGHT / 2, 0.0, 0.8 * HEIGHT]))
    before = physics.equilibrium.work
    monkeypatch.setattr(fem, "MOST_ITERATIONS", 50)
    with pytest.raises(Diverged, match="iterations"):
        physics.move_to(np.array([0.05, HEIGHT / 2, 0.0, 0.8 * HEIGHT]))
    assert physics.equilibrium.work - before <= 50 + fem.PATIENCE + solver.MOST_SHIFTS
    last = physics.state()
    assert np.isfinite(last.points).all()
    assert last.jaws[0] >= squeezed.jaws[0]


def test_an_immense_mesh_is_refused_before_it_is_solved() -> None:
    with pytest.raises(
        MeshError, match=r"tissue: \d+ unknowns at 'coarse', allowed 150000; the flap is too long"
    ):
        FemPhysics(flap(0.5, 5e-4, 0.05, 4e4), -0.3, "coarse")
    with pytest.raises(MeshError, match=r"tissue: \d+ unknowns at 'coarse'"):  # of 500 layers
        FemPhysics(flap(0.05, 1e-4, 0.5, 4e4), -0.03, "coarse")
    with pytest.raises(MeshError, match="tissue: 5e\\+05 times as long as high, allowed 5000 at 'coarse'"):
        FemPhysics(flap(0.5, 1e-6, 0.05, 4e4), -0.3, "coarse")


def test_bullet_refuses_immense_meshes_too() -> None:
    pytest.importorskip("pybullet")
    from retract_env.physics.bullet.tetmesh import tet_mesh

    with pytest.raises(MeshError, match=r"tissue: \d+ tetrahedra, .* allowed in Bullet up to 20000"):
        tet_mesh(flap(0.5, 5e-4, 5e-4, 500.0), -0.3, 0.38, 2, 2)


def test_only_the_best_grasps_are_tried_at_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def refuses(self: FemPhysics) -> None:
        tried.append(self.jaw_x)
        raise Diverged("staged")

    monkeypatch.setattr(FemPhysics, "reset", refuses)
    monkeypatch.setattr(episode, "spring_grasps", lambda _: [Grasp(-0.01 - k * 1e-3, 1e-3) for k in range(9)])
    env = TissueRetractEnv("fem")
    with pytest.raises(Diverged, match=f"{episode.MOST_GRASPS} grasps could not be squeezed"):
        env.reset(options={"grasp": "spring"})
    tries = list(tried)
    monkeypatch.setattr(episode, "spring_grasps", lambda _: [])
    with pytest.raises(Diverged, match=r"the spring model knows no grasp of its flap$"):
        env.reset(options={"grasp": "spring"})
    env.close()
    assert tried == tries == [-0.01 - k * 1e-3 for k in range(episode.MOST_GRASPS)]


@pytest.mark.parametrize("grasp", ["agent", {"x": -0.3, "compression": 1e-4}])
def test_an_environment_says_that_it_takes_no_such_flap(grasp: Any) -> None:
    """It is no divergence, which would be the action's fault."""
    immense = flap(0.5, 5e-4, 0.05, 4e4)
    env = gym.make("retract_env:TissueRetractFEM-v0", scene=immense.dump(), grasp=grasp)
    if grasp == "agent":
        env.reset(seed=0)
    with pytest.raises(FlapRefused, match=r"unknowns at 'coarse', allowed 150000"):
        env.reset(seed=0) if grasp != "agent" else env.step(np.zeros(3, np.float32))


@pytest.mark.parametrize(
    ("density", "modulus", "said"),
    [
        (1000.0, 4.2e6, r"veins\[0\].modulus = 4.2e\+06 Pa, allowed in Bullet up to"),
        (0.0, 2e5, r"tissue.density = 0 kg/m\^3, allowed in Bullet above 0 kg/m\^3"),
    ],
)
def test_bullet_says_what_it_cannot_have(density: float, modulus: float, said: str) -> None:
    pytest.importorskip("pybullet")
    scene = flap(0.05, 0.0044, 0.0044, 4e4, square_vein(-0.02, 0.002, 0.0008, modulus))
    scene = scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"density": density})})
    env = gym.make("retract_env:TissueRetract-v0", scene=scene.dump(), resolution="coarse")
    env.reset(seed=0)
    with pytest.raises(FlapRefused, match=said):
        env.step(np.zeros(3, np.float32))
    env.close()


def test_a_move_that_comes_to_no_numbers_leaves_the_last_that_did(monkeypatch: pytest.MonkeyPatch) -> None:
    env = gym.make("retract_env:TissueRetractFEM-v0", grasp={"x": -0.03, "compression": 1e-3})
    env.reset(seed=0)
    good = FemPhysics.move_to

    def lost(self: FemPhysics, *given: Any) -> Any:
        state = replace(good(self, *given), worst_strain=math.nan)
        monkeypatch.setattr(FemPhysics, "state", lambda _: state)
        return state

    monkeypatch.setattr(FemPhysics, "move_to", lost)
    after, reward, _, truncated, _ = env.step(np.array([0.0, 1.0, 0.0], np.float32))
    assert truncated and np.isfinite(after).all() and np.isfinite(float(reward))
    assert env.observation_space.contains(after)
