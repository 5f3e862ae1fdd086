"""Brute-force grasps: a stiffness that converges, the spring model in its limits, the energy balance."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planners import plan
from planners.deform_closure import RIPPLE, Closure, brute_force, closure_grasps, stable_pairs
from retract_env.scene import Scene, Tissue, Vein
from retract_env.spring import SpringModel
from tests.planners.retractions import a_scene, veined

L, H = 0.05, 0.0044  # m
INNER = slice(2, -2)
"""Pairs a good way from both ends."""


def with_tissue(scene: Scene, jaws: dict[str, Any] | None = None, **changes: Any) -> Scene:
    tissue = Tissue.from_data(scene.tissue.model_dump() | changes)
    data = scene.model_dump() | {"tissue": tissue}
    return Scene.from_data(data | ({"jaws": jaws} if jaws else {}))


def layered(height: float, thick: float = 0.0) -> Scene:
    """A thin flap under broad jaws, of material that does not bulge; a stiffer layer inside if `thick`, m."""
    vein = []
    if thick:
        low, high = (height - thick) / 2, (height + thick) / 2
        outline = ((-0.045, low), (-0.005, low), (-0.005, high), (-0.045, high))
        vein = [Vein(outline=outline, modulus=200e3, poisson=0.0)]
    return with_tissue(a_scene(), {"width": 4e-3}, height=height, poisson=0.0, veins=vein)


def test_stiffness_converges() -> None:
    """Halving the elements halves the change at least, so that the last change bounds what is left."""
    found = [brute_force(a_scene(), 9, nodes) for nodes in (1500, 6000, 24000)]
    for values in ([f.k for f in found], [f.strain for f in found]):
        first, second = (np.abs(fine / coarse - 1)[INNER].max() for coarse, fine in pairwise(values))
        assert second < first / 2
        assert second < 0.02  # as near as certificates are to converged strains


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_in_a_thin_layer_brute_force_is_the_spring_model(share: float) -> None:
    """Under jaws much broader than the layer is thick the load hardly spreads to the sides."""
    errors = []
    for height in (1e-3, 0.5e-3, 0.25e-3):
        scene = layered(height, share * height)
        found = brute_force(scene, 9, 4000)
        exact = SpringModel(scene.tissue).k_eq(found.x)
        errors.append(np.abs(found.k / exact - 1)[INNER].max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.25e-3 / 4e-3  # one thickness of tissue beside each edge, half as much as below


def test_stiffness_grows_with_the_modulus_and_strain_does_not() -> None:
    scene = veined()
    veins = [vein.model_copy(update={"modulus": 3 * vein.modulus}) for vein in scene.tissue.veins]
    stiffer = with_tissue(scene, modulus=3 * scene.tissue.modulus, veins=veins)
    soft, hard = brute_force(scene, 9, 600), brute_force(stiffer, 9, 600)
    np.testing.assert_allclose(hard.k, 3 * soft.k, rtol=1e-9)
    np.testing.assert_allclose(hard.strain, soft.strain, rtol=1e-6)


def test_a_flap_upside_down_is_as_stiff() -> None:
    scene = veined()
    veins = [
        vein.model_copy(
            update={"outline": tuple((x, scene.tissue.height - y) for x, y in vein.outline[::-1])}
        )
        for vein in scene.tissue.veins
    ]
    upright, turned = brute_force(scene, 9, 4000), brute_force(with_tissue(scene, veins=veins), 9, 4000)
    np.testing.assert_allclose(turned.k, upright.k, rtol=0.01)  # another mesh, as near as it converged


def test_a_deep_flap_is_as_stiff_per_area_all_along() -> None:
    """Jaws over the whole depth: ten times the flap takes ten times the force; plane strain adds some."""
    narrow, deep = (brute_force(with_tissue(a_scene(), depth=d), 5, 1500).k[1:-1] for d in (H, 10 * H))
    assert (deep > narrow).all()
    assert (deep < narrow / (1 - 0.45**2) * 1.02).all()


def test_short_jaws_press_harder_on_their_own_area() -> None:
    scene = with_tissue(a_scene(), depth=4 * H)
    short = Scene.from_data(scene.model_dump() | {"jaws": {"width": 1e-3, "depth": H}})
    assert (brute_force(short, 5, 1500).k > brute_force(scene, 5, 1500).k).all()


# --- Grasps


def waves() -> Closure:
    """Three basins between four maxima, and a ripple."""
    x = np.linspace(-0.0495, -0.0005, 160)
    k = 18e6 - 3e6 * np.cos(2 * np.pi * 3.5 * (x / L)) + 0.2 * RIPPLE * 18e6 * np.cos(400 * np.pi * x / L)
    return Closure(x, k, np.full(160, 1.25 / H), 0)


def test_stable_pairs_are_the_minima_that_stand_out() -> None:
    at, k_n = stable_pairs(waves())
    np.testing.assert_allclose(waves().x[at], [-6 / 7 * L, -4 / 7 * L, -2 / 7 * L], atol=L / 150)
    np.testing.assert_allclose(k_n, 21e6, rtol=0.5 * RIPPLE)


def test_the_jaws_close_where_both_energies_are_equal() -> None:
    found = waves()
    at, k_n = stable_pairs(found)
    grasps = {grasp.x: grasp for grasp in closure_grasps(a_scene(), found)}
    for i, neighbour in zip(at, k_n, strict=True):
        delta = grasps[found.x[i]].compression
        left = found.k[i] * (found.farthest(0.5)[i] - delta) ** 2 / 2
        assert left == pytest.approx(neighbour * delta**2 / 2)
        assert grasps[found.x[i]].score == pytest.approx(neighbour * delta**2 / 2)


def test_the_free_end_is_a_maximum_where_stiffness_grows_towards_it() -> None:
    x = np.linspace(-0.0495, -0.0005, 160)
    k = 18e6 + 3e6 * np.cos(2 * np.pi * 0.75 * (x / L + 1) + 0.6)  # falls to one minimum, then rises
    at, k_n = stable_pairs(Closure(x, k, np.full(160, 1.25 / H), 0))
    assert len(at) == 1
    assert k_n[0] == k[0]


def test_jaws_do_not_meet_however_little_they_strain() -> None:
    scene = a_scene()
    found = Closure(np.linspace(-0.04, -0.01, 12), np.full(12, 1e7), np.full(12, 1e-3), 100)
    assert all(grasp.compression < scene.tissue.height for grasp in closure_grasps(scene, found))


def test_without_veins_grasps_stand_evenly() -> None:
    grasps = closure_grasps(a_scene(), brute_force(a_scene(), 160, 2500))
    x = np.sort([grasp.x for grasp in grasps])
    assert len(x) == 10
    np.testing.assert_allclose(np.diff(x), np.ptp(x) / 9, atol=L / 160)


def test_the_planner_certifies_like_the_others() -> None:
    found = plan(veined(), "deform_closure", "coarse", workers=1)
    assert found.certificate.certified
    assert found.planner == "deform_closure"
    # the grasp between the veins, and those beside them
    assert any(-0.033 < c.grasp.x < -0.018 for c in found.candidates)
    scores = [c.grasp.score for c in found.candidates]
    assert scores == sorted(scores, reverse=True)


@pytest.mark.parametrize(("pairs", "nodes", "said"), [(2, 600, "pairs = 2"), (9, 10, "nodes = 10")])
def test_too_little_is_refused(pairs: int, nodes: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        brute_force(a_scene(), pairs, nodes)
