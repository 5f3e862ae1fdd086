"""Energy, forces, tangent and stretches of the compiled kernels, on every kind of element."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from baselines.verification.bodies import Body, deformation, prism_body, stress
from baselines.verification.flaps import EPS, HEIGHT, flap, square_vein
from retract_env.fem.elements import ElementBlock, lame
from retract_env.fem.kernels import LANES
from retract_env.mesh import Resolution, section_mesh
from tests.retract_env.boxes import box_grid, hex27, isoparametric, tet10, tetrahedra

Array = NDArray[np.float64]

COARSE = Resolution("test", patch=1, edge=0.3, growth=0.6, bulk=0.7)


def random_flap(depth: float, triangle_points: int = 3) -> Body:
    """Three materials, one of them nearly incompressible."""
    veins = [square_vein(-0.004, 0.0022, 0.001, 2e5, 0.49), square_vein(-0.007, 0.002, 0.0006, 9e4, 0.2)]
    scene = flap(length=0.01, depth=depth, veins=veins, poisson=0.4)
    return prism_body(scene, section_mesh(scene, -0.005, COARSE), triangle_points)


def random_box(kind: str) -> Body:
    """Every element of another material, nu up to 0.49; 54 of them or more, no multiple of LANES."""
    rng = np.random.default_rng(3)
    points, cells = box_grid((3, 3, 6), (0.005, 0.004, 0.006), warp=0.15)
    shape = hex27()
    if kind == "tet-10":
        points, cells = tetrahedra(*box_grid((1, 2, 3), (0.005, 0.004, 0.006), warp=0.15))
        shape = tet10()
    modulus, poisson = rng.uniform(1e4, 3e5, len(cells)), rng.uniform(0, 0.49, len(cells))
    return isoparametric(points, cells, shape, modulus, poisson)


BODIES: dict[str, Callable[[], Body]] = {
    "symmetric layer": lambda: random_flap(HEIGHT),
    "symmetric layer, 6 points": lambda: random_flap(HEIGHT, 6),
    "several layers": lambda: random_flap(4 * HEIGHT),
    "hex-27": lambda: random_box("hex-27"),
    "tet-10": lambda: random_box("tet-10"),
    "Fung, several layers": lambda: replace(random_flap(4 * HEIGHT), b=0.3),
    "Fung, tet-10": lambda: replace(random_box("tet-10"), b=1.0),
}
ORDINARY = ("hex-27", "tet-10")


@pytest.fixture(scope="module", params=list(BODIES))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def body(kind: str) -> Body:
    return BODIES[kind]()


def strained(body: Body, seed: int = 0) -> Array:
    """A large random deformation: affine, as symmetry allows, with noise that strains elements more."""
    rng = np.random.default_rng(seed)
    F = np.eye(3) + rng.uniform(-0.25, 0.25, (3, 3))
    if body.mirrored:
        F[2, :2] = F[:2, 2] = 0
    u = body.affine(F) + rng.normal(0, 2e-5, body.size)
    assert np.isfinite(body.whole.residual(u)[0])
    return u


def materials(block: ElementBlock) -> tuple[Array, Array]:
    """Modulus and poisson (m, 1) from Lame's parameters."""
    mu, lam = block.by_element(block.mu[:, None])[:, 0], block.by_element(block.lam[:, None])[:, 0]
    poisson = lam / (2 * (lam + mu))
    return (2 * mu * (1 + poisson))[:, None], poisson[:, None]


def observed_order(errors: list[float]) -> Array:
    """Orders of errors at steps that halve."""
    found: Array = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    return found


# --- The law


def test_energy_is_that_of_the_law(body: Body) -> None:
    """Of the logarithmic neo-Hookean solid, which Fung's law has in an exponential."""
    u = strained(body)
    expected = 0.0
    for block in body.blocks:
        F = deformation(block, u)
        mu, lam = lame(*materials(block))
        log_j = np.log(np.linalg.det(F))
        density = mu / 2 * ((F**2).sum(axis=(2, 3)) - 3) - mu * log_j + lam / 2 * log_j**2
        if body.b:
            density = mu / (2 * body.b) * (np.exp(2 * body.b * density / mu) - 1)
        expected += float((density * block.by_element(block.weight)).sum())
    # lambda = mu nu / (1/2 - nu) loses two digits at nu = 0.49, sums over thousands of points some more
    assert body.whole.residual(u)[0] == pytest.approx(expected, rel=1e-11)


