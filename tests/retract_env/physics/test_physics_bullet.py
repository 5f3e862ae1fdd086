"""Bullet's soft body as a physics of the flap: static solutions, repeatability, memory, failure."""

from __future__ import annotations

import gc
import hashlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.verification.bodies import relax
from baselines.verification.flaps import HEIGHT, LENGTH, flap, square_vein
from planners.paths import INCREMENTS, ctc
from retract_env.errors import Diverged
from retract_env.fem.linear import cholesky
from retract_env.grasp import Grasp, to_jaws, to_pose
from retract_env.physics.base import Physics, TissueState
from retract_env.physics.bullet.flap import BulletPhysics, BulletResolution
from retract_env.physics.bullet.tetmesh import TetMesh
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, Vein

pytestmark = pytest.mark.skipif(
    find_spec("pybullet") is None, reason="pybullet is not installed: make bullet"
)

Array = NDArray[np.float64]
Make = Callable[..., BulletPhysics]

X = -0.025
TINY = BulletResolution("tiny", 1.2, 1, 1, 20)


@pytest.fixture
def make() -> Iterator[Make]:
    made = []

    def make(
        scene: Scene | None = None, x: float = X, resolution: str | BulletResolution = "coarse"
    ) -> BulletPhysics:
        made.append(BulletPhysics(scene or flap(), x, resolution))
        return made[-1]

    yield make
    for physics in made:
        physics.close()


def squeezed(part: float) -> Array:
    return np.array([X, HEIGHT / 2, 0.0, HEIGHT * (1 - part)])


def lifted(part: float) -> Array:
    return np.array([X + 0.001, HEIGHT / 2 + 0.004, -0.3, HEIGHT * (1 - part)])


def motion(physics: BulletPhysics) -> list[TissueState]:
    states = [physics.reset(), physics.move_to(squeezed(0.25), 1.0)]
    for k in range(1, 4):
        states.append(physics.move_to(squeezed(0.25) + k * np.array([2e-4, 1.5e-3, -0.1, 0.0]), 1.0 + k))
    return states


def same(a: TissueState, b: TissueState) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(TissueState))


# --- Statics


def deformation(mesh: TetMesh, points: Array) -> tuple[NDArray[Any], ...]:
    """Deformation gradients (m, 3, 3), inverse edges at rest and volumes."""
    rest, now = (
        np.swapaxes(p[mesh.cells[:, 1:]] - p[mesh.cells[:, :1]], 1, 2) for p in (mesh.points, points)
    )
    inverse = np.linalg.inv(rest)
    return now @ inverse, inverse, np.linalg.det(rest) / 6


def forces_of_bullets_law(physics: BulletPhysics, points: Array) -> Array:
    """Nodal forces (n, 3) N of Smith, de Goes and Kim's stable neo-Hookean solid, as Bullet has it."""
    mesh, tissue = physics.mesh, physics.scene.tissue
    mu = tissue.modulus / (2 * (1 + tissue.poisson))
    lam = 2 * mu * tissue.poisson / (1 - 2 * tissue.poisson) + 5 / 6 * mu
    mu *= 4 / 3
    F, inverse, volume = deformation(mesh, points)
    J = np.linalg.det(F)[:, None, None]
    cofactor = J * np.swapaxes(np.linalg.inv(F), 1, 2)
    trace = (F**2).sum(axis=(1, 2))[:, None, None]
    stress = mu * (1 - 1 / (trace + 1)) * F + (lam * (J - 1) - 0.75 * mu) * cofactor
    pull = (volume * mesh.copies)[:, None, None] * stress @ np.swapaxes(inverse, 1, 2)
    out = np.zeros_like(points)
    for k in range(3):
        np.add.at(out, mesh.cells[:, k + 1], pull[:, :, k])
        np.add.at(out, mesh.cells[:, 0], -pull[:, :, k])
    return out


