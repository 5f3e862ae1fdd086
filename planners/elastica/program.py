"""Optimal retraction of a planar rod: grip, jaw path and final pose in one nonlinear program.

The flap is Reissner's rod on its bed (`retract_env.rod`), in equilibrium with each of POSES poses of the
jaws. `Program` writes the problem down: variables, dynamics along the rod, boundaries, constraints,
objective. IPOPT solves it with CasADi's exact sparse derivatives, started from the CTC arcs. `planner` tries
what comes out on finite elements.

The surfaces' greatest strain bounds the rod's eps_1%, the mean of the worst 1 % of volume, from above; it is
that closely, as bending strains long stretches of the surface alike.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planners import paths
from planners.elastica.grip import Grip
from retract_env.grasp import Grasp, JawPath, to_jaws
from retract_env.physics.measures import tool_outline
from retract_env.rod.sections import Elements, elements
from retract_env.scene import Scene

try:
    import casadi
except ImportError:
    raise ImportError('planner "elastica" needs casadi: pip install "retract[optimize]"') from None

ca: Any = casadi  # its annotations differ from release to release
Array = NDArray[np.float64]

KIND = "elastica"
POSES = 8
"""Jaw poses in which the rod is in equilibrium; the last one exposes the target."""
ELEMENTS = 10
"""Rod elements on either side of the jaws."""
INCREMENTS = 3
"""Waypoints from one pose to the next."""
OVERRUN = 6
"""Waypoints past the last pose, straight on, should the flap hang a little lower than the rod."""

CLEAR = 0.005
"""Clearance over the line of sight at the end beyond what the scene asks for, over the flap's length."""
RESERVE = 0.92
"""Part of the friction limit that the program uses."""
GRIPS = (0.005, 0.45)
"""Least and greatest compression, over h."""
REACH = (0.2, 0.2, 0.7)
"""Farthest from one pose to the next: x and y in flap lengths, angle in rad."""
NORM = 4
"""The strains a of the grip and b of the rod act together beside the jaws: as (a^4 + b^4)^(1/4)."""
SMOOTH = 1e-2
"""Weight, beside the strain, of the poses' squared second differences (in flap lengths and rad)."""
BED = 0.1
"""Stiffness of the bed per area, in E / h of the tissue; the paper's flap sinks in by one per cent of h."""
TOUCH = 0.01
"""Gap, over h, within which the bed begins to push."""

IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "linear_solver": "mumps",
    "mumps_pivot_order": 0,  # approximate minimum degree: quickest for chains of small blocks
    "mu_strategy": "adaptive",
    "nlp_scaling_method": "none",  # all is of order one already
    "max_iter": 120,
    "tol": 1e-6,
}


class Unsolved(Exception):
    """No solution of the program was found; the message is IPOPT's, in words."""


class Rod:
    """One side of the flap in one pose: its state at the nodes, and its equilibrium between them.

    Lengths are in flap lengths l, forces in some unit F. state: (6, n + 1) x, y, turn theta, force and moment
    that the part to the right exerts, from the free to the fixed side. step: of one element along the rod;
    sections: (8, n), `scaled`; height h; weight: per length; bed: force per length and depth.
    """

    def __init__(self, opti: Any, step: Any, sections: Any, height: Any, weight: Any, bed: Any):
        self.state = opti.variable(6, sections.shape[1] + 1)
        x, y, theta, force_x, force_y, moment = ca.vertsplit((self.state[:, 1:] + self.state[:, :-1]) / 2)
        stretch, couple, bend, shear, *surfaces = ca.vertsplit(sections)
        cos, sin = ca.cos(theta), ca.sin(theta)

        # strains from forces
        normal, across = cos * force_x + sin * force_y, cos * force_y - sin * force_x
        along, aside = 1 + stretch * normal + couple * moment, shear * across
        curvature = couple * normal + bend * moment
        self.strain = ca.horzcat(*(surfaces[k] * normal + surfaces[k + 1] * moment for k in (0, 2)))
        """(1, 2 n) of the lower and the upper surface"""

        # d state / ds, by the implicit midpoint rule
        gap = y - height / 2 * cos
        push = bed * (ca.sqrt(gap**2 + (TOUCH * height) ** 2) - gap) / 2
        dx, dy = cos * along - sin * aside, sin * along + cos * aside
        slope = ca.vertcat(dx, dy, curvature, 0 * x, weight - push, dy * force_x - dx * force_y)
        opti.subject_to(self.state[:, 1:] - self.state[:, :-1] == step * slope)

        # both surfaces at the nodes
        x, y, theta = ca.vertsplit(self.state[:3, :])
        dx, dy = -height / 2 * ca.sin(theta), height / 2 * ca.cos(theta)
        self.lower, self.upper = ca.vertcat(x - dx, y - dy), ca.vertcat(x + dx, y + dy)