def test_residual_is_the_divergence_of_the_first_piola_kirchhoff_stress(body: Body) -> None:
    u, v = strained(body), strained(body, 1)
    power = 0.0
    for block in body.blocks:
        P = stress(deformation(block, u), *materials(block), body.b)
        rate = deformation(block, v) - np.eye(3)
        power += float(((P * rate).sum(axis=(2, 3)) * block.by_element(block.weight)).sum())
    assert body.whole.residual(u)[1] @ v == pytest.approx(power, rel=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_residual_is_the_gradient_of_energy(body: Body, seed: int) -> None:
    assembly, u = body.whole, strained(body, seed)
    v = np.random.default_rng(10 + seed).normal(size=body.size)
    exact = assembly.residual(u)[1] @ v
    errors = []
    for step in (4e-6, 2e-6, 1e-6):
        ahead, behind = assembly.residual(u + step * v)[0], assembly.residual(u - step * v)[0]
        errors.append(float(abs((ahead - behind) / (2 * step) - exact)))
    # the central difference is wrong by its second-order term alone
    assert observed_order(errors)[-1] == pytest.approx(2, abs=0.1)
    assert errors[-1] < 1e-2 * abs(exact)


@pytest.mark.parametrize("seed", range(3))
def test_tangent_is_the_gradient_of_the_residual(body: Body, seed: int) -> None:
    assembly, u = body.whole, strained(body, seed)
    v = np.random.default_rng(20 + seed).normal(size=body.size)
    exact = assembly.tangent_times(u, v)
    errors = []
    for step in (4e-6, 2e-6, 1e-6):
        ahead, behind = assembly.residual(u + step * v)[1], assembly.residual(u - step * v)[1]
        errors.append(float(np.linalg.norm((ahead - behind) / (2 * step) - exact)))
    assert observed_order(errors)[-1] == pytest.approx(2, abs=0.1)
    assert errors[-1] < 1e-2 * np.linalg.norm(exact)


def test_tangent_is_symmetric(body: Body) -> None:
    assembly, u = body.whole, strained(body)
    v, w = np.random.default_rng(2).normal(size=(2, body.size))
    there, back = w @ assembly.tangent_times(u, v), v @ assembly.tangent_times(u, w)
    assert there == pytest.approx(back, rel=1e-9)


@pytest.mark.parametrize("kind", ["Fung, tet-10"], indirect=True)
def test_fungs_law_is_the_neo_hookean_one_where_strain_is_small_or_b_is(body: Body) -> None:
    plain, u = replace(body, b=0.0), strained(body)
    at_rest, v = np.zeros(body.size), strained(body, 1)
    one, other = body.whole.tangent_times(at_rest, v), plain.whole.tangent_times(at_rest, v)
    assert one == pytest.approx(other, rel=0, abs=1e-12 * np.abs(other).max())
    force = plain.whole.residual(u)[1]
    errors = [np.abs(replace(body, b=b).whole.residual(u)[1] - force).max() for b in (2e-4, 1e-4)]
    assert errors[0] / errors[1] == pytest.approx(2, rel=1e-3)
    assert errors[1] < 1e-3 * np.abs(force).max()


# --- Rigid motions


def rotation(body: Body, seed: int) -> Array:
    """Any rotation, or one about z where z = 0 has to stay a plane of symmetry."""
    if body.mirrored:
        return Rotation.from_euler("z", 1.0 + seed).as_matrix()
    return Rotation.from_rotvec(np.random.default_rng(seed).normal(size=3)).as_matrix()


@pytest.mark.parametrize("seed", range(3))
def test_rigid_motion_costs_no_energy_and_needs_no_force(body: Body, seed: int) -> None:
    shift = (0.01, -0.02, 0.0 if body.mirrored else 0.03)
    u = body.affine(rotation(body, seed), shift)
    energy, force = body.whole.residual(u)
    volume = sum(float(b.weight.sum()) for b in body.blocks)
    size = 0.03 / 1e-4  # displacement over element, by how much gradients amplify rounding
    stiff = max(float((b.mu + b.lam).max()) for b in body.blocks)
    assert abs(energy) < 100 * EPS * stiff * volume
    reference = np.linalg.norm(body.whole.residual(strained(body))[1])
    assert np.linalg.norm(force) < 100 * size * EPS * reference


@pytest.mark.parametrize("seed", range(3))
def test_a_rotated_state_has_the_same_energy_and_rotated_forces(body: Body, seed: int) -> None:
    assembly, u, Q = body.whole, strained(body, seed), rotation(body, seed)
    energy, force = assembly.residual(u)
    moved = (body.at + body.vectors(u)) @ Q.T - body.at
    energy_turned, force_turned = assembly.residual(body.unknowns(moved))
    assert energy_turned == pytest.approx(energy, rel=1e-10)
    expected = body.unknowns(body.vectors(force) @ Q.T)
    assert force_turned == pytest.approx(expected, rel=0, abs=1e-10 * float(np.linalg.norm(force)))


def test_internal_forces_balance(body: Body) -> None:
    """No resultant and no moment, whatever the deformation; a mirror takes what is not in its plane."""
    u = strained(body)
    force, now = body.vectors(body.whole.residual(u)[1]), body.at + body.vectors(u)
    scale = np.abs(force).sum()
    assert force.sum(axis=0)[: 2 if body.mirrored else 3] == pytest.approx(0, abs=1e-12 * scale)
    moment = np.cross(now, force).sum(axis=0)[2 if body.mirrored else slice(3)]
    assert moment == pytest.approx(0, abs=1e-12 * scale * np.abs(now).max())


# --- Bookkeeping


def test_an_inverted_element_has_infinite_energy(body: Body) -> None:
    assert body.whole.residual(body.affine(np.diag([1.0, -0.5, 1.0])))[0] == np.inf


@pytest.mark.parametrize("count", [1, LANES - 1, LANES, LANES + 1])
def test_the_lane_of_an_element_does_not_matter(count: int) -> None:
    points, cells = box_grid((3, 3, 6), (0.005, 0.004, 0.006), warp=0.15)
    u = strained(isoparametric(points, cells, hex27()))
    energy, force = isoparametric(points, cells[:count], hex27()).whole.residual(u)
    energy_back, force_back = isoparametric(points, cells[count - 1 :: -1], hex27()).whole.residual(u)
    assert energy == pytest.approx(energy_back, rel=1e-12)
    assert force == pytest.approx(force_back, rel=0, abs=1e-12 * np.abs(force).max())


# --- Stretches


def test_principal_stretches_are_the_singular_values_of_the_deformation_gradient(body: Body) -> None:
    u = strained(body)
    for block, stretches in zip(body.blocks, body.whole.stretches(u), strict=True):
        gradients = np.einsum("rq,mqij->mrij", block.mix, deformation(block, u))
        expected = np.linalg.svd(gradients, compute_uv=False)[..., ::-1]
        assert stretches == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9])