def static_by_bullets_law(physics: BulletPhysics, points: Array) -> Array:
    """Newton's method with the tangent of the certifier's law, the same but for the square of strain."""
    assembly, points = physics.flap.assembly, points.copy()
    factor = cholesky(assembly.indptr, assembly.indices)
    for _ in range(40):
        force = (forces_of_bullets_law(physics, points) - physics.load).ravel()
        factor.factorize(assembly.tangent((points - physics.mesh.points).ravel()))
        step = np.zeros(points.size)
        step[assembly.free] = -factor.solve(force[assembly.free])
        points += step.reshape(-1, 3)
        if np.abs(step).max() < 1e-12:
            return points
    raise AssertionError("no equilibrium")


@pytest.fixture
def settled(request: pytest.FixtureRequest, make: Make) -> BulletPhysics:
    """Squeezed by a part of the height, lifted, at rest; without a bed, which Newton's method lacks here."""
    veins, part = request.param
    physics = make(flap(bed=False, veins=veins))
    physics.reset()
    physics.move_to(squeezed(part))
    physics.move_to(lifted(part))
    # the flap's slowest swing is at some 50 rad/s, so 1e-4 m/s of it are 2 um
    physics.settle(1e-4)
    return physics


VEINS = [square_vein(-0.04, 0.0022, 0.001), square_vein(-0.012, 0.0024, 0.0012, modulus=120e3)]


@pytest.mark.parametrize("settled", [([], 0.25), (VEINS, 0.1)], ids=["squeezed", "veined"], indirect=True)
def test_a_settled_flap_is_in_equilibrium_by_bullets_law(settled: BulletPhysics) -> None:
    points = settled.nodes
    assert np.abs(points - static_by_bullets_law(settled, points)).max() < 1e-5


@pytest.mark.parametrize("settled", [([], 0.02)], ids=["hardly squeezed"], indirect=True)
def test_a_settled_flap_is_in_equilibrium_by_the_certifiers_law(settled: BulletPhysics) -> None:
    # the two laws part with the square of strain, which reaches 5 % here
    u = (settled.nodes - settled.mesh.points).ravel()
    static, force = relax(settled.flap.assembly, u, settled.load.ravel())
    assert np.abs(u - static).max() < 1e-5
    state = settled.state()
    for nodes, reaction in zip(settled.mesh.patches, state.reactions, strict=True):
        expected = -force.reshape(-1, 3)[nodes, :2].sum(axis=0)
        assert reaction == pytest.approx(expected, rel=0.02, abs=2e-4)


def test_copies_multiply_stiffness(make: Make) -> None:
    whole = Vein(outline=((-LENGTH, 0), (0, 0), (0, HEIGHT), (-LENGTH, HEIGHT)), modulus=200e3)
    copied, stiff = make(flap(veins=[whole], bed=False)), make(flap(modulus=200e3, bed=False))
    assert (copied.mesh.copies == 5).all() and (stiff.mesh.copies == 1).all()
    shapes, forces = [], []
    for physics in (copied, stiff):
        physics.reset()
        physics.move_to(squeezed(0.1))
        state = physics.settle(3e-4)
        shapes.append(state.points)
        forces.append(state.reactions)
    # it hangs by its weight, so five times the mass would show as well
    assert shapes[1][0, 1] < -2e-4
    assert np.abs(shapes[0] - shapes[1]).max() < 1e-5
    assert forces[0] == pytest.approx(forces[1], rel=0.01)


def test_the_flap_rests_on_its_bed_and_hangs_without(make: Make) -> None:
    bedded, hanging = make().reset(), make(flap(bed=False)).reset()
    # its own weight presses it by rho g h^2 / 2 E = 2.4 um, in a mesh with equal masses up to twice that
    assert np.abs(bedded.points - make().section.points).max() < 1e-5
    assert hanging.points[0, 1] < -2e-3


def test_no_node_sinks_into_the_bed(make: Make) -> None:
    physics = make()
    physics.reset()
    pose = squeezed(0.25)
    lowest = []
    for step in ([0, 2e-3, -0.1, 0],) * 4 + ([0, -2e-3, 0.1, 0],) * 4 + ([2e-3, 0, 0, 0],) * 2:
        pose = pose + step
        lowest.append(physics.move_to(pose).points[:, 1].min())
    # Bullet pushes back what is deeper than its margin's allowance
    assert min(lowest) > -1e-4


