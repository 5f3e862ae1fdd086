"""What a chain keeps to, whatever its equilibrium: symmetries, balances, stability, lanes of their own."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from typing_extensions import Unpack

from baselines.verification.chains import (
    LENGTH,
    PLAIN,
    ROUNDING,
    Chains,
    differenced_tangent,
    factorised_tangent,
    residual,
    settled,
    solved,
    straight,
    swept,
    total_energy,
)
from retract_env.rod import chain
from retract_env.rod.chain import LANES
from retract_env.rod.equilibrium import TOLERANCE

Array = NDArray[np.float64]

D = PLAIN[2]
COUPLED = (1.1, -0.1, 0.09, 0.3)
"""A, B, D and G of a section with a vein above the axis; positive definite after changes by a third, too"""


class Surroundings(TypedDict, total=False):
    """Per length: weight, E d; stiffness of bed and block, E d / h."""

    weight: float
    bed: float
    block: float


FLAP: Surroundings = {"weight": 0.0108, "bed": 0.3, "block": 0.3}
"""Ten times as heavy as the paper's flap, on a stiff bed."""


def crumpled(
    seed: int,
    elements: int = 5,
    clamped: bool = False,
    size: float = 0.2,
    **surroundings: Unpack[Surroundings],
) -> Chains:
    """Nowhere near equilibrium, with sections that are all different, some of it in bed and block."""
    rng = np.random.default_rng(seed)
    loads = rng.normal(scale=0.1, size=(3, LANES))
    chains = straight(
        elements,
        0.7 * elements,
        COUPLED,
        load=(loads[0], loads[1], loads[2]),
        clamped=clamped,
        **surroundings,
    )
    sections = chains.P[chain.STIFFNESS :].reshape(elements, 4, LANES)
    sections *= rng.uniform(0.7, 1.4, sections.shape)
    chains.P[chain.SLACK] = np.linspace(0, 0.15, LANES)
    chains.U += rng.normal(scale=size, size=chains.U.shape)
    chains.nodes[:, 0] += 0.5
    return chains


def touching(chains: Chains) -> Chains:
    """With all sections clear of where contact's second derivative jumps.

    Lanes in which they are take the place of the others.
    """
    s, c = np.sin(chains.nodes[:, 2]), np.cos(chains.nodes[:, 2])
    X, Y = chains.nodes[:, 0] + s / 2, chains.nodes[:, 1] - c / 2
    edges = np.min(np.abs([X, Y, 1 - Y, np.maximum(X, 0) - np.maximum(1 - Y, 0)]), axis=0)
    assert (Y < 0).any() and ((X > 0) & (Y < 1)).any()
    keep = np.flatnonzero((edges > 0.02).all(axis=0))
    assert len(keep)
    chains.U[:] = chains.U[:, keep[np.arange(LANES) % len(keep)]]
    chains.P[:] = chains.P[:, keep[np.arange(LANES) % len(keep)]]
    return chains


def pulled(clamped: bool) -> Chains:
    """A little stretched and curved, so that pivots are positive and the factors the tangent's own."""
    chains = crumpled(2, clamped=clamped, size=0.02, **FLAP)
    chains.nodes[:, 0] = 1.15 * chains.nodes[:, 0] + 1.0
    chains.nodes[:, 1] -= 0.1
    return touching(chains)


# Energy, residual, tangent


@pytest.mark.parametrize("clamped", [False, True])
def test_the_energy_of_a_sweep_is_the_one_that_the_line_search_computes(clamped: bool) -> None:
    chains = crumpled(0, clamped=clamped, **FLAP)
    assert swept(chains).energy == pytest.approx(total_energy(chains), abs=ROUNDING)


@pytest.mark.parametrize("clamped", [False, True])
def test_the_residual_is_what_differences_of_the_energy_tend_to(clamped: bool) -> None:
    """And what holds the ends is, too, also where the rest is not in equilibrium."""
    chains = touching(crumpled(1, clamped=clamped, **FLAP))
    last = swept(chains)
    exact = np.concatenate([*([last.left] if clamped else []), residual(chains), last.right])
    errors = []
    for step in (2e-3, 1e-3):
        found = np.empty_like(exact)
        for row in range(len(chains.U)):
            ahead, behind = chains.U.copy(), chains.U.copy()
            ahead[row] += step
            behind[row] -= step
            found[row] = (total_energy(chains.moved(ahead)) - total_energy(chains.moved(behind))) / (2 * step)
        errors.append(np.abs(found - exact).max())
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.1)
    assert errors[1] < 1e-5