def test_small_strains_keep_their_digits(body: Body, size: float) -> None:
    strain = size * np.array([-0.7, 0.1, 1.0])
    for stretches in body.whole.stretches(body.affine(np.diag(1 + strain[[2, 0, 1]]))):
        # the displacement itself is known to EPS times the body's length over the element's
        assert stretches - 1 == pytest.approx(
            np.broadcast_to(strain, stretches.shape), abs=1e-6 * size + 100 * EPS
        )


@pytest.mark.parametrize("principal", [(1.3, 1.3, 1.3), (0.8, 1.25, 1.25), (0.8, 0.8, 1.5), (1.0, 1.0, 1.0)])
def test_repeated_stretches_are_found(body: Body, principal: tuple[float, float, float]) -> None:
    for stretches in body.whole.stretches(body.affine(rotation(body, 1) @ np.diag(principal))):
        # near a double root the eigenvalue depends on the square root of the rounding
        assert stretches == pytest.approx(np.broadcast_to(principal, stretches.shape), abs=1e-7)


def test_stretches_do_not_depend_on_the_material(body: Body) -> None:
    u = strained(body)
    softer = replace(body, blocks=[replace(b, mu=b.mu / 3, lam=b.lam / 7) for b in body.blocks])
    for a, b in zip(body.whole.stretches(u), softer.whole.stretches(u), strict=True):
        assert np.array_equal(a, b)