# --- Against the finite elements


def test_errors_against_fine_are_as_the_docs_say(make: Make) -> None:
    scene, grasp = flap(), Grasp(X, 0.25 * HEIGHT)
    poses = ctc(scene, grasp).poses
    fine, bullet = FemPhysics(scene, X, "medium"), make(scene, resolution="medium")
    for physics in (fine, bullet):
        physics.reset()
        for k in (1, *range(5, INCREMENTS + 2, 4), INCREMENTS + 1):
            physics.move_to(poses[k])
    certified, state = fine.state(), bullet.state()
    assert state.worst_strain == pytest.approx(certified.worst_strain, rel=0.12)
    assert 1.8 < np.linalg.norm(state.reactions[1]) / np.linalg.norm(certified.reactions[1]) < 3
    # it locks: the flap sags less than it should
    tip, certified_tip = (
        s.points[p.section.points[:, 0].argmin()] for s, p in ((state, bullet), (certified, fine))
    )
    assert 0 < tip[1] - certified_tip[1] < 3e-3
    assert 0 < state.clearance - certified.clearance < 3e-3


def test_what_lags_is_small(make: Make) -> None:
    scene, grasp = flap(), Grasp(X, 0.25 * HEIGHT)
    poses = ctc(scene, grasp).poses
    physics = make(scene)
    physics.reset()
    for k in (1, *range(6, INCREMENTS + 2, 5)):
        state = physics.move_to(poses[k])
    rest = physics.settle()
    # what the docs say; 1 % of the flap's length
    assert np.abs(state.points - rest.points).max() < 5e-4
    assert state.worst_strain == pytest.approx(rest.worst_strain, rel=0.01)


def test_states_fit_the_section(make: Make) -> None:
    physics = make(flap(veins=VEINS))
    as_protocol: Physics = physics
    for state in (as_protocol.state(), as_protocol.reset(), as_protocol.move_to(squeezed(0.25), 1.0)):
        section = as_protocol.section
        assert state.points.shape == section.points.shape
        assert state.strain.shape == section.vein.shape
        assert state.jaws.shape == (4,) and state.reactions.shape == state.normals.shape == (2, 2)
        assert all(np.isfinite(value).all() for value in astuple(state)[:4])
    assert state.progress == 1.0
    assert state.jaws == pytest.approx(to_jaws(squeezed(0.25)))
    for nodes, jaw in zip(section.patches, state.jaws.reshape(2, 2), strict=True):
        assert state.points[nodes, 1] == pytest.approx(jaw[1])
        assert state.points[nodes, 0].mean() == pytest.approx(jaw[0])
    assert state.reactions[0, 1] < 0 < state.reactions[1, 1]
    assert np.abs(state.worst_at[0] - X) < 2e-3


# --- The same again


def test_a_reset_repeats_bit_for_bit(make: Make) -> None:
    physics = make(flap(veins=VEINS))
    first = motion(physics)
    again, other = motion(physics), motion(make(flap(veins=VEINS)))
    assert all(same(a, b) and same(a, c) for a, b, c in zip(first, again, other, strict=True))


def digest() -> str:
    physics = BulletPhysics(flap(veins=VEINS), X, TINY)
    points = np.concatenate([s.points for s in motion(physics)])
    physics.close()
    return hashlib.sha256(points.tobytes()).hexdigest()


def test_another_process_gets_the_same_bits() -> None:
    code = "from tests.retract_env.physics.test_physics_bullet import digest; print(digest())"
    root = Path(__file__).parents[3]
    ran = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert ran.stdout == digest() + "\n"
    assert "build time" not in ran.stderr


