"""What block and pads do to the flap: exact derivatives, pushes that balance, none where nothing touches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.flaps import HEIGHT, flap
from retract_env.fem.contact import ROUND, Contact
from retract_env.fem.model import FlapModel
from retract_env.grasp import to_jaws
from retract_env.mesh import Resolution, section_mesh
from retract_env.scene import Jaws

Array = NDArray[np.float64]

MESH = Resolution("test", patch=2, edge=0.2, growth=0.7, bulk=0.9)
LENGTH, GRASP = 0.02, -0.012
WIDTH = Jaws().width


@pytest.fixture(scope="module", params=[None, 4e-3], ids=["jaws over all", "narrow jaws"])
def model(request: pytest.FixtureRequest) -> FlapModel:
    scene = flap(length=LENGTH, depth=9e-3, jaws=Jaws(depth=request.param))
    return FlapModel(scene, section_mesh(scene, GRASP, MESH), GRASP)


@pytest.fixture(scope="module")
def contact(model: FlapModel) -> Contact:
    return model.contact


def moved(model: FlapModel, motion: Callable[[Array], Array]) -> Array:
    """Displacements of a motion (n, 2) m -> (n, 2) m of the section, on every level alike."""
    u = np.zeros(model.prism.size)
    for level in range(model.prism.levels):
        model.prism.in_plane(u, level)[:] = motion(model.section.points) - model.section.points
    return u


def turned(model: FlapModel, angle: float, x: float, y: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return moved(model, lambda p: p @ np.array([[cos, sin], [-sin, cos]]) + [x, y])


def squeezed_out(model: FlapModel, by: float, angle: float = -0.3) -> Array:
    """The surface beside both patches pushed over them, behind the pads' sides, all of it turned, lifted."""

    def motion(points: Array) -> Array:
        x, y = points.T
        aside = x - GRASP
        beside = (np.abs(aside) > WIDTH / 2) & ((y == 0) | (y == HEIGHT))
        over = np.where(beside, -np.sign(aside) * by * np.exp(-np.abs(aside) / WIDTH), 0.0)
        return np.stack([x + over, y + np.where(beside, np.sign(y - HEIGHT / 2) * by, 0.0)], axis=-1)

    cos, sin = np.cos(angle), np.sin(angle)
    lifted = np.array([0.0, 2 * HEIGHT])
    return moved(model, lambda p: motion(p) @ np.array([[cos, sin], [-sin, cos]]) + lifted)


def in_the_block(model: FlapModel) -> Array:
    return turned(model, -2.9, 0.012, 0.002)


def forces(contact: Contact, u: Array) -> tuple[float, Array]:
    force = np.zeros_like(u)
    return contact.add_force(u, force, on_pads=True), force


SHAPES = {"pads": lambda m: squeezed_out(m, 1.5 * WIDTH), "block": in_the_block}


