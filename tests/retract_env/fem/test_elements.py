"""Shape functions, quadrature and extrusion: exact on polynomials; affine fields pass the patch test."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.bodies import Body, deformation, prism_body, relax, stress
from baselines.verification.flaps import EPS, HEIGHT, flap
from retract_env.fem.assembly import Assembly
from retract_env.fem.elements import (
    PARTS,
    TRIANGLE_RULES,
    equal_parts,
    extruded_block,
    lame,
    quadratic_depth,
    symmetric_depth,
    triangle6,
)
from retract_env.fem.prism import Prism, depth_breaks
from retract_env.mesh import Resolution, section_mesh
from retract_env.objectives import strain, worst_mean
from retract_env.scene import Jaws
from tests.retract_env.boxes import box_grid, hex27, isoparametric, tet10, tetrahedra

Array = NDArray[np.float64]

IRREGULAR = Resolution("test", patch=1, edge=0.3, growth=0.6, bulk=0.7)
CORNERS = np.array(
    [[[0.0, 0.0], [0.003, 0.0005], [0.001, 0.002]], [[0.0, 0.0], [0.001, 0.002], [-0.004, 0.0]]]
)


def test_lame_parameters_give_back_modulus_and_poisson() -> None:
    modulus, poisson = np.array([4e4, 2e5, 1e3]), np.array([0.45, 0.0, 0.49])
    mu, lam = lame(modulus, poisson)
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(modulus, rel=1e-13)
    assert lam / (2 * (lam + mu)) == pytest.approx(poisson, rel=1e-13)


# --- Triangles


@pytest.mark.parametrize(("points", "degree"), [(3, 2), (6, 4)])
def test_triangle_rules_are_exact_to_their_degree(points: int, degree: int) -> None:
    at, weights = TRIANGLE_RULES[points]
    assert at.sum(axis=1) == pytest.approx(1, abs=1e-14)
    wrong = 0.0
    for i, j in product(range(degree + 2), repeat=2):
        exact = math.factorial(i) * math.factorial(j) / math.factorial(i + j + 2)
        error = abs(weights @ (at[:, 1] ** i * at[:, 2] ** j) - exact)
        if i + j <= degree:
            assert error < 1e-15  # the rule is printed to 15 digits
        elif i + j == degree + 1:
            wrong = max(wrong, error)
    assert wrong > 1e-6, "one degree more is not integrated"


def test_triangle_shape_functions_are_one_at_their_own_node() -> None:
    nodes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
    assert triangle6(nodes, CORNERS)[0] == pytest.approx(np.eye(6), abs=EPS)


def test_triangle_gradients_are_exact_on_quadratics() -> None:
    points, _ = TRIANGLE_RULES[6]
    value, grad, double_area = triangle6(points, CORNERS)
    nodes = np.concatenate([CORNERS, (CORNERS + np.roll(CORNERS, -1, axis=1)) / 2], axis=1)
    at = np.einsum("pn,mni->mpi", value, nodes)
    for i, j in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
        f = nodes[..., 0] ** i * nodes[..., 1] ** j
        x, y = np.moveaxis(at, -1, 0)
        slope = [i * x ** max(i - 1, 0) * y**j, j * x**i * y ** max(j - 1, 0)]
        assert np.einsum("pn,mn->mp", value, f) == pytest.approx(x**i * y**j, rel=1e-12, abs=1e-18)
        rounding = 100 * EPS * np.abs(f).max() / 0.001  # over the size of a triangle
        assert np.einsum("mpjn,mn->mpj", grad, f) == pytest.approx(np.stack(slope, -1), rel=0, abs=rounding)
    assert double_area == pytest.approx([5.5e-6, 8e-6], rel=1e-12)


# --- Depth


def test_the_symmetric_layer_is_exact_where_the_plane_of_symmetry_is() -> None:
    z1 = 0.0022
    even, even_slope, odd, odd_slope, weight = symmetric_depth(z1)
    z = odd[:, 0] * z1
    # nodal values at z = 0 and z1 for u_x and u_y, at z1 for u_z
    assert even @ [1, 1 + 3 * z1**2] == pytest.approx(1 + 3 * z**2, rel=1e-14)
    assert even_slope @ [1, 1 + 3 * z1**2] == pytest.approx(6 * z, rel=1e-10)
    assert odd_slope @ [z1] == pytest.approx(1, rel=1e-14)
    for power in (0, 2, 4, 6):
        assert weight @ z**power == pytest.approx(z1 ** (power + 1) / (power + 1), rel=1e-13)


def test_a_quadratic_layer_is_exact_on_quadratics() -> None:
    thickness = 0.003
    value, slope, again, slope_again, weight = quadratic_depth(thickness)
    assert np.array_equal(value, again)
    assert np.array_equal(slope, slope_again)
    nodes = np.array([0, thickness / 2, thickness])
    z = value @ nodes
    for power in range(3):
        assert value @ nodes**power == pytest.approx(z**power, rel=1e-13)
        assert slope @ nodes**power == pytest.approx(power * z ** max(power - 1, 0), abs=1e-12)
    for power in range(6):
        assert weight @ z**power == pytest.approx(thickness ** (power + 1) / (power + 1), rel=1e-13)


@pytest.mark.parametrize("points", [3, 6])
def test_the_symmetric_layer_is_half_of_an_ordinary_one(points: int) -> None:
    """Any symmetric field of the full-depth quadratic layer has twice the energy and the same forces."""
    scene = flap(length=0.01)
    section = section_mesh(scene, -0.005, IRREGULAR)
    half = prism_body(scene, section, points)
    n, z1 = len(section.points), scene.tissue.depth / 2
    u = half.affine([[1.1, 0.2, 0], [-0.1, 0.9, 0], [0, 0, 1.05]])
    u += np.random.default_rng(0).normal(0, 2e-5, half.size)
    low, high = np.split(half.vectors(u), 2)
    mirror = np.array([1, 1, -1])
    # the same depth rule as the half layer's; levels -z1, 0, z1 of the full one
    s, w = np.polynomial.legendre.leggauss(4)
    value = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], axis=1)
    slope = np.stack([s - 0.5, -2 * s, s + 0.5], axis=1) / z1
    t = section.triangles
    dofs = np.concatenate([3 * (t + level * n) + i for i in range(3) for level in range(3)], axis=1)
    moduli = np.full(len(t), scene.tissue.modulus), np.full(len(t), scene.tissue.poisson)
    block = extruded_block(section.corners, (value, slope, value, slope, w * z1), dofs, *moduli, points)
    full = Body([block], 9 * n, tuple(np.arange(i, 9 * n, 3) for i in range(3)), np.zeros((3 * n, 3)))  # type: ignore[arg-type]

    energy, force = half.whole.residual(u)
    energy_full, force_full = full.whole.residual(full.unknowns(np.concatenate([high * mirror, low, high])))
    below, middle, above = np.split(full.vectors(force_full), 3)
    assert energy_full == pytest.approx(2 * energy, rel=1e-12)
    expected = np.concatenate([middle, above + below * mirror])
    expected[:n, 2] = 0  # taken by the plane of symmetry
    assert 2 * half.vectors(force) == pytest.approx(expected, rel=0, abs=1e-11 * np.abs(expected).max())


def test_one_layer_is_enough_for_a_narrow_flap_and_layers_end_at_the_jaws() -> None:
    assert depth_breaks(HEIGHT, HEIGHT, None) == pytest.approx([0, HEIGHT / 2])
    breaks = depth_breaks(0.035, HEIGHT, 0.01)
    assert breaks[0] == 0 and breaks[-1] == 0.0175
    assert (np.diff(breaks) > 0).all()
    assert np.abs(breaks - 0.005).min() == 0
    assert np.diff(breaks).max() <= HEIGHT / 0.8 * (1 + 1e-12)


@pytest.mark.parametrize("depth", [HEIGHT, 0.035])
def test_weights_of_nodes_add_up(depth: float) -> None:
    scene = flap(depth=depth, jaws=Jaws(depth=depth / 2))
    prism = Prism(section_mesh(scene, -0.02, IRREGULAR), scene)
    length, height = scene.tissue.length, scene.tissue.height
    assert prism.depth_weight.sum() == pytest.approx(depth / 2, rel=1e-13)
    assert prism.depth_weight @ prism.z**2 == pytest.approx(depth**3 / 24, rel=1e-13)
    assert prism.area.sum() == pytest.approx(length * height, rel=1e-12)
    assert prism.area @ prism.section.points == pytest.approx(
        [-(length**2) * height / 2, length * height**2 / 2]
    )
    volume = sum(float(b.weight.sum()) for b in prism.blocks)
    assert volume == pytest.approx(length * height * depth / 2, rel=1e-12)


# --- Patch test

DEFORMATIONS = {
    "stretch": np.diag([1.4, 0.8, 0.9]),
    "shear": np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]),
    "all": np.array([[0.8, 0.4, 0], [-0.3, 1.2, 0], [0, 0, 1.3]]),
}


@pytest.fixture(
    scope="module", params=[(HEIGHT, 3), (HEIGHT, 6), (0.025, 3)], ids=["1 layer", "6 points", "layers"]
)
def irregular(request: pytest.FixtureRequest) -> Body:
    """A netgen mesh with one or several layers."""
    depth, points = request.param
    scene = flap(length=0.02, depth=depth)
    body = prism_body(scene, section_mesh(scene, -0.012, IRREGULAR), points)
    assert (len(body.blocks) > 1) == (depth > HEIGHT)
    return body


def interior(body: Body) -> NDArray[np.bool_]:
    """Unknowns (size,) on which no boundary acts: inside the section and not on the free face."""
    low, high = body.at.min(axis=0), body.at.max(axis=0)
    inside = ((body.at > low + 1e-9) & (body.at < high - 1e-9)).all(axis=1)
    if body.mirrored:
        inside |= (body.at[:, 2] == 0) & ((body.at > low + 1e-9) & (body.at < high - 1e-9))[:, :2].all(axis=1)
    out = body.unknowns(np.tile(inside[:, None], 3).astype(float)) > 0
    assert out.sum() > 10
    return out


def virial(body: Body, force: Array) -> Array:
    """(3, 3) N m, sum of f_i x_j over nodes: mean stress times volume."""
    found: Array = np.einsum("ni,nj->ij", body.vectors(force), body.at)
    return found


@pytest.mark.parametrize("name", DEFORMATIONS)
def test_affine_displacement_gives_constant_stress_and_no_force_inside(irregular: Body, name: str) -> None:
    F = DEFORMATIONS[name]
    u = irregular.affine(F)
    for block in irregular.blocks:
        assert np.abs(deformation(block, u) - F).max() < 1e-10
    force = irregular.whole.residual(u)[1]
    assert np.abs(force[interior(irregular)]).max() < 1e-10 * np.abs(force).max()
    P = stress(F, 40e3, 0.45) * np.prod(np.ptp(irregular.at, axis=0))
    rounding = 1e-9 * np.abs(P).max()
    found = virial(irregular, force)
    assert found[:2, :2] == pytest.approx(P[:2, :2], abs=rounding)
    assert found[2, 2] == pytest.approx(P[2, 2], abs=rounding)


@pytest.mark.parametrize("name", DEFORMATIONS)
def test_affine_boundary_values_are_solved_by_the_affine_field(irregular: Body, name: str) -> None:
    u, free = irregular.affine(DEFORMATIONS[name]), interior(irregular)
    disturbed = u + free * np.random.default_rng(1).normal(0, 3e-6, irregular.size)
    solved, _ = relax(irregular.assembly(free), disturbed)
    assert solved == pytest.approx(u, abs=1e-14)


@pytest.mark.parametrize("kind", ["hex-27", "tet-10"])
def test_ordinary_elements_pass_the_patch_test(kind: str) -> None:
    points, cells = box_grid((3, 2, 2), (0.006, 0.004, 0.004), warp=0.15)
    if kind == "tet-10":
        body = isoparametric(*tetrahedra(points, cells), tet10())
    else:
        body = isoparametric(points, cells, hex27())
    F = np.array([[0.9, 0.3, -0.2], [-0.1, 1.2, 0.1], [0.2, 0.1, 1.1]])
    force = body.whole.residual(body.affine(F))[1]
    assert np.abs(force[interior(body)]).max() < 1e-11 * np.abs(force).max()
    P = stress(F, 40e3, 0.45) * np.prod(np.ptp(body.at, axis=0))
    assert virial(body, force) == pytest.approx(P, abs=1e-10 * np.abs(P).max())


# --- Where strain is measured


@pytest.mark.parametrize("points", TRIANGLE_RULES)
def test_in_the_section_gradients_are_known_everywhere_from_those_at_the_points(points: int) -> None:
    corners = np.array([[[0.0, 0.0], [0.004, 0.001], [0.001, 0.003]]])
    middles = equal_parts(PARTS)
    rule, _ = TRIANGLE_RULES[points]
    rng = np.random.default_rng(1)
    nodal = rng.normal(size=6)
    there, here = (np.einsum("mpjt,t->pj", triangle6(at, corners)[1], nodal) for at in (middles, rule))
    assert middles @ np.linalg.pinv(rule) @ here == pytest.approx(there, rel=1e-10)


def test_equal_parts_are_as_many_and_balanced() -> None:
    for parts in (1, 2, 4, 7):
        middles = equal_parts(parts)
        assert middles.shape == (parts**2, 3)
        assert middles.sum(axis=1) == pytest.approx(1)
        assert middles.mean(axis=0) == pytest.approx(1 / 3)
        assert middles.min() == pytest.approx(1 / (3 * parts))


@pytest.mark.parametrize("bulk", [0.9, 0.45])
def test_the_worst_strain_of_a_bent_flap_is_that_of_its_skin(bulk: float) -> None:
    """A flap bent to curvature c: strain c y, worst in the outermost hundredth, 0.995 c h / 2."""
    scene = flap()
    section = section_mesh(scene, None, Resolution("test", patch=1, edge=1.0, growth=0.7, bulk=bulk))
    prism = Prism(section, scene)
    assembly = Assembly(prism.blocks, prism.size, np.arange(prism.size, dtype=np.int32))
    curvature, (x, y) = 1e-3, (section.points - [0.0, HEIGHT / 2]).T
    u = np.zeros((len(x), prism.stride))
    for level in range(prism.levels):
        u[:, 2 * level], u[:, 2 * level + 1] = curvature * x * y, -curvature * x**2 / 2
    strains = np.concatenate([strain(s).ravel() for s in assembly.stretches(u.ravel())])
    volumes = np.concatenate([block.measured.ravel() for block in prism.blocks])
    assert volumes.sum() == pytest.approx(scene.tissue.length * HEIGHT * scene.tissue.depth / 2)
    skin = 0.995 * curvature * HEIGHT / 2
    # the middles of the outermost parts lie a twelfth of an element inside
    assert skin * (1 - bulk / 3) < worst_mean(strains, volumes) <= skin * (1 + 1e-3)
