"""Grip and path of least strain, found on the finite elements with their derivatives: "fem_gradient".

`Program` writes the optimisation at one place of the grasp down: unknown are how far the flap is turned, how
it is drawn out, by how much the jaws turn with it and by how much they are closed, the last three along the
path; the greatest eps_1% of the poses is to fall, while both jaws stay in their friction cones and the last
pose exposes the target. Everything is linearised about the equilibria of the poses (`sensitivity`), but for
the two maxima that strain is made of: over the poses, and over what the worst 1 % of the volume might
be. Cutting planes and HiGHS find the best step within a trust region, and it is taken back unless the finite
elements agree (Fletcher's method for composite functions). Where eps_1% has kinks, as on a coarse mesh,
quasi-Newton methods such as SLSQP stall.

It begins with the plans that are best on the rod (`planners.swift`), one from each place where that search
begins, and keeps the places of their grasps. They matter little: whoever may choose grip and path loses two
per cent by grasping a tenth of the flap aside.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planners import paths
from planners.base import Contestant, Plan, Proposals
from planners.effort import TooCostly, check
from planners.fem_gradient.sensitivity import LinearStrain, Response, Sensitivity
from planners.linear import minimised
from planners.search import OnUpdate, race
from planners.side_by_side import Stop, side_by_side
from planners.swift import program as rods
from planners.swift.planner import Search
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.objectives import WORST_FRACTION, worst_mean
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Scene, Uncertainty
from retract_env.threads import cores

Array = NDArray[np.float64]

KIND = "fem_gradient"
TIMES = np.array([0, 1, 2, 4, 7, 10, 14, 18, 21, 24]) / 24
"""Poses looked at, as parts of the way from squeezed to exposed: denser at first, when the flap leaves its
bed."""
OVERRUN = 1.25
"""Where the path ends, on the same scale: past exposure, in case the target comes into view late."""

TURN, STRETCH, PART, GRIP = 0, slice(1, 4), slice(4, 7), slice(7, 11)
"""Unknowns (11,): turn of the flap at the end, rad, and the coefficients, of Bernstein's polynomials in time,
of the stretch, which begins at none, of the part of the turn by which the jaws turn, and of the compression
over the height."""
UNITS = np.array([0.1, *[0.01] * 3, *[0.1] * 3, *[0.01] * 4])
"""Changes of the unknowns that matter about alike."""
LOW = np.array([0.1, *[-0.1] * 3, *[0.0] * 3, *[0.005] * 4])
HIGH = np.array([paths.MOST_TURN, *[0.3] * 3, *[1.5] * 3, *[0.45] * 4])
ROUGHNESS = np.zeros((7, 11))
"""Differences that vanish for an even path, as rows over the unknowns: second ones of the stretch, first ones
of the jaws' part of the turn and of the compression."""
ROUGHNESS[[0, 0, 1, 1, 1], [1, 2, 1, 2, 3]] = -2, 1, 1, -2, 1
for _row, _first in enumerate((4, 5, 7, 8, 9), start=2):
    ROUGHNESS[_row, [_first, _first + 1]] = -1, 1

STRAIN = 0.05
"""Strain that counts as 1 in what is minimised."""
SMOOTH = 2e-3
"""What one unit of roughness counts there."""
PENALTY = 10.0
"""What one unit of a violated constraint counts there."""
CLEAR = 1e-3
"""Clearance asked for at the end, over the flap's length."""
CLEARANCE = 0.1
"""Clearance over the length that counts as a violation of 1."""
RESERVE, ENOUGH = 0.93, 0.95
"""Part of the friction limit that the program uses, and that the certified path may need: between poses it
needs a little more."""
KEPT = 8
"""The points strained most are kept, up to this many times the volume that eps_1% is the mean of."""
IN_QUESTION = 0.6
"""Poses strained less than this part of the greatest cannot become the worst in one step."""
LOWEST = 40
"""Nodes whose clearance is looked at, those that have least of it."""
GAIN = 4e-3
"""The search ends once the linear program promises to gain less than this."""
STEPS = 8
"""Steps of the search, at most."""
RADIUS, SMALLEST_RADIUS = 2.0, 0.02
"""Size of the trust region at first, and below which the search ends; in UNITS."""
CUTS, GAP = 40, 5e-4
"""Rounds of cutting planes, at most, and how far from the best step they may end."""
HOLDS = 0.02
"""A path counts as one that holds up to this violation, as a part of the greatest jaw force."""
SEARCHED_ON = "coarse"
POLISHED = 1
"""Best places of the coarse mesh that are improved further on the mesh that certifies; a second one costs as
much again and gains less than 1 %."""
BY_THE_ROD = rods.STRETCH, rods.PART, rods.GRIP
"""The unknowns of `planners.swift` that STRETCH, PART and GRIP are."""
CORRECTIONS = 2
"""How often a path that needs too much friction is improved again, each time allowed less of it."""