@pytest.mark.parametrize("clamped", [False, True])
def test_the_tangent_is_what_differences_of_the_residual_tend_to(clamped: bool) -> None:
    chains = pulled(clamped)
    exact = factorised_tangent(chains)
    coarse, fine = (np.abs(differenced_tangent(chains, step) - exact).max() for step in (2e-3, 1e-3))
    assert coarse / fine == pytest.approx(4, abs=0.1)
    assert fine < 1e-4


@pytest.mark.parametrize("clamped", [False, True])
def test_newton_s_step_solves_the_tangent_s_equations(clamped: bool) -> None:
    chains = pulled(clamped)
    W, Z = (np.zeros(rows * LANES) for rows in (chain.SCRATCH, chain.factor_rows(chains.elements)))
    chain.sweep(chains.P.ravel(), chains.U.ravel(), W, Z, chains.elements, clamped)
    chain.newton_step(W, Z, chains.elements, clamped)
    nodes = range(chains.first, chains.elements)
    step = Z.reshape(-1, LANES)[[chain.PER_NODE * node + 18 + k for node in nodes for k in range(3)]]
    forces = residual(chains)
    left = np.einsum("lij,jl->il", factorised_tangent(chains), step) + forces
    assert np.abs(left).max() < ROUNDING * np.abs(step).max() * 100
    found = W.reshape(-1, LANES)
    assert found[chain.SLOPE] == pytest.approx((step * forces).sum(axis=0), rel=1e-9)
    assert found[chain.LARGEST] == pytest.approx(np.abs(step[2::3]).max(axis=0))
    assert found[chain.WORST] == pytest.approx(np.abs(forces).max(axis=0), rel=1e-9)


# Symmetries


@settings(deadline=None, max_examples=20)
@given(st.floats(-3, 3), st.floats(-5, 5), st.floats(-5, 5), st.integers(0, 99))
def test_a_rigid_motion_changes_no_energy_and_turns_the_forces(
    a: float, x: float, y: float, seed: int
) -> None:
    """Without weight, contact and load."""
    chains = crumpled(seed)
    chains.P[chain.LOAD : chain.STIFFNESS] = 0
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    moved = np.einsum("ij,njl->nil", turn, chains.nodes) + np.array([x, y, a])[:, None]
    there = chains.moved(moved.reshape(-1, LANES))
    scale = 1 + np.abs(residual(chains)).max()
    assert total_energy(there) == pytest.approx(total_energy(chains), abs=10 * scale * ROUNDING)
    turned = np.einsum("ij,njl->nil", turn, residual(chains).reshape(-1, 3, LANES))
    assert residual(there) == pytest.approx(turned.reshape(-1, LANES), abs=10 * scale * ROUNDING)


def test_the_mirrored_problem_has_the_mirrored_answer() -> None:
    """y and theta change signs, and so do the loads on them and the coupling B; the axis is then y = 0."""
    rng = np.random.default_rng(3)
    loads = rng.normal(scale=0.01, size=(3, LANES))
    chains = straight(12, LENGTH, COUPLED, load=(loads[0], loads[1], loads[2]))
    chains.nodes[:, 1] = 0
    mirrored = chains.moved(chains.U.copy())
    mirrored.P = chains.P.copy()
    mirrored.P[[chain.LOAD + 1, chain.LOAD + 2]] *= -1
    mirrored.P[chain.STIFFNESS + 1 :: 4] *= -1
    one, other = settled(chains), settled(mirrored)
    assert np.abs(one.nodes[0, 2]).max() > 0.5
    assert other.nodes * np.array([1, -1, -1])[:, None] == pytest.approx(one.nodes, abs=ROUNDING)


# Balances


def arch(elements: int, **surroundings: Unpack[Surroundings]) -> Chains:
    """Clamped at both ends, the left one pushed in and raised differently in each lane; a bent guess."""
    chains = straight(elements, clamped=True, **surroundings)
    t = np.linspace(1, 0, elements + 1)[:, None]
    raised = np.linspace(0.0, 2.0, LANES)
    chains.nodes[:, 0] *= 1 - np.linspace(0.05, 0.2, LANES)
    chains.nodes[:, 1] += raised * t**2 * (3 - 2 * t) + 0.8 * np.sin(np.pi * t) ** 2
    chains.nodes[0, 2] = np.linspace(-0.4, 0.4, LANES)
    return chains