def test_two_flaps_do_not_disturb_each_other(make: Make) -> None:
    alone = motion(make())
    one, two = make(), make(flap(veins=VEINS), x=-0.04)
    together = [one.reset()]
    two.reset()
    pose = np.array([-0.04, HEIGHT / 2, 0.0, 0.8 * HEIGHT])
    for state in alone[1:]:
        together.append(one.move_to(_pose(state), state.progress))
        pose = pose + np.array([0, 1e-3, -0.05, 0])
        two.move_to(pose)
    assert all(same(a, b) for a, b in zip(alone, together, strict=True))


def _pose(state: TissueState) -> Array:
    index = int(state.progress) - 1
    found: Array = squeezed(0.25) + index * np.array([2e-4, 1.5e-3, -0.1, 0.0])
    return found


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_resets_and_moves_need_no_more_memory(make: Make) -> None:
    physics = make(resolution=TINY)

    def resident() -> int:
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    def work() -> None:
        physics.reset()
        physics.move_to(squeezed(0.2))

    for _ in range(20):
        work()
    before = resident()
    for _ in range(100):
        work()
    # the array of positions that pybullet would keep in each of ten parts of a move: 5 kB, 5 MB in all
    assert resident() - before < 2e6


# --- Failure and the rest


def test_a_torn_flap_raises_and_keeps_the_last_good_state(make: Make) -> None:
    physics = make()
    motion(physics)
    good = physics.state()
    pose = _pose(good)
    with pytest.raises(Diverged):
        physics.move_to(pose * [1, 1, 1, 0.01])
    assert same(physics.state(), good)
    after = physics.move_to(pose, 4.0)
    assert np.abs(after.points - good.points).max() < 1.5e-3
    assert after.worst_strain == pytest.approx(good.worst_strain, rel=0.05)


def test_a_move_that_tears_ends_where_the_limit_is_broken() -> None:
    """Right at the fixed end there is no room for a whole step."""
    x, limit = -6e-4, 0.5
    physics = BulletPhysics(flap(), x, "coarse", stop_when=lambda state: state.worst_strain > limit)
    physics.reset()
    start = np.array([x, HEIGHT / 2, 0.0, 0.98 * HEIGHT])
    physics.move_to(start, 1.0)
    state = physics.move_to(start + np.array([-2e-3, 2e-3, 0.1, 0.0]))
    assert state.worst_strain > limit
    moved = to_pose(state.jaws) - start
    assert moved[:3] / [-2e-3, 2e-3, 0.1] == pytest.approx(moved[0] / -2e-3) and 0 < moved[1] < 2e-3
    physics.close()


@pytest.mark.parametrize("pose", [[np.nan, 0, 0, 1], [0, 0, np.inf, 1], [0, 0, 0]])
def test_what_is_no_pose_is_refused(make: Make, pose: list[float]) -> None:
    physics = make(resolution=TINY)
    before = physics.reset()
    with pytest.raises(ValueError, match="allowed 4 finite numbers"):
        physics.move_to(np.array(pose))
    assert same(physics.state(), before)


def test_an_unknown_resolution_is_refused() -> None:
    with pytest.raises(ValueError, match="resolution = 'best', allowed coarse, medium, fine"):
        BulletPhysics(flap(), X, "best")


def test_closing_twice_is_once() -> None:
    physics = BulletPhysics(flap(), X, TINY)
    physics.close()
    physics.close()


def test_nothing_is_printed(make: Make, capfd: pytest.CaptureFixture[str]) -> None:
    make(resolution=TINY).reset()
    assert capfd.readouterr() == ("", "")


def test_without_pybullet_the_error_says_what_to_do() -> None:
    code = """
import sys
sys.modules["pybullet"] = None
from retract_env.physics.bullet.flap import BulletPhysics
from baselines.verification.flaps import flap
try:
    BulletPhysics(flap(), -0.025)
except ImportError as error:
    print(error)
"""
    root = Path(__file__).parents[3]
    ran = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert ran.stdout.count("\n") == 1
    assert "make bullet" in ran.stdout and "TissueRetractFEM-v0" in ran.stdout