def motion(scene: Scene, x: float, unknowns: Array, times: Array) -> Array:
    """Poses (n, 4) at times (n,), 0 squeezed, 1 exposed, for a grasp at x, m, and unknowns (11,).

    The jaws' midpoint is drawn away from the fixed end's middle by the stretch, from where it is on the CTC
    path. Past time 1 the flap is turned on, and all else stays.
    """
    height = scene.tissue.height
    t = np.minimum(times, 1.0)
    square = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=-1)
    cubic = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=-1)
    turn, fixed = unknowns[TURN] * times, np.array([0.0, height / 2])
    arm = paths.ctc_motion(turn, -x, height)[:, :2] - fixed
    middle = fixed + (1 + cubic[:, 1:] @ unknowns[STRETCH])[:, None] * arm
    compression = cubic @ unknowns[GRIP]
    return np.column_stack([middle, -(square @ unknowns[PART]) * turn, height * (1 - compression)])


def motion_slope(scene: Scene, x: float, unknowns: Array, times: Array) -> Array:
    """(n, 4, 11): derivatives of `motion` by unknowns over UNITS, by central differences."""
    h = 1e-4
    steps = h * np.diag(UNITS)
    sides = [[motion(scene, x, unknowns + s * step, times) for step in steps] for s in (1, -1)]
    return np.moveaxis((np.array(sides[0]) - np.array(sides[1])) / (2 * h), 0, -1)


def jaw_path(scene: Scene, x: float, unknowns: Array) -> tuple[Grasp, JawPath]:
    """Grasp and path, of as many increments as the paper's."""
    poses = motion(scene, x, unknowns, np.arange(round(OVERRUN * paths.INCREMENTS) + 1) / paths.INCREMENTS)
    height = scene.tissue.height
    rest = np.array([[x, height / 2, 0.0, height]])
    return Grasp(x, height - poses[0, 3]), JawPath.from_poses(np.concatenate([rest, poses]), KIND)


@dataclass(frozen=True)
class Standing:
    """What the poses of one path amount to."""

    strain: Array
    """(n,) eps_1% over STRAIN"""
    slack: Array
    """(m,) of the constraints, at least 0 where they hold"""

    @property
    def violation(self) -> float:
        """By how much the constraint that is broken most is broken; 0 where all hold."""
        return max(0.0, -float(self.slack.min()))