@pytest.mark.parametrize("surroundings", [{}, {"weight": 0.0108}, FLAP], ids=["bare", "heavy", "on the bed"])
def test_what_holds_the_ends_balances_weight_and_contact(surroundings: Surroundings) -> None:
    """Forces, and moments about the origin."""
    elements = 16
    there, done, last = solved(arch(elements, **surroundings))
    assert done.all()
    weight, bed = surroundings.get("weight", 0.0), surroundings.get("bed", 0.0)
    length = LENGTH / elements
    x, y, theta = there.nodes.transpose(1, 0, 2)
    carried = np.full((elements + 1, 1), length * weight)
    carried[[0, -1]] /= 2
    pushed = length * bed * np.maximum(np.cos(theta) / 2 - y, 0)
    pushed[[0, -1]] = 0  # clamped sections are pushed on by none
    assert ((x + np.sin(theta) / 2)[1:-1] < 0).all()  # clear of the block
    if bed:
        assert pushed.any()
    upwards = (pushed - carried).sum(axis=0)
    assert last.left[0] + last.right[0] == pytest.approx(np.zeros(LANES), abs=1e-8)
    assert last.left[1] + last.right[1] + upwards == pytest.approx(np.zeros(LANES), abs=1e-8)
    moments = last.left[2] + last.right[2] + ((x + np.sin(theta) / 2) * pushed - x * carried).sum(axis=0)
    for end, (fx, fy, _) in ((0, last.left), (-1, last.right)):
        moments = moments + x[end] * fy - y[end] * fx
    assert moments == pytest.approx(np.zeros(LANES), abs=1e-8)


def test_what_holds_the_ends_is_what_moving_them_costs() -> None:
    """The energy of equilibria over places of a clamped end has the reactions for a derivative."""
    start = settled(arch(12, **FLAP))
    _, done, last = solved(start)
    assert done.all()
    errors = []
    for step in (2e-3, 1e-3):
        worst = 0.0
        for node, reactions in ((0, last.left), (12, last.right)):
            for k in range(3):
                energies = []
                for way in (step, -step):
                    moved = start.moved(start.U.copy())
                    moved.nodes[node, k] += way
                    energies.append(total_energy(settled(moved)))
                slope = (energies[0] - energies[1]) / (2 * step)
                worst = max(worst, float(np.abs(slope - reactions[k]).max()))
        errors.append(worst)
    # where sections begin to touch the bed the third derivative jumps, hence no order of 2 sharp
    assert errors[1] < 1e-5
    assert errors[1] < 0.6 * errors[0]


def test_a_flap_on_its_bed_sinks_in_until_it_is_carried() -> None:
    weight, bed = 0.0108, np.geomspace(0.1, 10, LANES)
    sunk = weight / bed
    chains = straight(10, weight=weight, bed=bed)
    chains.nodes[-1, 1] -= sunk
    there = settled(chains)
    assert there.nodes[:, 1] == pytest.approx(np.broadcast_to(0.5 - sunk, (11, LANES)), abs=1e-8)
    assert there.nodes[:, 2] == pytest.approx(np.zeros((11, LANES)), abs=1e-8)
    assert swept(there).right == pytest.approx(
        np.vstack([np.zeros(LANES), weight * 0.4 + np.zeros(LANES), np.zeros(LANES)]), abs=1e-8
    )


# Lanes


def mixed(elements: int, clamped: bool) -> Chains:
    """As many different problems, from light to hard, among them some that buckle."""
    chains = arch(elements, **FLAP)
    chains.clamped = clamped
    chains.P[chain.LOAD : chain.STIFFNESS] = np.random.default_rng(5).normal(scale=0.01, size=(3, LANES))
    chains.P[chain.BED, ::3] = 0
    chains.nodes[:, 0, 3::5] *= 0.7
    return chains


def hopeless(chains: Chains) -> Chains:
    """In turn: crushed, not a number, without end, and with stiffness that is none."""
    bad = chains.moved(chains.U.copy())
    bad.P = chains.P.copy()
    bad.nodes[:, 0, 0::4] *= 1e-3
    bad.U[:, 1::4] = np.nan
    bad.P[chain.LOAD, 2::4] = np.inf
    bad.P[chain.STIFFNESS :, 3::4] = 0
    return bad


@pytest.mark.parametrize("clamped", [False, True])
def test_lanes_neither_see_each_other_nor_mind_their_order(clamped: bool) -> None:
    """To the last bit, and whatever may fail beside them."""
    chains = mixed(9, clamped)
    there, done, last = solved(chains)
    assert done.sum() > LANES / 2
    beside = hopeless(chains)
    for lane in range(LANES):
        alone = chains.moved(beside.U.copy())
        alone.P = beside.P.copy()
        at = (5 * lane + 3) % LANES
        alone.U[:, at], alone.P[:, at] = chains.U[:, lane], chains.P[:, lane]
        with np.errstate(all="ignore"):
            u, fine, swept_ = solved(alone)
        assert fine[at] == done[lane]
        np.testing.assert_array_equal(u.U[:, at], there.U[:, lane])
        if done[lane]:
            np.testing.assert_array_equal(swept_.left[:, at], last.left[:, lane])
            np.testing.assert_array_equal(swept_.right[:, at], last.right[:, lane])


