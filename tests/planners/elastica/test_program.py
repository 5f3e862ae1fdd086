"""The rod against exact solutions and finite elements, the program against what it must return."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from baselines.verification.flaps import HEIGHT, LENGTH, flap
from planners.elastica.grip import Grip
from planners.paths import arc_turn, ctc_motion, goal_radius
from retract_env.grasp import Grasp, to_jaws
from retract_env.objectives import clearance
from retract_env.physics.fem import FemPhysics
from retract_env.physics.measures import tool_outline
from retract_env.rod.sections import elements
from retract_env.scene import Limits, LineOfSight, Scene, Tissue

ca: Any = pytest.importorskip("casadi")
elastica = pytest.importorskip("planners.elastica.program")

Array = NDArray[np.float64]

GRIP = Grip(normal=(0.37, 0.11), strain=(1.2, -0.3))
"""About what finite elements say of the paper's flap."""
IDEAL_GRIP = Grip(normal=(10.0, 0.0), strain=(0.0, 0.0))
"""Holds everything and strains nothing."""


def shape(scene: Scene, x: float, pose: Array | None = None, count: int = 20) -> tuple[Array, Array, Array]:
    """Nodes (m, 3) x, y in m, theta of the rod in equilibrium, from the free to the fixed end, and forces and
    moments (3,) N, N m of the jaws and of the fixed end on it.

    pose: (3,) of the jaws, which hold the section at x, or None: no jaws.
    """
    tissue, unit = scene.tissue, elastica.force_unit(scene)
    length, height = tissue.length, tissue.height / tissue.length
    weight = tissue.density * scene.gravity * tissue.height * tissue.depth * length / unit
    bed = scene.bed * elastica.BED * tissue.modulus / tissue.height * tissue.depth * length**2 / unit
    opti = ca.Opti()
    rods = []
    for left, right in ((-length, x), (x, 0.0)):
        part = elements(tissue, left, right, count)
        sections = ca.DM(elastica.scaled(part, length, unit))
        rods.append(elastica.Rod(opti, part.length / length, sections, height, weight, bed))
        start = np.zeros((6, count + 1))
        start[0], start[1] = np.linspace(left, right, count + 1) / length, height / 2
        opti.set_initial(rods[-1].state, start)
    outer, inner = (rod.state for rod in rods)
    opti.subject_to(outer[3:, 0] == 0)
    opti.subject_to(outer[:3, -1] == inner[:3, 0])
    opti.subject_to(inner[:3, -1] == ca.vertcat(0, height / 2, 0))
    load = outer[3:, -1] - inner[3:, 0]
    held = load if pose is None else inner[:3, 0] - ca.DM(pose / [length, length, 1.0])
    opti.subject_to(held == 0)
    opti.solver("ipopt", {"expand": True, "print_time": False}, {"print_level": 0, "sb": "yes"})
    found = opti.solve()
    nodes = np.concatenate([found.value(rod[:3, :]).T for rod in (outer, inner[:, 1:])])
    forces = (found.value(f).ravel() * [unit, unit, unit * length] for f in (load, inner[3:, -1]))
    return nodes * [length, length, 1.0], *forces


def heavy_cantilever(tissue: Tissue, gravity: float) -> float:
    """Drop of the tip, m, of an inextensible elastica under its own weight: EI theta'' = w s cos theta."""
    stiffness = tissue.modulus * tissue.depth * tissue.height**3 / 12
    load = tissue.density * gravity * tissue.height * tissue.depth / stiffness
    s = np.linspace(0, tissue.length, 200)  # from the free end
    found = solve_bvp(
        lambda s, y: np.stack([y[1], -load * s * np.cos(y[0]), np.sin(y[0])]),
        lambda free, fixed: np.array([free[1], fixed[0], free[2]]),
        s,
        np.zeros((3, s.size)),
        tol=1e-8,
    )
    assert found.success
    return float(found.y[2, -1])


def test_a_heavy_cantilever_hangs_like_the_elastica() -> None:
    # a thin flap of the same weight over stiffness; shear adds a part of the order of (h / l)^2 to the drop
    thin = HEIGHT / 8
    scene = flap(height=thin, modulus=600e3 * 64, bed=False)
    drop = heavy_cantilever(scene.tissue, scene.gravity)
    assert drop == pytest.approx(7.756e-3, abs=1e-6)
    nodes, load, _ = shape(scene, -0.5 * LENGTH)
    assert thin / 2 - nodes[0, 1] == pytest.approx(drop, rel=1e-3)
    assert load == pytest.approx(0, abs=1e-9)