class Program:
    """The nonlinear program, for any scene and grasp: they are its parameters.

    Lengths are in flap lengths l, forces in `force_unit`.
    """

    def __init__(self, in_sight: bool = False) -> None:
        """in_sight: whether pads and stems have to keep clear of the line of sight, too."""
        self.opti = opti = ca.Opti()

        # Given: flap, line of sight, grasp, grip; what finite elements added to the jaws' forces
        self.height, self.weight, self.bed = h, weight, bed = [opti.parameter() for _ in range(3)]
        self.sections = [(opti.parameter(), opti.parameter(8, ELEMENTS)) for _ in range(2)]
        self.camera, self.target, self.grasp = opti.parameter(2), opti.parameter(2), opti.parameter()
        self.pressure, self.squeeze = opti.parameter(2), opti.parameter(2)
        self.friction, self.correction = opti.parameter(), opti.parameter(4, POSES)
        self.goal = opti.parameter()
        self.tool = opti.parameter(2, 16) if in_sight else None

        # Variables: compression c, strain b of the rod, and the rod in each pose, with its dynamics
        self.compression, self.strain = c, b = opti.variable(), opti.variable()
        outer, inner = (
            [Rod(opti, *sections, h, weight, bed) for _ in range(POSES)] for sections in self.sections
        )
        self.rods = outer, inner
        self.poses = ca.horzcat(ca.vertcat(self.grasp, h / 2, 0), *(rod.state[:3, 0] for rod in inner))

        # Boundaries: free end, jaws, fixed end
        for left, right in zip(outer, inner, strict=True):
            opti.subject_to(left.state[3:, 0] == 0)
            opti.subject_to(left.state[:3, -1] == right.state[:3, 0])
            opti.subject_to(right.state[:3, -1] == ca.vertcat(0, h / 2, 0))

        # Friction cones: the jump of the rod's force and moment is what the jaws exert, T1, T2, N1, N2
        press = ca.dot(self.pressure, ca.vertcat(c, c**2))
        self.forces = ca.horzcat(
            *(
                _jaw_forces(left.state[3:, -1] - right.state[3:, 0], right.state[2, 0], press, h)
                for left, right in zip(outer, inner, strict=True)
            )
        )
        held = self.forces + self.correction
        opti.subject_to(ca.vec(held[:2, :]) <= ca.vec(self.friction * held[2:, :]))
        opti.subject_to(ca.vec(held[:2, :]) >= -ca.vec(self.friction * held[2:, :]))

        # Strain, steps within reach, the lower jaw above the bed, the whole flap above the line of sight
        for rod in (*outer, *inner):
            opti.subject_to(opti.bounded(-b, rod.strain.T, b))
        steps = self.poses[:, 1:] - self.poses[:, :-1]
        opti.subject_to(opti.bounded(-ca.DM(REACH), steps, ca.DM(REACH)))
        opti.subject_to(ca.vertcat(*(rod.lower[1, 0] for rod in inner)) >= 0)
        for points in (outer[-1].lower, outer[-1].upper[:, 0], inner[-1].lower):
            opti.subject_to(self._clearance(points) >= CLEAR + self.goal)
        if self.tool is not None:
            closer = ca.DM([[0.0] * 16, [0.5] * 8 + [-0.5] * 8]) * c * h
            x, y, theta = ca.vertsplit(inner[-1].state[:3, 0])
            turn = ca.blockcat([[ca.cos(theta), -ca.sin(theta)], [ca.sin(theta), ca.cos(theta)]])
            corners = turn @ (self.tool + closer) + ca.repmat(ca.vertcat(x, y), 1, 16)
            opti.subject_to(self._clearance(corners) >= CLEAR + self.goal)
        opti.subject_to(opti.bounded(GRIPS[0], c, GRIPS[1]))
        opti.subject_to(b >= 1e-3)

        # Objective
        self.worst = (ca.dot(self.squeeze, ca.vertcat(c, c**2)) ** NORM + b**NORM) ** (1 / NORM)
        opti.minimize(self.worst + SMOOTH * ca.sumsqr(steps[:, 1:] - steps[:, :-1]))
        opti.solver("ipopt", {"expand": True, "print_time": False, "detect_simple_bounds": True}, IPOPT)

    def _clearance(self, points: Any) -> Any:
        """Distance of points (2, n) to the line of sight, as `objectives.clearance`."""
        along = (self.camera - self.target) / ca.norm_2(self.camera - self.target)
        return ((points[0, :] - self.target[0]) * along[1] - (points[1, :] - self.target[1]) * along[0]).T


