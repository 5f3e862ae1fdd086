"""The sparse tangent sums element tangents; both direct solvers solve it and know what is not positive."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from baselines.verification.bodies import Body, prism_body
from baselines.verification.flaps import HEIGHT, flap, square_vein
from retract_env.errors import NotPositiveDefinite
from retract_env.fem import linear
from retract_env.fem.assembly import Assembly, block_triangle
from retract_env.fem.linear import Factor, Qdldl
from retract_env.mesh import Resolution, section_mesh
from tests.retract_env.boxes import box_grid, hex27, isoparametric, tet10, tetrahedra

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


def flap_body(depth: float) -> Body:
    length = 0.012 if depth == HEIGHT else 0.006
    scene = flap(length=length, depth=depth, veins=[square_vein(-0.003, 0.0022, 0.001)])
    return prism_body(scene, section_mesh(scene, None, Resolution("test", 1, 0.3, 0.6, 1.0)))


BODIES: dict[str, Callable[[], Body]] = {
    "symmetric layer": lambda: flap_body(HEIGHT),
    "several layers": lambda: flap_body(4 * HEIGHT),
    "hex-27": lambda: isoparametric(*box_grid((2, 1, 2), (0.004, 0.003, 0.005), warp=0.1), hex27()),
    "tet-10": lambda: isoparametric(*tetrahedra(*box_grid((2, 1, 2), (0.004, 0.003, 0.005))), tet10()),
}


@pytest.fixture(scope="module", params=list(BODIES))
def body(request: pytest.FixtureRequest) -> Body:
    return BODIES[request.param]()


def strained(body: Body) -> Array:
    u = body.affine([[1.1, 0.2, 0], [-0.1, 0.9, 0], [0, 0, 1.05]])
    return u + np.random.default_rng(0).normal(0, 1e-5, body.size)


def dense(assembly: Assembly, values: Array) -> Array:
    n = len(assembly.free)
    upper = csr_matrix((values, assembly.indices, assembly.indptr), shape=(n, n)).toarray()
    assert np.array_equal(upper, np.triu(upper))
    return upper + np.triu(upper, 1).T


# --- Assembly


@pytest.mark.parametrize(("na", "nz"), [(12, 6), (18, 18), (4, 4), (3, 1)])
def test_every_pair_of_unknowns_of_an_element_is_visited_once(na: int, nz: int) -> None:
    rows, cols = block_triangle(na, nz)
    n = 2 * na + nz
    assert (rows <= cols).all()
    assert len({*zip(rows.tolist(), cols.tolist(), strict=True)}) == len(rows) == n * (n + 1) // 2


def test_the_pattern_is_a_sorted_upper_triangle_that_begins_with_the_diagonal(body: Body) -> None:
    assembly = body.whole
    n = len(assembly.free)
    assert assembly.indptr[0] == 0 and assembly.indptr[-1] == len(assembly.indices)
    assert np.array_equal(assembly.indices[assembly.indptr[:-1]], np.arange(n))
    step = np.diff(assembly.indices.astype(np.int64))
    step[assembly.indptr[1:-1] - 1] = 1  # from one row to the next
    assert (step > 0).all()


def test_the_assembled_tangent_is_the_one_that_is_applied(body: Body) -> None:
    assembly, u = body.whole, strained(body)
    K = dense(assembly, assembly.tangent(u))
    for v in np.random.default_rng(1).normal(size=(3, body.size)):
        product = assembly.tangent_times(u, v)
        assert K @ v == pytest.approx(product, rel=0, abs=1e-12 * float(np.abs(product).max()))


def test_the_tangent_at_rest_is_positive_but_for_rigid_motions(body: Body) -> None:
    K = dense(body.whole, body.whole.tangent(np.zeros(body.size)))
    values = np.linalg.eigvalsh(K)
    rigid = 3 if body.mirrored else 6
    assert np.abs(values[:rigid]).max() < 1e-11 * values[-1]
    assert values[rigid] > 1e-7 * values[-1]


def test_prescribed_unknowns_leave_the_rest_of_the_tangent(body: Body) -> None:
    free = np.random.default_rng(2).random(body.size) < 0.6
    part, u = body.assembly(free), strained(body)
    K = dense(body.whole, body.whole.tangent(u))[np.ix_(free, free)]
    assert np.abs(dense(part, part.tangent(u)) - K).max() < 1e-12 * np.abs(K).max()
    assert np.array_equal(part.residual(u)[1], body.whole.residual(u)[1])


def test_the_order_of_blocks_and_elements_does_not_matter(body: Body) -> None:
    u = strained(body)
    again = Assembly(body.blocks[::-1], body.size, np.arange(body.size, dtype=np.int32))
    K = body.whole.tangent(u)
    assert np.array_equal(again.indices, body.whole.indices)
    assert np.abs(again.tangent(u) - K).max() < 1e-12 * np.abs(K).max()


def test_assembly_repeats_bit_for_bit(body: Body) -> None:
    u, again = strained(body), body.assembly(np.ones(body.size, bool))
    assert np.array_equal(body.whole.tangent(u), again.tangent(u))
    assert np.array_equal(body.whole.residual(u)[1], again.residual(u)[1])
    v = np.random.default_rng(1).normal(size=body.size)
    assert np.array_equal(body.whole.tangent_times(u, v), again.tangent_times(u, v))


# --- Linear solvers

BACKENDS = ["Qdldl", "Pardiso"]


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Callable[[Ints, Ints], Factor]:
    if request.param == "Qdldl":
        return Qdldl
    pytest.importorskip("pypardiso")
    return linear.Pardiso


def system(n: int, seed: int) -> csr_matrix:
    """Upper triangle of a sparse, symmetric, strictly dominant matrix: condition below 100."""
    rng = np.random.default_rng(seed)
    a = np.triu(np.where(rng.random((n, n)) < 6 / n, rng.uniform(-1, 1, (n, n)), 0), 1)
    return csr_matrix(a + np.diag(np.abs(a + a.T).sum(axis=1) + rng.uniform(0.2, 1, n)))


def whole(upper: csr_matrix) -> Array:
    a = upper.toarray()
    return a + np.triu(a, 1).T


def factor(backend: Callable[[Ints, Ints], Factor], upper: csr_matrix) -> Factor:
    out = backend(upper.indptr, upper.indices)
    out.factorize(upper.data)
    return out


@pytest.mark.parametrize("n", [1, 2, 17, 300])
@pytest.mark.parametrize("columns", [None, 1, 5])
def test_solution_agrees_with_a_dense_one(
    backend: Callable[[Ints, Ints], Factor], n: int, columns: int | None
) -> None:
    upper = system(n, n)
    b = np.random.default_rng(1).normal(size=n if columns is None else (n, columns))
    x = factor(backend, upper).solve(b)
    assert x.shape == b.shape
    # condition number times rounding
    assert x == pytest.approx(np.linalg.solve(whole(upper), b), rel=1e-12, abs=1e-13)


def test_right_hand_sides_of_any_layout_stay_as_they_are(backend: Callable[[Ints, Ints], Factor]) -> None:
    upper = system(50, 3)
    solver = factor(backend, upper)
    b = np.random.default_rng(1).normal(size=(50, 4))
    expected = np.linalg.solve(whole(upper), b)
    for layout in (np.ascontiguousarray(b), np.asfortranarray(b), np.repeat(b, 2, axis=1)[:, ::2]):
        assert solver.solve(layout) == pytest.approx(expected, rel=1e-12, abs=1e-13)
        assert np.array_equal(layout, b)
    assert solver.solve(b[:, 1]) == pytest.approx(expected[:, 1], rel=1e-12, abs=1e-13)


def test_a_tangent_is_solved_as_well_as_its_condition_allows(backend: Callable[[Ints, Ints], Factor]) -> None:
    body = flap_body(HEIGHT)
    assembly = body.assembly(body.unknowns(np.tile(body.at[:, :1], 3)) < -1e-9)
    values = assembly.tangent(np.zeros(body.size))
    K = dense(assembly, values)
    solver = backend(assembly.indptr, assembly.indices)
    solver.factorize(values)
    b = np.random.default_rng(1).normal(size=len(K))
    x = solver.solve(b)
    # backward stable: the residual is small whatever the condition
    assert np.linalg.norm(K @ x - b) < 1e-12 * np.linalg.norm(K, 2) * np.linalg.norm(x)


INDEFINITE = {
    "negative": [[-1.0, 0, 0], [0, 2, 0], [0, 0, 3]],
    "saddle": [[1.0, 2, 0], [2, 1, 0], [0, 0, 1]],
    "late": [[1.0, 0, 0.5], [0, 1, 0.9], [0.5, 0.9, 1]],
    "zero on the diagonal": [[0.0, 1, 0], [1, 0, 0], [0, 0, 1]],
    "singular": [[1.0, 1, 0], [1, 1, 0], [0, 0, 1]],
}


@pytest.mark.parametrize("name", INDEFINITE)
def test_what_is_not_positive_definite_is_refused(backend: Callable[[Ints, Ints], Factor], name: str) -> None:
    a = np.array(INDEFINITE[name])
    i, j = np.triu_indices(3)  # the pattern keeps zeros
    solver = backend(np.array([0, 3, 5, 6], np.int32), j.astype(np.int32))
    with pytest.raises(NotPositiveDefinite):
        solver.factorize(a[i, j])
    good = a + 10 * np.eye(3)
    solver.factorize(good[i, j])
    assert good @ solver.solve(np.array([1.0, 2, 3])) == pytest.approx([1, 2, 3], rel=1e-13)


def test_a_compressed_flap_that_would_buckle_is_refused(backend: Callable[[Ints, Ints], Factor]) -> None:
    body = flap_body(HEIGHT)
    assembly = body.assembly(body.unknowns(np.tile(body.at[:, :1], 3)) < -1e-9)
    solver = backend(assembly.indptr, assembly.indices)
    # a fifth shorter lengthwise, far beyond Euler's strain of a clamped strut, pi^2 h^2 / (48 l^2) = 3 %
    squashed = assembly.tangent(body.affine(np.diag([0.8, 1.1, 1.1])))
    assert np.linalg.eigvalsh(dense(assembly, squashed))[0] < 0
    with pytest.raises(NotPositiveDefinite):
        solver.factorize(squashed)


def test_a_factorisation_follows_new_values(backend: Callable[[Ints, Ints], Factor]) -> None:
    upper = system(80, 5)
    solver, b = factor(backend, upper), np.ones(80)
    first = solver.solve(b)
    solver.factorize(2 * upper.data)
    assert solver.solve(b) == pytest.approx(first / 2, rel=1e-12)
    solver.factorize(upper.data)
    assert np.array_equal(solver.solve(b), first)


def test_several_factorisations_live_side_by_side(backend: Callable[[Ints, Ints], Factor]) -> None:
    systems = [system(n, n) for n in (30, 45, 60, 30)]
    solvers = [backend(s.indptr, s.indices) for s in systems]
    for _ in range(3):
        for solver, upper in zip(solvers, systems, strict=True):
            solver.factorize(upper.data)
        for solver, upper in zip(solvers[::-1], systems[::-1], strict=True):
            x = solver.solve(np.ones(upper.shape[0]))
            assert whole(upper) @ x == pytest.approx(1, rel=1e-12)
    del solvers[0]  # one freed, the others stay
    assert whole(systems[1]) @ solvers[0].solve(np.ones(45)) == pytest.approx(1, rel=1e-12)


def test_threads_get_the_same_bits(backend: Callable[[Ints, Ints], Factor]) -> None:
    upper = system(400, 9)

    def solve(seed: int) -> Array:
        solver = backend(upper.indptr, upper.indices)
        for _ in range(5):
            solver.factorize(upper.data * (1 + seed))
        return solver.solve(np.ones(400))

    alone = [solve(seed) for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(solve, range(8)))
    for a, b in zip(alone, together, strict=True):
        assert np.array_equal(a, b)
