"""Flaps far outside what is drawn: work ends after a number of steps, with a reason in one line."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.verification.flaps import HEIGHT
from retract_env.env import TissueRetractEnv
from retract_env.errors import Diverged, MeshError
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
    before = physics.equilibrium.counts["iterations"]
    monkeypatch.setattr(fem, "MOST_ITERATIONS", 50)
    with pytest.raises(Diverged, match="iterations"):
        physics.move_to(np.array([0.05, HEIGHT / 2, 0.0, 0.8 * HEIGHT]))
    assert physics.equilibrium.counts["iterations"] - before <= 50 + 2 * fem.PATIENCE
    last = physics.state()
    assert np.isfinite(last.points).all()
    assert last.jaws[0] >= squeezed.jaws[0]


def test_an_immense_mesh_is_refused_before_it_is_solved() -> None:
    with pytest.raises(
        MeshError, match=r"tissue: \d+ unknowns at 'coarse', allowed 150000; the flap is too long"
    ):
        FemPhysics(flap(0.5, 5e-4, 0.05, 4e4), -0.3, "coarse")


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
    env.close()
    assert tried == [-0.01 - k * 1e-3 for k in range(episode.MOST_GRASPS)]