class Program:
    """Least strain at one place of the grasp, on one mesh."""

    def __init__(
        self,
        scene: Scene,
        x: float,
        unknowns: Array,
        resolution: str,
        on_increment: Callable[[], None] = lambda: None,
    ):
        """unknowns: (11,) to begin with, whose path is followed once; on_increment: called before each pose
        that is solved, here and later; what it raises ends the work. Raises Diverged, MeshError, TooCostly.
        """
        self.scene, self.x, self.unknowns = scene, x, np.clip(unknowns, LOW, HIGH)
        self.friction = RESERVE * scene.limits.friction
        physics = FemPhysics(scene, x, resolution)
        self.sensitivity = Sensitivity(physics)

        def before_pose() -> None:
            on_increment()
            check(physics.equilibrium.counts["iterations"] + self.sensitivity.iterations)

        self._before_pose = before_pose
        poses = motion(scene, x, self.unknowns, TIMES)
        open_jaws = np.array([x, scene.tissue.height / 2, 0.0, scene.tissue.height])
        physics.reset()
        physics.move_to((open_jaws + poses[0]) / 2)
        self.responses: list[Response] = []
        for pose, at in zip(poses, TIMES.tolist(), strict=True):
            before_pose()
            physics.move_to(pose, 1.0 + at)
            self.responses.append(self.sensitivity.settled(pose, physics.displacements))
            if at == 0.0:
                physics.turn()
        self._force = max(float(r.forces[:, 1].max()) for r in self.responses)
        self.evaluations = 1

    @property
    def max_strain(self) -> float:
        """Greatest eps_1% of the poses."""
        return STRAIN * float(self.standing(self.responses).strain.max())

    def standing(self, responses: Sequence[Response]) -> Standing:
        """Strain and constraints of a path, of the responses (t) of its increments."""
        volumes = self.sensitivity.volumes
        strain = np.array([worst_mean(r.strains, volumes) for r in responses]) / STRAIN
        cones = np.concatenate([(self._cones @ r.forces[..., None]).ravel() for r in responses])
        return Standing(strain, np.append(cones, self._above(responses[-1].clearances.min())))

    @property
    def _cones(self) -> Array:
        """(2, 2): times force along and pressing, what either edge of the friction cone leaves."""
        return np.array([[-1.0, self.friction], [1.0, self.friction]]) / self._force

    def _above(self, clearances: Array) -> Array:
        above = clearances - self.scene.limits.clearance
        return (above / self.scene.tissue.length - CLEAR) / CLEARANCE

    def solve(self) -> None:
        """Improve the unknowns, step by step, until no step promises to gain more. Raises Diverged, where no
        step can be computed, and TooCostly."""
        radius = RADIUS
        for _ in range(STEPS):
            step, promised = self._step(radius)
            now = self._merit(self.unknowns, self.responses)
            if now - promised < GAIN or radius < SMALLEST_RADIUS:
                return
            trial = np.clip(self.unknowns + UNITS * step, LOW, HIGH)
            poses = motion(self.scene, self.x, trial, TIMES)
            self.evaluations += 1
            responses = []
            try:
                for pose, response in zip(poses, self.responses, strict=True):
                    self._before_pose()
                    responses.append(self.sensitivity.at(pose, response))
            except Diverged:
                radius /= 4
                continue
            agreement = (now - self._merit(trial, responses)) / (now - promised)
            if agreement > 0.1:
                self.unknowns, self.responses = trial, responses
            if agreement > 0.75:
                radius *= 2
            elif agreement < 0.25:
                radius /= 3

    def _merit(self, unknowns: Array, responses: Sequence[Response]) -> float:
        standing = self.standing(responses)
        rough = float(np.abs(ROUGHNESS @ (unknowns / UNITS)).sum())
        return float(standing.strain.max()) + PENALTY * standing.violation + SMOOTH * rough

    def _step(self, radius: float) -> tuple[Array, float]:
        """Best step (11,), in UNITS, of at most `radius`, and the merit that it promises.

        eps_1% is the greatest of many weighted means of strain. Of each pose, the linear program knows those
        that were greatest where its earlier answers led, until no other is greater by more than GAP. Its
        columns: step, greatest strain, greatest violation, roughness.
        """
        slopes = motion_slope(self.scene, self.x, self.unknowns, TIMES)
        poses = self._strained(slopes)
        slack, slack_slope = self._constraints(slopes)
        rough, lines = ROUGHNESS @ (self.unknowns / UNITS), len(ROUGHNESS)
        nothing = np.zeros((len(slack), lines))
        constraints = np.hstack([-slack_slope, np.zeros((len(slack), 1)), -np.ones((len(slack), 1)), nothing])
        smoothness = [np.hstack([s * ROUGHNESS, np.zeros((lines, 2)), -np.eye(lines)]) for s in (1, -1)]
        rows, bounds = [constraints, *smoothness], [slack, -rough, rough]
        cost = np.array([*[0.0] * 11, 1.0, PENALTY, *[SMOOTH] * lines])
        low, high = np.zeros(len(cost)), np.full(len(cost), np.inf)
        low[:11] = np.maximum(-radius, (LOW - self.unknowns) / UNITS)
        high[:11] = np.minimum(radius, (HIGH - self.unknowns) / UNITS)
        best, best_step, at = math.inf, np.zeros(11), np.zeros(len(cost))
        for _ in range(CUTS):
            means = [pose.worst(at[:11]) for pose in poses]
            greatest = max(value for value, _, _ in means)
            promised = greatest + float(cost[12:] @ at[12:])
            if at[11] > 0 and promised < best:
                best, best_step = promised, at[:11]
            if greatest <= at[11] + GAP:
                break
            rows.append(np.array([[*slope, -1.0, *[0.0] * (lines + 1)] for _, _, slope in means]))
            bounds.append(np.array([-constant for _, constant, _ in means]))
            result = minimised(cost, rows, bounds, low, high)
            if result.x is None:
                raise Diverged(f"HiGHS on a linear program that has a solution: {result.message}")
            at = result.x
        return best_step, best

    def _strained(self, slopes: Array) -> list[LinearStrain]:
        """Linear models of the poses in question."""
        volumes = self.sensitivity.volumes
        counted = WORST_FRACTION * float(volumes.sum())
        greatest = self.standing(self.responses).strain
        out = []
        for k in np.flatnonzero(greatest >= IN_QUESTION * greatest.max()):
            response = self.responses[k]
            order = np.argsort(response.strains)[::-1]
            kept = order[: int(np.searchsorted(np.cumsum(volumes[order]), KEPT * counted)) + 1]
            slope = response.strains_slope[kept] @ slopes[k] / STRAIN
            out.append(LinearStrain(response.strains[kept] / STRAIN, slope, volumes[kept] / counted))
        return out

    def _constraints(self, slopes: Array) -> tuple[Array, Array]:
        """Slack (m,) and its derivatives (m, 11): friction cones of all poses, lowest nodes of the last."""
        slack, slope = [], []
        for response, by_unknown in zip(self.responses, slopes, strict=True):
            slack.append((self._cones @ response.forces[..., None]).ravel())
            slope.append((self._cones @ response.forces_slope).reshape(-1, 4) @ by_unknown)
        last = self.responses[-1]
        low = np.argsort(last.clearances)[:LOWEST]
        slack.append(self._above(last.clearances[low]))
        slope.append(last.clearances_slope[low] @ slopes[-1] / (self.scene.tissue.length * CLEARANCE))
        return np.concatenate(slack), np.concatenate(slope)