def _jaw_forces(load: Any, theta: Any, press: Any, height: Any) -> Any:
    """(4, 1) tangential forces of the lower and the upper jaw, and normal ones.

    load: (3,) force and moment on the rod. The moment is a couple of tangential forces at the two surfaces.
    """
    cos, sin = ca.cos(theta), ca.sin(theta)
    drag, lift = cos * load[0] + sin * load[1], cos * load[1] - sin * load[0]
    couple = load[2] / height
    return ca.vertcat(drag / 2 + couple, drag / 2 - couple, press + lift / 2, press - lift / 2)


@cache
def _program(in_sight: bool) -> Program:
    return Program(in_sight)


_one_at_a_time = threading.Lock()
"""All scenes share a program, and MUMPS has but one state."""


@dataclass(frozen=True)
class Optimum:
    """What the program found."""

    compression: float
    """m"""
    poses: Array
    """(POSES + 1, 3) x, y in m, theta; first the grasp at rest"""
    forces: Array
    """(4, POSES) N, of the jaws on the rod: tangential, lower and upper jaw, and normal"""
    strain: float
    """eps_max, by the rod and the grip"""
    iterations: int
    values: Any
    """of all variables, for the next start"""


def solve(
    scene: Scene, grasp: Grasp, grip: Grip, correction: Array | None = None, start: Optimum | None = None
) -> Optimum:
    """The optimum at one grasp, its compression aside. Raises Unsolved.

    correction: (4, POSES) N, what the jaws' forces are more than the rod's; start: an earlier optimum, whose
    neighbourhood is not to be left, instead of the CTC arcs.
    """
    tissue, line = scene.tissue, scene.line_of_sight
    length, height, depth = tissue.length, tissue.height, tissue.depth
    unit = force_unit(scene)
    with _one_at_a_time:
        program = _program(scene.jaws.in_sight)
        opti = program.opti
        given = {
            program.height: height / length,
            program.weight: tissue.density * scene.gravity * height * depth * length / unit,
            program.bed: scene.bed * BED * tissue.modulus / height * depth * length**2 / unit,
            program.camera: np.array(line.camera) / length,
            program.target: np.array(line.target) / length,
            program.grasp: grasp.x / length,
            program.pressure: np.array(grip.normal) / unit,
            program.squeeze: np.array(grip.strain),
            program.friction: RESERVE * scene.limits.friction,
            program.goal: scene.limits.clearance / length,
            program.correction: 0 if correction is None else correction / unit,
        }
        if program.tool is not None:  # of open jaws about the origin
            at_rest = to_jaws(np.array([0.0, 0.0, 0.0, height]))
            given[program.tool] = tool_outline(scene, at_rest).T / length
        ends = ((-length, grasp.x), (grasp.x, 0.0))
        for (step, sections), (left, right) in zip(program.sections, ends, strict=True):
            part = elements(tissue, left, right, ELEMENTS)
            given |= {step: part.length / length, sections: scaled(part, length, unit)}
        for parameter, value in given.items():
            opti.set_value(parameter, value)
        if start is None:
            _start_from_arcs(program, scene, grasp)
        else:
            opti.set_initial(start.values)
        try:
            found = opti.solve()
        except RuntimeError:
            raise Unsolved(opti.stats()["return_status"].replace("_", " ").lower()) from None
        return Optimum(
            compression=float(found.value(program.compression)) * height,
            poses=found.value(program.poses).T * [length, length, 1.0],
            forces=found.value(program.forces) * unit,
            strain=float(found.value(program.worst)),
            iterations=opti.stats()["iter_count"],
            values=found.value_variables(),
        )