def test_lanes_that_are_not_asked_for_stay_where_they_are() -> None:
    chains = mixed(9, True)
    todo = np.arange(LANES) % 2 == 0
    all_there, all_done, _ = solved(chains)
    there, done, _ = solved(chains, todo)
    np.testing.assert_array_equal(done, all_done & todo)
    np.testing.assert_array_equal(there.U[:, ~todo], chains.U[:, ~todo])
    np.testing.assert_array_equal(there.U[:, todo], all_there.U[:, todo])
    _, none, _ = solved(chains, False)
    assert not none.any()
    bad = chains.moved(chains.U.copy())
    bad.P = np.where(todo, chains.P, np.nan)
    there, done, _ = solved(bad, todo)
    np.testing.assert_array_equal(done, all_done & todo)
    np.testing.assert_array_equal(there.U, np.where(todo, all_there.U, chains.U))


@pytest.mark.parametrize(
    "row", [chain.WEIGHT, chain.BED, chain.LOAD, chain.LOAD + 2, chain.STIFFNESS, chain.LENGTH]
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_never_done(row: int, value: float) -> None:
    chains = straight(4, **FLAP)
    chains.P[row, ::2] = value
    _, done, _ = solved(chains)
    assert not done[::2].any()
    assert done[1::2].all()


# Stability


def assert_stable(there: Chains, done: NDArray[np.bool_]) -> None:
    """Looked at densely, and from nothing but the residual."""
    assert np.abs(residual(there)[:, done]).max(initial=0) <= TOLERANCE
    # a difference across the edge of a contact, where the stiffness jumps, is no derivative
    x, y, theta = there.nodes.transpose(1, 0, 2)
    right, up = x + np.sin(theta) / 2, y - np.cos(theta) / 2
    edges = np.abs([up, right, 1 - up, right - (1 - up)]).min(axis=(0, 1))
    smooth = done & (edges > 1e-4)
    K = differenced_tangent(there)
    assert np.abs(K - K.transpose(0, 2, 1))[smooth].max(initial=0) < 1e-6
    assert np.linalg.eigvalsh((K + K.transpose(0, 2, 1)) / 2)[smooth].min(initial=1) > 0


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.floats(0, 0.4), st.booleans())
def test_what_is_done_is_in_a_stable_equilibrium(seed: int, clamped: bool, size: float, bare: bool) -> None:
    """From starts that lead to many equilibria, some of which are unstable."""
    rng = np.random.default_rng(seed)
    chains = crumpled(seed, 6, clamped, size, **(Surroundings() if bare else FLAP))
    chains.P[chain.LOAD : chain.STIFFNESS] *= rng.uniform(0, 1, LANES)
    chains.nodes[:, 0] *= rng.uniform(0.3, 1.1, LANES)
    there, done, _ = solved(chains)
    assert_stable(there, done)


def columns(shortening: Array, aside: float) -> Chains:
    """Between clamps, shortened by a share of the length, and pushed a little out of line."""
    chains = straight(16, clamped=True)
    chains.U[0::3] *= 1 - shortening
    chains.nodes[:, 1] += aside * np.sin(np.pi * np.linspace(0, 1, 17)[:, None]) ** 2
    return chains


EULER = 4 * np.pi**2 * D / LENGTH**2
"""Share of its length by which a slender column between clamps may be shortened; 6 % too much for this one"""


def test_a_column_is_left_straight_below_its_buckling_load_alone() -> None:
    shortening = np.linspace(0.3, 4, LANES) * EULER
    straight_on, done, _ = solved(columns(shortening, 0.0))
    stays = shortening < 0.9 * EULER
    assert done[stays].all()
    assert straight_on.nodes[:, 1, done & stays] == pytest.approx(0.5, abs=1e-9)
    bent = np.abs(straight_on.nodes[8, 1] - 0.5) > 0.1
    assert (bent | ~done)[~stays].all(), "done, but straight"

    aside, done, _ = solved(columns(shortening, 1e-3))
    assert done.all()
    assert_stable(aside, done)
    assert (np.abs(aside.nodes[8, 1] - 0.5) > 0.1)[shortening > 1.1 * EULER].all()
    assert aside.nodes[:, 1, stays] == pytest.approx(0.5, abs=1e-8)