def test_the_paper_s_cantilever_hangs_lower_by_its_shear() -> None:
    scene = flap(modulus=600e3, bed=False)
    tissue = scene.tissue
    area = tissue.height * tissue.depth
    stiffness = 5 / 6 * area * tissue.modulus / (2 * (1 + tissue.poisson))
    shear = tissue.density * scene.gravity * area * LENGTH**2 / (2 * stiffness)
    nodes, *_ = shape(scene, -0.5 * LENGTH)
    # the tip is turned by a quarter, of which the shear that is added knows only in part
    assert HEIGHT / 2 - nodes[0, 1] == pytest.approx(7.756e-3 + shear, rel=2e-3)


def test_the_rod_converges_at_second_order() -> None:
    scene = flap(modulus=600e3, bed=False)
    pose = ctc_motion(0.9, 0.03, HEIGHT)
    exact, *_ = shape(scene, -0.03, pose, 64)
    errors = []
    for count in (4, 8, 16):
        nodes, *_ = shape(scene, -0.03, pose, count)
        errors.append(float(np.abs(nodes - exact[:: 64 // count]).max()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.3)


def test_forces_and_moments_balance() -> None:
    """The midpoint rule keeps both exactly: what the jaws, the fixed end and the weight do cancels out."""
    scene, x = flap(bed=False), -0.03
    pose = ctc_motion(0.9, -x, HEIGHT)
    nodes, load, support = shape(scene, x, pose)
    per_length = scene.tissue.density * scene.gravity * HEIGHT**2
    weight = np.repeat([(LENGTH + x) / 20, -x / 20], 20) * per_length
    assert load[:2] + support[:2] == pytest.approx([0, weight.sum()], abs=1e-8 * weight.sum())
    middles = (nodes[1:, 0] + nodes[:-1, 0]) / 2
    moments = [at[0] * f[1] - at[1] * f[0] + f[2] for at, f in ((pose, load), ((0, HEIGHT / 2), support))]
    assert sum(moments) == pytest.approx(middles @ weight, rel=1e-6)


@pytest.mark.parametrize("bed", [True, False])
def test_a_thin_flap_takes_the_same_shape_on_finite_elements(bed: bool) -> None:
    """Shape within 0.5 % of the length, the jaws' force within 15 %: the grip squeezes tissue out to either
    side of the patches, and the rod hardly gives way along its axis."""
    height, x, grip = HEIGHT / 2, -0.03, 0.05
    scene = flap(height=height, depth=HEIGHT, modulus=160e3, bed=bed)
    physics = FemPhysics(scene, x, "coarse")
    physics.reset()
    pose = np.array([x, height / 2, 0.0])
    for turn in np.linspace(0, 0.9, 7):
        pose = ctc_motion(turn, -x, height)
        state = physics.move_to(np.append(pose, height * (1 - grip)))
    nodes, load, _ = shape(scene, x, pose)
    at = np.concatenate([np.linspace(-LENGTH, x, 21), np.linspace(x, 0, 21)[1:]])
    rest, now = physics.section.points, state.points
    surfaces = []
    for y in (0.0, height):
        on = np.flatnonzero(np.abs(rest[:, 1] - y) < 1e-9)
        on = on[np.argsort(rest[on, 0])]
        surfaces.append(np.stack([np.interp(at, rest[on, 0], now[on, k]) for k in range(2)], axis=-1))
    assert np.abs(np.mean(surfaces, axis=0) - nodes[:, :2]).max() < 5e-3 * LENGTH
    force = -state.reactions.sum(axis=0)
    assert np.hypot(*(force - load[:2])) < 0.15 * np.hypot(*force)


@pytest.mark.parametrize(("target", "slope"), [(0.25, 45), (0.15, 45), (0.25, 60)])
def test_without_weight_and_grip_strain_the_optimum_is_the_arc_that_touches_the_line(
    target: float, slope: float
) -> None:
    line = LineOfSight.at(-target * LENGTH, np.radians(slope))
    scene = flap(gravity=0.0).model_copy(update={"line_of_sight": line})
    x = -0.6 * LENGTH
    best = elastica.solve(scene, Grasp(x, 1e-3), IDEAL_GRIP)
    # the line that is cleared lies `CLEAR` nearer to the fixed end
    moved = LineOfSight.at(line.target[0] + elastica.CLEAR * LENGTH / np.sin(line.slope), line.slope)
    radius = goal_radius(moved.camera, moved.target)
    # only nodes keep clear of the line: the arc may bend less, by a part of (step / radius)^2 / 8
    assert best.strain == pytest.approx(HEIGHT / 2 / (radius - HEIGHT / 2), rel=5e-3)
    arc = ctc_motion(arc_turn(1 / radius, -x, HEIGHT), -x, HEIGHT)
    assert best.poses[-1] == pytest.approx(arc, abs=5e-3)
    assert best.poses[-1, :2] == pytest.approx(arc[:2], abs=2e-3 * LENGTH)


def test_jaws_that_are_in_sight_keep_clear_of_the_line_too() -> None:
    hidden = flap()
    seen = hidden.model_copy(update={"jaws": hidden.jaws.model_copy(update={"in_sight": True})})
    line, lowest = hidden.line_of_sight, []
    for scene in (hidden, seen):
        best = elastica.solve(scene, Grasp(-0.6 * LENGTH, 1e-3), GRIP)
        closed = np.append(best.poses[-1], HEIGHT - best.compression)
        corners = tool_outline(scene, to_jaws(closed))
        lowest.append(min(clearance(corner, line.camera, line.target) for corner in corners))
    assert lowest[0] < 0 < lowest[1]
    assert lowest[1] >= 0.99 * elastica.CLEAR * LENGTH


def test_twice_the_size_at_twice_the_modulus_is_the_same_problem() -> None:
    """Weight over stiffness is rho g l / E."""
    small, large = flap(), flap(2 * LENGTH, 2 * HEIGHT, 2 * HEIGHT, modulus=80e3)
    grips = GRIP, Grip((8 * GRIP.normal[0], 8 * GRIP.normal[1]), GRIP.strain)
    a, b = (
        elastica.solve(scene, Grasp(-0.7 * scene.tissue.length, 1e-3), grip)
        for scene, grip in zip((small, large), grips, strict=True)
    )
    assert b.strain == pytest.approx(a.strain, rel=1e-5)
    assert b.compression == pytest.approx(2 * a.compression, rel=1e-3)
    assert b.poses[-1] == pytest.approx(a.poses[-1] * [2, 2, 1], rel=1e-3)


def test_jaws_stay_in_their_cones_and_rougher_ones_cost_less_strain() -> None:
    strains = []
    for friction in (0.3, 0.5, 1.0):
        scene = flap().model_copy(update={"limits": Limits(friction=friction)})
        best = elastica.solve(scene, Grasp(-0.9 * LENGTH, 1e-3), GRIP)
        tangential, normal = best.forces[:2], best.forces[2:]
        assert (np.abs(tangential) <= elastica.RESERVE * friction * normal * (1 + 1e-5)).all()
        strains.append(best.strain)
    assert strains[0] > strains[1] > strains[2]


def test_forces_that_finite_elements_add_are_held_too() -> None:
    scene, grasp = flap(), Grasp(-0.7 * LENGTH, 1e-3)
    free = elastica.solve(scene, grasp, GRIP)
    more = np.zeros((4, elastica.POSES))
    more[2:] = -3e-3  # N, a third of the flap's weight, less pressure
    held = elastica.solve(scene, grasp, GRIP, more, free)
    forces = held.forces + more
    limit = elastica.RESERVE * scene.limits.friction
    assert (np.abs(forces[:2]) <= limit * forces[2:] * (1 + 1e-5)).all()
    assert held.strain > free.strain


def test_an_answer_does_not_depend_on_what_was_solved_before() -> None:
    grasps = [Grasp(part * LENGTH, 1e-3) for part in (-0.7, -0.9, -0.7)]
    first, _, again = (elastica.solve(flap(), grasp, GRIP) for grasp in grasps)
    assert np.array_equal(again.poses, first.poses) and again.compression == first.compression


def test_the_path_passes_through_the_poses_and_goes_on() -> None:
    scene, grasp = flap(), Grasp(-0.7 * LENGTH, 1e-3)
    best = elastica.solve(scene, grasp, GRIP)
    path = elastica.jaw_path(scene, best)
    at = 1 + elastica.INCREMENTS * np.arange(elastica.POSES + 1)
    assert path.poses[at, :3] == pytest.approx(best.poses, abs=1e-9)
    assert path.poses[1:, 3] == pytest.approx(HEIGHT - best.compression)
    assert path.last == at[-1] + elastica.OVERRUN


def test_a_grasp_that_cannot_work_is_unsolved() -> None:
    """The jaws are 1.5 mm from the fixed end, and the flap hangs down beyond them."""
    with pytest.raises(elastica.Unsolved, match=r"infeasible|maximum iterations"):
        elastica.solve(flap(), Grasp(-1.5e-3, 1e-3), GRIP)