def force_unit(scene: Scene) -> float:
    """N, E I / l^2 of the tissue without its veins."""
    tissue = scene.tissue
    return tissue.modulus * tissue.height**3 * tissue.depth / 12 / tissue.length**2


def scaled(part: Elements, length: float, unit: float) -> Array:
    """(8, n) the compliances of a rod's elements, lengths in `length` m and forces in `unit` N."""
    moment = unit * length
    rows = [part.stretch * unit, part.couple * moment, part.bend * moment * length, part.shear * unit]
    return np.stack([*rows, *(part.bottom * [unit, moment]).T, *(part.top * [unit, moment]).T])


def _start_from_arcs(program: Program, scene: Scene, grasp: Grasp) -> None:
    """Initial guess: CTC up to R_g, the free part straight. Sec. IV-D."""
    opti, length, height, arc = program.opti, scene.tissue.length, scene.tissue.height, -grasp.x
    turns = paths.goal_turn(scene, arc) * np.arange(1, POSES + 1) / POSES
    part = np.linspace(1, 0, ELEMENTS + 1)
    for turn, outer, inner in zip(turns, *program.rods, strict=True):
        bent = np.array([paths.ctc_motion(turn * p, arc * p, height) for p in part]).T
        free = bent[:, :1] - np.outer([np.cos(turn), -np.sin(turn), 0], part * (length - arc))
        for rod, shape, moment in ((inner, bent, turn / arc * length), (outer, free, 0.0)):
            guess = np.zeros((6, ELEMENTS + 1))
            guess[:3], guess[5] = shape / [[length], [length], [1.0]], moment
            opti.set_initial(rod.state, guess)
    opti.set_initial(program.compression, grasp.compression / height / 2)
    opti.set_initial(program.strain, 0.15)


def jaw_path(scene: Scene, optimum: Optimum) -> JawPath:
    """Squeeze, a smooth path through the poses, and on past the last one: "elastica"."""
    height = scene.tissue.height
    through = CubicSpline(np.arange(POSES + 1), optimum.poses)
    motion = through(np.arange(1, POSES * INCREMENTS + 1) / INCREMENTS)
    past = motion[-1] + np.outer(np.arange(1, OVERRUN + 1), motion[-1] - motion[-2])
    poses = np.empty((2 + len(motion) + OVERRUN, 4))
    poses[:2, :3] = optimum.poses[0]
    poses[2:, :3] = np.concatenate([motion, past])
    poses[:, 3] = height - optimum.compression
    poses[0, 3] = height
    return JawPath.from_poses(poses, KIND)