class Polished(Contestant):
    """Hands in a path that is improved on the mesh of the judge, and again where the judge saw it need too
    much friction."""

    def __init__(self, scene: Scene, x: float, unknowns: Array, resolution: str):
        """unknowns: (11,) to begin with."""
        super().__init__(*jaw_path(scene, x, unknowns))
        self.scene, self.begin, self.resolution = scene, unknowns, resolution

    def propose(self, on_increment: Callable[[], None]) -> Proposals:
        """Improve the path; where it needs too much friction, again with as much less to use."""
        program = Program(self.scene, self.grasp.x, self.begin, self.resolution, on_increment)
        program.solve()
        verdict = yield jaw_path(self.scene, program.x, program.unknowns)
        allowed = ENOUGH * self.scene.limits.friction
        for _ in range(CORRECTIONS):
            if verdict.reason not in ("ok", "slip") or verdict.required_friction <= allowed:
                return None
            program.friction *= min(0.99, max(0.9, allowed / verdict.required_friction))
            program.solve()
            verdict = yield jaw_path(self.scene, program.x, program.unknowns)
        return None


def plan_fem_gradient(
    scene: Scene,
    *,
    resolution: str,
    workers: int | None,
    on_update: OnUpdate | None,
) -> Plan:
    """Search on the rod, improve what that finds on the coarse mesh, the best of it on the one asked for,
    certify.

    What the rod finds is a contestant beside. Raises NoPlan.
    """
    start = time.perf_counter()
    ranked = Search(scene.model_copy(update={"uncertainty": Uncertainty.none()})).ranked()
    starts = [begun(scene, plan.unknowns) for plan in ranked]
    workers = cores() if workers is None else workers
    stop = Stop()
    programs = side_by_side(partial(_searched, scene, stop), starts, workers, stop)
    solved = sorted(
        (p for p in programs if p is not None),
        key=lambda p: (p.standing(p.responses).violation > HOLDS, p.max_strain, p.x),
    )[:POLISHED]
    found = time.perf_counter()
    contestants: list[Contestant] = [Polished(scene, p.x, p.unknowns, resolution) for p in solved]
    contestants.append(Contestant(*jaw_path(scene, *starts[0])))
    plan = race(scene, contestants, KIND, resolution, workers, on_update)
    timings = {**plan.timings, "search": found - start, "total": time.perf_counter() - start}
    return replace(plan, timings=timings)


def _searched(scene: Scene, on_increment: Callable[[], None], start: tuple[float, Array]) -> Program | None:
    """The program solved on the coarse mesh, from a place, m, and unknowns (11,); None where that fails."""
    try:
        program = Program(scene, *start, SEARCHED_ON, on_increment)
        program.solve()
    except (Diverged, MeshError, TooCostly):
        return None
    return program


def begun(scene: Scene, unknowns: Array) -> tuple[float, Array]:
    """Place of the grasp, m, and unknowns (11,) of a plan by `planners.swift`, unknowns (14,)."""
    own = np.concatenate([[unknowns[rods.TURN]], *(unknowns[s] for s in BY_THE_ROD)])
    return float(unknowns[rods.PLACE]) * scene.tissue.length, own
