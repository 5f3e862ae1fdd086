"""The flap between jaws as one potential: weight, bed, rigid jaws, and the reactions that they feel."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from baselines.verification.bodies import settled
from baselines.verification.flaps import EPS, HEIGHT, flap, square_vein
from baselines.verification.sections import grid_section
from retract_env.fem.model import FlapModel
from retract_env.fem.solver import Equilibrium
from retract_env.grasp import to_jaws
from retract_env.mesh import Resolution, section_mesh
from retract_env.scene import Jaws, Scene

Array = NDArray[np.float64]

MESH = Resolution("test", patch=2, edge=0.2, growth=0.7, bulk=0.9)
LENGTH, GRASP = 0.02, -0.012
REST = np.array([GRASP, HEIGHT / 2, 0.0, HEIGHT])
"""pose of open jaws"""
LIFTED = np.array([GRASP + 0.001, HEIGHT / 2 + 0.002, -0.3, 0.85 * HEIGHT])


def grasped(scene: Scene) -> FlapModel:
    return FlapModel(scene, section_mesh(scene, GRASP, MESH), GRASP)


SCENES = {
    "narrow": lambda: flap(length=LENGTH, veins=[square_vein(-0.006, 0.0022, 0.001)]),
    "narrow jaws": lambda: flap(length=LENGTH, depth=0.009, jaws=Jaws(depth=0.004)),
    "wide, no bed": lambda: flap(length=LENGTH, depth=0.02, bed=False),
}


@pytest.fixture(scope="module", params=list(SCENES))
def model(request: pytest.FixtureRequest) -> FlapModel:
    return grasped(SCENES[request.param]())


def posed(model: FlapModel, pose: Array, steps: int = 4) -> tuple[Array, Array]:
    """Equilibrium to rounding with the jaws in a pose, approached from rest, and its forces."""
    u = model.at_rest()
    for part in np.linspace(0, 1, steps + 1)[1:]:
        at = REST + part * (pose - REST)
        moved = u.copy()
        model.place_jaws(moved, to_jaws(at))
        u, force = settled(model, from_tangent(model, u, moved))
    return u, force


def test_all_of_the_lower_side_that_is_not_held_lies_on_the_bed(model: FlapModel) -> None:
    """Beneath jaws that are narrower than the flap is deep, too."""
    below = model.prism.y(model.section.bottom, np.arange(model.prism.levels))
    free = np.intersect1d(below, model.free)
    lowered = model.at_rest()
    lowered[below] = -1e-4
    assert np.array_equal(free[model.on_bed(lowered)], free) if model.scene.bed else not len(model._bed)


def from_tangent(model: FlapModel, u: Array, moved: Array) -> Array:
    first = u + Equilibrium(model).step(u, moved - u)
    first[model.driven] = moved[model.driven]
    return first


@pytest.fixture(scope="module")
def lifted(model: FlapModel) -> tuple[Array, Array]:
    return posed(model, LIFTED)


# --- Loads


def test_the_load_is_the_flaps_weight(model: FlapModel) -> None:
    tissue, prism = model.scene.tissue, model.prism
    weight = tissue.density * model.scene.gravity * tissue.length * tissue.height * tissue.depth
    assert 2 * model.load.sum() == pytest.approx(-weight, rel=1e-12)
    nodes, levels = (
        np.arange(len(model.section.points), dtype=np.int32),
        np.arange(prism.levels, dtype=np.int32),
    )
    assert np.count_nonzero(model.load[prism.x(nodes, levels)]) == 0
    x = np.tile(model.section.points[:, 0], prism.levels)
    moment = model.load[prism.y(nodes, levels)] @ x
    assert 2 * moment == pytest.approx(weight * tissue.length / 2, rel=1e-12)


def test_a_flap_on_its_bed_weighs_on_it_as_much_as_it_weighs() -> None:
    scene = flap(length=LENGTH)
    model = FlapModel(scene, section_mesh(scene, None, MESH), None)
    u, force = settled(model, model.at_rest())
    prism, section = model.prism, model.section
    bed = -2 * (force - model.assembly.residual(u)[1] + model.load).sum()
    at_fixed_end = 2 * force[prism.y(section.fixed, np.arange(prism.levels, dtype=np.int32))].sum()
    assert bed + at_fixed_end == pytest.approx(-2 * model.load.sum(), rel=1e-9)
    # far from the fixed end the flap sinks by pressure over stiffness, everywhere alike
    sunk = scene.tissue.density * scene.gravity * HEIGHT / (MESH.bed * scene.tissue.modulus / HEIGHT)
    bottom = model.positions(u)[section.bottom]
    far = bottom[bottom[:, 0] < -LENGTH / 2, 1]
    assert -far.mean() == pytest.approx(sunk, rel=0.05)
    assert sunk < 1e-6  # m: nothing to see


# --- The potential


def test_forces_are_the_gradient_of_the_potential_bed_included(model: FlapModel) -> None:
    rng = np.random.default_rng(0)
    u = model.at_rest() + rng.normal(0, 1e-5, model.prism.size)
    if model.scene.bed:
        touching = u[model._bed] < 0
        assert touching.any() and not touching.all()
        u[model._bed[np.abs(u[model._bed]) < 1e-6]] = 2e-6  # away from where the bed's stiffness jumps
    v = rng.normal(size=model.prism.size)
    force, values = model.residual(u)[1], model.tangent(u)
    energy_errors, force_errors = [], []
    for step in (2e-7, 1e-7):
        (e1, f1), (e0, f0) = model.residual(u + step * v), model.residual(u - step * v)
        energy_errors.append(abs((e1 - e0) / (2 * step) - force @ v))
        force_errors.append(np.linalg.norm((f1 - f0) / (2 * step) - model.tangent_times(u, v)))
    # second-order differences
    assert energy_errors[1] < 0.3 * energy_errors[0] + 1e-9 * abs(force @ v)
    assert force_errors[1] < 0.3 * force_errors[0]
    assert force_errors[1] < 1e-3 * np.linalg.norm(model.tangent_times(u, v))
    n = len(model.free)
    upper = csr_matrix((values, model.assembly.indices, model.assembly.indptr), shape=(n, n))
    w = np.zeros_like(v)
    w[model.free] = v[model.free]
    product = upper @ v[model.free] + upper.T @ v[model.free] - upper.diagonal() * v[model.free]
    assert np.abs(product - model.tangent_times(u, w)[model.free]).max() < 1e-12 * np.abs(product).max()


# --- Jaws


@pytest.mark.parametrize("pose", [REST, LIFTED, np.array([-0.004, 0.011, -2.0, 0.003])], ids=str)
def test_patches_move_rigidly_with_their_jaws(model: FlapModel, pose: Array) -> None:
    u, jaws = np.zeros(model.prism.size), to_jaws(pose)
    model.place_jaws(u, jaws)
    if pose is REST:
        assert np.abs(u).max() < 1e-16
    axis = np.array([-np.sin(pose[2]), np.cos(pose[2])])
    along = np.array([axis[1], -axis[0]])
    half = (model.scene.jaws.depth or model.scene.tissue.depth) / 2
    held = [k for k, z in enumerate(model.prism.z) if z <= half * (1 + 1e-9)]
    for level in held:
        now = model.positions(u, level)
        for k, patch in enumerate(model.section.patches):
            offset = now[patch] - jaws[2 * k : 2 * k + 2]
            assert np.abs(offset @ axis).max() < 1e-16 + 4 * EPS * 0.02
            assert offset @ along == pytest.approx(model.section.points[patch, 0] - GRASP, abs=1e-15)
    others = np.setdiff1d(np.arange(model.prism.size), model.driven)
    assert not u[others].any()


def test_narrow_jaws_hold_only_their_depth() -> None:
    narrow, wide = grasped(SCENES["narrow jaws"]()), grasped(flap(length=LENGTH, depth=0.009))
    levels = (narrow.prism.z <= 0.002 * (1 + 1e-9)).sum()
    patches = sum(map(len, narrow.section.patches))
    assert len(narrow.driven) == 2 * levels * patches
    assert len(wide.driven) == 2 * wide.prism.levels * patches
    assert levels < narrow.prism.levels


# --- Reactions


def test_all_forces_balance(model: FlapModel, lifted: tuple[Array, Array]) -> None:
    """Jaws, fixed end, bed and weight: no resultant and no moment is left."""
    u, force = lifted
    prism, section = model.prism, model.section
    weight = -2 * model.load.sum()
    assert np.abs(force[model.free]).max() < 1e-9 * weight
    nodes, levels = np.arange(len(section.points)), np.arange(prism.levels)
    bed = force - model.assembly.residual(u)[1] + model.load
    assert bed.max() < 1e-12 * weight  # it pushes up: minus its force is in the residual
    holding = np.delete(np.arange(prism.size), model.free)
    held = np.zeros(prism.size)
    held[holding] = force[holding]
    outer = held - bed + model.load
    fx, fy = (2 * outer[d(nodes, levels)].reshape(prism.levels, -1) for d in (prism.x, prism.y))
    assert fx.sum() == pytest.approx(0, abs=1e-9 * weight)
    assert fy.sum() == pytest.approx(0, abs=1e-9 * weight)
    places = [model.positions(u, k) for k in range(prism.levels)]
    moment = sum((p[:, 0] * fy[k] - p[:, 1] * fx[k]).sum() for k, p in enumerate(places))
    assert moment == pytest.approx(0, abs=1e-9 * weight * LENGTH)
    # what the jaws feel is what the rest of the outer world does not bear
    fixed = np.setdiff1d(holding, model.driven)
    others = np.zeros(prism.size)
    others[fixed] = force[fixed]
    x, y = prism.x(nodes, levels), prism.y(nodes, levels)
    rest = [2 * (others - bed + model.load)[d].sum() for d in (x, y)]
    assert model.reactions(force).sum(axis=0) == pytest.approx(rest, rel=1e-8, abs=1e-9 * weight)


@pytest.mark.parametrize("coordinate", range(4), ids=["x", "y", "theta", "separation"])
def test_reactions_are_the_slope_of_the_energy_over_the_pose(
    model: FlapModel, lifted: tuple[Array, Array], coordinate: int
) -> None:
    """Virtual work: the potential in equilibrium changes by what the jaws push."""
    u, force = lifted
    change = np.zeros(4)
    change[coordinate] = 1e-3 if coordinate == 2 else 5e-6
    energies = []
    for sign in (-1, 1):
        moved = u.copy()
        model.place_jaws(moved, to_jaws(LIFTED + sign * change))
        solved, _ = settled(model, from_tangent(model, u, moved))
        energies.append(2 * model.residual(solved)[0])
    slope = (energies[1] - energies[0]) / (2 * change[coordinate])
    on_jaws = model.reactions(force)
    axis = np.array([-np.sin(LIFTED[2]), np.cos(LIFTED[2])])
    if coordinate < 2:
        expected = -on_jaws[:, coordinate].sum()
    elif coordinate == 3:
        expected = -(on_jaws[1] - on_jaws[0]) @ axis / 2
    else:  # moments of all patch forces about the jaws' middle
        prism, levels = model.prism, np.arange(model.prism.levels)
        expected = 0.0
        for patch in model.section.patches:
            f = np.zeros(prism.size)
            f[
                np.intersect1d(model.driven, np.concatenate([prism.x(patch, levels), prism.y(patch, levels)]))
            ] = 1
            f *= force
            for k in range(prism.levels):
                arm = model.positions(u, k)[patch] - LIFTED[:2]
                fx, fy = f[prism.x(patch, levels[[k]])], f[prism.y(patch, levels[[k]])]
                expected += 2 * float(arm[:, 0] @ fy - arm[:, 1] @ fx)
    scale = float(np.abs(on_jaws).max()) * (HEIGHT if coordinate == 2 else 1)
    # second order in the change, and rounding of the energy over the change
    rounding = 100 * EPS * abs(energies[0]) / change[coordinate]
    assert slope == pytest.approx(expected, abs=1e-4 * scale + rounding)


def test_without_gravity_jaws_on_a_mirrored_flap_push_alike() -> None:
    """A squeeze in place: equal and opposite reactions, mirrored shape."""
    scene = flap(length=LENGTH, gravity=0, bed=False)
    left, right = np.linspace(-LENGTH, GRASP - 0.0005, 6), np.linspace(GRASP + 0.0005, 0, 9)
    xs = np.concatenate([left, [GRASP], right])
    model = FlapModel(scene, grid_section(xs, np.linspace(0, HEIGHT, 5), scene, GRASP), GRASP)
    u, force = posed(model, REST - [0, 0, 0, 0.2 * HEIGHT])
    lower, upper = model.reactions(force)
    assert lower[1] < 0 < upper[1]  # the tissue pushes the jaws apart
    assert lower[1] == pytest.approx(-upper[1], rel=1e-9)
    assert lower[0] == pytest.approx(upper[0], abs=1e-9 * upper[1])
    now = model.positions(u)
    mirrored = model.section.points * [1, -1] + [0, HEIGHT]
    partner = [np.argmin(np.hypot(*(model.section.points - p).T)) for p in mirrored]
    assert np.abs(now[partner] - (now * [1, -1] + [0, HEIGHT])).max() < 1e-12


def test_the_prism_knows_where_a_levels_displacements_stand(model: FlapModel) -> None:
    """The view has what the numbering says, and what is written into it lands there and nowhere else."""
    prism, nodes = model.prism, np.arange(len(model.section.points))
    u = np.arange(float(prism.size))
    for level in range(prism.levels):
        at = np.stack([prism.x(nodes, np.array([level])), prism.y(nodes, np.array([level]))], axis=1)
        assert np.array_equal(prism.in_plane(u, level), u[at])
        moved = u.copy()
        prism.in_plane(moved, level)[:] = -1.0
        assert np.array_equal(np.flatnonzero(moved != u), np.sort(at.ravel()))
