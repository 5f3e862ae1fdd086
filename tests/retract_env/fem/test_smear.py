"""Veins as stiffness at integration points: where that is exact, a mesh that follows them gives the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.bodies import prism_body
from baselines.verification.flaps import HEIGHT, LENGTH, flap, square_vein
from retract_env.fem.elements import TRIANGLE_RULES
from retract_env.fem.prism import Prism
from retract_env.fem.smear import relative_stiffness
from retract_env.mesh import RESOLUTIONS, section_mesh
from retract_env.mesh.outlines import reaching
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Vein, load_scene

SCENES = Path(__file__).resolve().parents[3] / "configs" / "scenes"
MODULUS = flap().tissue.modulus
Array = NDArray[np.float64]


@pytest.mark.parametrize("points", [3, 6])
def test_a_vein_that_triangles_happen_to_follow_is_the_same_smeared(points: int) -> None:
    scene = flap(veins=[square_vein(-0.02, 0.0024, 0.0012, modulus=2.5e5)])
    meshed = section_mesh(scene, None, RESOLUTIONS["coarse"])
    smeared = replace(meshed, vein=np.full_like(meshed.vein, -1), smeared=scene.tissue.veins)
    bodies = [prism_body(scene, section, points) for section in (meshed, smeared)]
    u = np.random.default_rng(0).normal(scale=2e-5, size=bodies[0].size)
    (energy, force), (energy_, force_) = (body.whole.residual(u) for body in bodies)
    assert energy == pytest.approx(energy_, rel=1e-12)
    assert np.allclose(force, force_, rtol=1e-10, atol=1e-12 * abs(force).max())


def test_volumes_in_which_strain_is_measured_do_not_change() -> None:
    scene = flap(veins=[square_vein(-0.02, 0.0024, 0.0012, modulus=2.5e5)])
    plain = section_mesh(flap(), None, RESOLUTIONS["coarse"])
    smeared = replace(plain, smeared=scene.tissue.veins)
    for a, b in zip(Prism(plain, scene).blocks, Prism(smeared, scene).blocks, strict=True):
        assert np.array_equal(a.measured, b.measured)
        assert (b.weight >= a.weight).all() and (b.weight > a.weight).any()


def stiffness(vein: Vein, corners: Array) -> Array:
    points, _ = TRIANGLE_RULES[3]
    found: Array = relative_stiffness(corners[None], points, np.array([MODULUS]), [vein])[0]
    return found


def test_the_mean_is_of_compliances() -> None:
    corners = np.array([(-LENGTH / 2, 0.0), (-LENGTH / 2 + HEIGHT, 0.0), (-LENGTH / 2, HEIGHT)])
    every = Vein(outline=((-LENGTH, 0), (0, 0), (0, HEIGHT), (-LENGTH, HEIGHT)), modulus=5 * MODULUS)
    assert stiffness(every, corners) == pytest.approx(5)
    assert stiffness(every.model_copy(update={"modulus": MODULUS}), corners) == pytest.approx(1)
    away = Vein(outline=((-LENGTH, 0), (-0.9 * LENGTH, 0), (-0.9 * LENGTH, HEIGHT)), modulus=5 * MODULUS)
    assert stiffness(away, corners) == pytest.approx(1)
    # left of a third of the triangle's width lie 5/9 of it, whatever the integration points
    third = -LENGTH / 2 + HEIGHT / 3
    left = Vein(outline=((-LENGTH, 0), (third, 0), (third, HEIGHT), (-LENGTH, HEIGHT)), modulus=5 * MODULUS)
    compliance = (1 / stiffness(left, corners)).mean()
    assert compliance == pytest.approx(5 / 9 / 5 + 4 / 9, abs=0.03)  # 64 parts see it


def test_coarse_meshes_follow_the_veins_between_the_jaws_and_no_others() -> None:
    scene = load_scene(SCENES / "twenty_veins.yaml")
    half = scene.jaws.width / 2
    x = float(np.mean(scene.tissue.veins[8].outline, axis=0)[0])
    section = FemPhysics(scene, x, "coarse").section
    between = reaching(scene, x - half, x + half)
    assert 8 in between and set(np.unique(section.vein)) == {-1, *between}
    others = [vein for i, vein in enumerate(scene.tissue.veins) if i not in between]
    assert list(section.smeared) == others  # as drawn
    followed = section_mesh(scene, x, RESOLUTIONS["coarse"])
    assert len(section.points) < 0.4 * len(followed.points)