@pytest.mark.parametrize("shape", SHAPES)
def test_forces_and_tangent_are_the_derivatives_of_the_energy(
    model: FlapModel, contact: Contact, shape: str
) -> None:
    u = SHAPES[shape](model)
    touched = contact.touches(u)
    assert touched[["block", "pads"].index(shape)] > 4
    v = np.random.default_rng(0).normal(size=u.size)
    force, step = forces(contact, u)[1], 1e-8
    (ahead, more), (behind, less) = forces(contact, u + step * v), forces(contact, u - step * v)
    assert contact.touches(u + step * v) == contact.touches(u - step * v) == touched
    # quadratic or quartic in so small a step
    assert (ahead - behind) / (2 * step) == pytest.approx(force @ v, rel=1e-6)
    times = np.zeros_like(u)
    contact.add_tangent_times(u, v, times, on_pads=True)
    assert (more - less) / (2 * step) == pytest.approx(times, rel=1e-5, abs=1e-6 * np.abs(times).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_the_assembled_tangent_is_the_one_that_is_applied(
    model: FlapModel, contact: Contact, shape: str
) -> None:
    u = SHAPES[shape](model)
    values = np.zeros(len(model.assembly.indices))
    contact.add_tangent(u, values)
    rows = np.repeat(np.arange(len(model.free)), np.diff(model.assembly.indptr))
    v = np.zeros_like(u)
    v[model.free] = np.random.default_rng(1).normal(size=len(model.free))
    short, cols = v[model.free], model.assembly.indices
    found = np.bincount(rows, values * short[cols], minlength=len(short))
    across = rows != cols
    found += np.bincount(cols[across], (values * short[rows])[across], minlength=len(short))
    times = np.zeros_like(u)
    contact.add_tangent_times(u, v, times, on_pads=True)
    assert found == pytest.approx(times[model.free], rel=1e-12, abs=1e-12 * np.abs(times).max())
    assert np.any(found)


def test_a_pad_and_the_tissue_push_each_other_alike(model: FlapModel, contact: Contact) -> None:
    u = squeezed_out(model, 1.5 * WIDTH)
    force = forces(contact, u)[1]
    total, moment, greatest = np.zeros(2), 0.0, 0.0
    for level in range(model.prism.levels):
        f, points = model.prism.in_plane(force, level), model.positions(u, level)
        total += f.sum(axis=0)
        moment += float((points[:, 0] * f[:, 1] - points[:, 1] * f[:, 0]).sum())
        greatest = max(greatest, float(np.abs(f).max()))
    assert greatest > 0
    assert total == pytest.approx(0, abs=1e-12 * greatest)
    assert moment == pytest.approx(0, abs=1e-12 * greatest * LENGTH)


def test_pads_do_not_care_which_way_the_flap_is_turned(model: FlapModel, contact: Contact) -> None:
    energies = [forces(contact, squeezed_out(model, 1.5 * WIDTH, angle))[0] for angle in (0.0, -0.3, -1.5)]
    assert energies[0] > 0
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-9)


def test_nothing_is_pushed_that_touches_nothing(model: FlapModel, contact: Contact) -> None:
    """Squeezed, lifted, on top of the block, and squeezed out by less than a pad's edge is round."""
    closed = np.zeros(model.prism.size)
    model.place_jaws(closed, to_jaws(np.array([GRASP, HEIGHT / 2, 0.0, 0.7 * HEIGHT])))
    shapes = [
        closed,
        turned(model, -0.8, 0.0, 0.001),
        turned(model, -np.pi, 0.0, 2 * HEIGHT),
        squeezed_out(model, 0.9 * ROUND * WIDTH),
    ]
    for u in shapes:
        energy, force = forces(contact, u)
        assert energy == 0 and not force.any() and contact.touches(u) == (0, 0)


def test_the_block_pushes_along_the_shorter_way_out(model: FlapModel, contact: Contact) -> None:
    """Upwards what lies on it, aside what leans on it."""
    lying = turned(model, -np.pi, 0.0, 2 * HEIGHT - 0.05 * HEIGHT)
    leaning = moved(model, lambda p: p + np.array([0.8 * HEIGHT, -2 * HEIGHT]))
    for u, way in ((lying, 1), (leaning, 0)):
        force = forces(contact, u)[1]
        pushed = [model.prism.in_plane(force, level) for level in range(model.prism.levels)]
        assert not any(f[:, 1 - way].any() for f in pushed)
        # these are the forces that hold the nodes where they are: down, and to the right
        assert sum(f[:, way].sum() for f in pushed) * (1 if way == 0 else -1) > 0


def test_jaws_feel_what_friction_has_to_hold_and_not_their_sides(model: FlapModel, contact: Contact) -> None:
    u = squeezed_out(model, 1.5 * WIDTH)
    all_of_it, of_tissue = forces(contact, u)[1], np.zeros_like(u)
    contact.add_force(u, of_tissue)
    assert not of_tissue[model.driven].any() and all_of_it[model.driven].any()
    assert (of_tissue[model.free] == all_of_it[model.free]).all()
    v, all_of_it, of_tissue = np.random.default_rng(2).normal(size=u.size), np.zeros_like(u), np.zeros_like(u)
    contact.add_tangent_times(u, v, all_of_it, on_pads=True)
    contact.add_tangent_times(u, v, of_tissue)
    assert not of_tissue[model.driven].any()
    assert (of_tissue[model.free] == all_of_it[model.free]).all()
