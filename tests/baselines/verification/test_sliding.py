"""Patches that slip node by node: Coulomb's law at each, derivatives, and the limits that are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.flaps import flap
from baselines.verification.sliding import SlidingFlap, slid
from planners.certify import Retraction
from planners.eased import eased
from retract_env.fem.model import FlapModel
from retract_env.grasp import Grasp
from retract_env.mesh import RESOLUTIONS
from retract_env.physics.base import TissueState
from retract_env.scene import Scene

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return flap()


@pytest.fixture(scope="module")
def lifted(scene: Scene) -> Retraction:
    grasp = Grasp(-0.03, 0.10 * scene.tissue.height)
    retraction = Retraction(scene, grasp, eased(scene, grasp), "coarse")
    retraction.squeeze()
    retraction.move()
    return retraction


@pytest.fixture(scope="module")
def frames(lifted: Retraction) -> Sequence[TissueState]:
    return lifted.frames


def slipping(scene: Scene) -> tuple[SlidingFlap, Array]:
    """Between tilted pads, some nodes held by friction, some sliding, some lifted."""
    rng = np.random.default_rng(0)
    model = SlidingFlap(scene, -0.03, RESOLUTIONS["coarse"], 0.5)
    model.put(np.array([-0.03, 0.0, -0.0299, scene.tissue.height]))
    u = rng.normal(0, 1e-6, model.prism.size)
    along, into = rng.uniform(-2e-6, 2e-6, (2, len(model.along)))
    at = model._rest - model._middles  # so that nodes come to lie there
    away = along[:, None] * model._tangent + (into * np.array([-1, 1])[model.pad])[:, None] * model._axis
    u[model._x], u[model._x + 1] = (away - at).T
    model.most = rng.uniform(0.1, 1.5, len(along)) * 1e-6 * model._stiffness
    assert 0 < model.slides(u).sum() < len(along) and 0 < (model.places(u)[1] > 0).sum() < len(along)
    return model, u


def test_forces_are_the_slope_of_energy_and_the_tangent_theirs(scene: Scene) -> None:
    """Of what the pads add; what the tissue does is tested elsewhere."""
    model, u = slipping(scene)
    v = np.zeros_like(u)
    patch = np.concatenate([model._x, model._x + 1])
    v[patch] = np.random.default_rng(1).normal(size=len(patch))

    def of_pads(at: Array) -> tuple[float, Array]:
        (whole, force), (inner, pulled) = model.residual(at), FlapModel.residual(model, at)
        return whole - inner, force - pulled

    step = 1e-10  # no node begins to slide or sticks on the way
    (ahead, forward), (behind, backward) = of_pads(u + step * v), of_pads(u - step * v)
    force = of_pads(u)[1]
    assert (ahead - behind) / (2 * step) == pytest.approx(force @ v, rel=1e-4)
    values = model.tangent(u) - FlapModel.tangent(model, u)
    rows = np.repeat(np.arange(len(model.free)), np.diff(model.assembly.indptr))
    columns, w = model.assembly.indices, v[model.free]
    product = np.zeros(len(w))
    np.add.at(product, rows, values * w[columns])
    np.add.at(product, columns, np.where(rows != columns, values * w[rows], 0.0))
    slope = ((forward - backward) / (2 * step))[model.free]
    assert slope == pytest.approx(product, rel=0, abs=1e-5 * float(np.abs(product).max()))


def test_no_node_drags_more_than_friction_holds(scene: Scene) -> None:
    model, u = slipping(scene)
    drag, _ = model.holding(u)
    assert (np.abs(drag) <= model.most).all()
    assert np.abs(drag[model.slides(u)]) == pytest.approx(model.most[model.slides(u)])
    model.slip(u)
    assert model.holding(u)[0] == pytest.approx(drag, rel=1e-9, abs=1e-15)


def test_where_friction_is_plenty_patches_hold_as_rigid_ones_do(
    scene: Scene, lifted: Retraction, frames: Sequence[TissueState]
) -> None:
    """Penalties give by a thousandth of the width."""
    found = slid(scene, frames, 1.0, "coarse")
    assert found.creep < 1e-3 * scene.jaws.width and found.sliding == 0
    assert found.max_strain == pytest.approx(lifted.max_strain, rel=0.01)
    assert found.required_friction == pytest.approx(lifted.required_friction, abs=0.01)
    assert found.clearance == pytest.approx(lifted.frames[-1].clearance, abs=2e-4)


def test_less_friction_lets_more_creep(scene: Scene, frames: Sequence[TissueState]) -> None:
    creeps = [slid(scene, frames, friction, "coarse").creep for friction in (0.6, 0.45, 0.35)]
    assert creeps == sorted(creeps) and creeps[0] < creeps[-1]


def test_where_friction_is_less_than_the_jaws_need_they_pull_with_all_of_it_and_the_flap_slips_back(
    scene: Scene, lifted: Retraction, frames: Sequence[TissueState]
) -> None:
    too_little = 0.6 * lifted.required_friction
    slipping = slid(scene, frames[: len(frames) // 2], too_little, "coarse")  # while the jaws pull ever more
    assert slipping.sliding == pytest.approx(1, abs=0.05) and slipping.lifted == 0
    found = slid(scene, frames, too_little, "coarse")
    assert found.required_friction == pytest.approx(too_little, rel=1e-4)
    assert found.creep > 0.1 * scene.jaws.width and found.clearance < lifted.frames[-1].clearance - 1e-3
