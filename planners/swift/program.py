"""Least strain that holds whatever the flap turns out to be, found on the rod with its derivatives.

Unknown are the place of the grasp, how far the flap is turned, how it is drawn out, by how much the jaws turn
with it and by how much they are closed, the last three along the path. The greatest eps_1% of the scene's own
flap is to fall, while on every flap of a set both jaws stay in their friction cones and the target comes into
view. All is linearised about the poses' equilibria, whose derivatives are differences: the flap between jaws
with one unknown changed is one more lane beside it. A linear program gives the best step within a trust
region, and it is taken back unless the rod agrees (Fletcher's method for composite functions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners import paths
from planners.correction import Correction
from planners.linear import minimised
from planners.whatif import Flaps
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import jaw_range
from retract_env.rod.follow import CLEAR, DRAG, NORMAL, STRAIN, TOUCHES
from retract_env.scene import Scene
from retract_env.spring import pressing

Array = NDArray[np.float64]

TIMES = np.array([0, 0.5, 1, 2, 3, 4.5, 6, 8, 10, 12.5, 15, 18, 21, 24, 27, 30]) / 24
"""Poses looked at, as parts of the way from squeezed to exposed: denser at first, when the flap leaves its
bed. Past 1 the motion goes on, for flaps whose target comes into view late."""
END = int(np.flatnonzero(TIMES == 1)[0])

PLACE, TURN, STRETCH, PART, GRIP, BEYOND = 0, 1, slice(2, 5), slice(5, 8), slice(8, 12), slice(12, 14)
"""Unknowns (14,): place of the grasp over the length, turn of the flap at the end, rad, and the coefficients,
of Bernstein's polynomials in time, of the stretch, which begins at none, of the part of the turn by which the
jaws turn, and of the compression over the height; then, past time 1, by how much a unit of time turns the
flap further, over the turn at the end, and draws it out."""
COUNT = 14
UNITS = np.array([0.03, 0.1, *[0.01] * 3, *[0.1] * 3, *[0.01] * 4, 0.2, 0.04])
"""Changes of the unknowns that matter about alike."""
LOW = np.array([-1.0, 0.1, *[-0.1] * 3, *[0.0] * 3, *[0.005] * 4, 0.0, -0.2])
HIGH = np.array([0.0, paths.MOST_TURN, *[0.3] * 3, *[1.5] * 3, *[0.45] * 4, 3.0, 0.8])
ROUGHNESS, EVEN = np.zeros((9, COUNT)), np.zeros(9)
"""Rows over the unknowns, in UNITS, and what they are for an even path: second differences of the stretch,
first ones of the jaws' part of the turn and of the compression, and the motion going on as before."""
ROUGHNESS[[0, 0, 1, 1, 1], [2, 3, 2, 3, 4]] = -2, 1, 1, -2, 1
for _row, _first in enumerate((5, 6, 8, 9, 10), start=2):
    ROUGHNESS[_row, [_first, _first + 1]] = -1, 1
ROUGHNESS[[7, 8], [12, 13]] = 1
EVEN[7] = 1.0 / UNITS[BEYOND.start]

DIFFERENCE = 1e-4
"""Of UNITS, for derivatives."""
UNIT = 0.05
"""Strain that counts as 1 in what is minimised."""
SMOOTH = 2e-3
"""What one unit of roughness counts there."""
PENALTY = 20.0
"""What one unit of a violated constraint counts there."""
CLEARANCE = 0.05
"""Clearance over the length that counts as a violation of 1."""
HOLDING = 0.01
"""Likewise, E h d, what jaws drag beyond what their friction holds, over the friction that there is."""
GAIN = 4e-3
"""The search ends once the linear program promises to gain less than this."""
TRIED = ((0, 1.0), (0, 0.5), (0, 0.25), (1, 1.0), (1, 0.5), (1, 0.2))
"""What is tried of the best steps within the trust region and within a quarter of it: parts of them."""
GROWS = (2.0, 1.0, 0.5, 0.5, 0.25, 0.1)
"""Trust region after each of these was best, over that before."""
RADIUS, SMALLEST_RADIUS = 2.0, 0.02
"""Size of the trust region at first, and below which the search ends; in UNITS."""


def motion(scene: Scene, unknowns: Array, times: Array = TIMES) -> Array:
    """Poses (..., n, 4) x, y, theta, separation at times (n,), 0 squeezed, 1 exposed; unknowns (..., COUNT).

    The jaws' midpoint is drawn away from the fixed end's middle by the stretch, from where it is on the CTC
    path. Past time 1 it is drawn out and turned on.
    """
    height, u = scene.tissue.height, np.asarray(unknowns, float)
    t, past = np.minimum(times, 1.0), np.maximum(times - 1.0, 0.0)
    square = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2])
    cubic = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    turn = u[..., TURN, None] * (t + u[..., BEYOND.start, None] * past)
    arc = -u[..., PLACE, None] * scene.tissue.length
    rise = arc * turn / 2 * np.sinc(turn / (2 * np.pi)) ** 2
    factor = 1 + u[..., STRETCH] @ cubic[1:] + u[..., BEYOND.stop - 1, None] * past
    return np.stack(
        [
            -arc * np.sinc(turn / np.pi) * factor,
            height / 2 + rise * factor,
            -(u[..., PART] @ square) * turn,
            height * (1 - u[..., GRIP] @ cubic),
        ],
        axis=-1,
    )


def force_of(scene: Scene, unknowns: Array) -> Array:
    """(...,) N, of grips by force: that with which a squeeze by the first coefficient of the compression
    presses."""
    return np.asarray(unknowns[..., GRIP.start] * pressing(scene))


def jaw_path(scene: Scene, unknowns: Array, kind: str, by_force: bool) -> tuple[Grasp, JawPath]:
    """Grasp and path, of as many increments as the paper's."""
    steps = round(TIMES[-1] * paths.INCREMENTS)
    poses = motion(scene, unknowns, np.arange(steps + 1) / paths.INCREMENTS)
    height, x = scene.tissue.height, float(unknowns[PLACE]) * scene.tissue.length
    rest = np.array([[x, height / 2, 0.0, height]])
    path = JawPath.from_poses(np.concatenate([rest, poses]), kind)
    if by_force:
        return Grasp(x, force=float(force_of(scene, unknowns))), path
    return Grasp(x, height - poses[0, 3]), path


@dataclass(frozen=True)
class Standing:
    """What the poses of a path amount to on each of k flaps."""

    strain: Array
    """(k, t) eps_1%"""
    slip: Array
    """(k, t, 2) of both jaws, what they drag beyond what their friction holds, over HOLDING and the friction
    that there is; negative where they hold"""
    clearance: Array
    """(k, t) over the length"""
    shown: Array
    """(k,) the pose at which the target is in view, or the last"""
    sound: NDArray[np.bool_]
    """(k,) whether all poses were reached without touching anything"""


class Program:
    """Least strain over a set of flaps, of which the first is the scene's own."""

    def __init__(
        self,
        scene: Scene,
        flaps: Flaps,
        reserve: float,
        clear: float,
        correction: Correction,
        own: bool = True,
        by_force: bool = False,
    ):
        """reserve: friction that is left over on each flap; clear: clearance asked for at the
        end, over the length; own: whether the first flap is the scene's own, whose target has to come into
        view at time 1; by_force: whether the jaws press with a force, whatever that takes."""
        self.by_force = by_force
        self.last = np.full(len(flaps), len(TIMES) - 1)
        if own:
            self.last[0] = END
        self.scene, self.flaps, self.reserve, self.clear = scene, flaps, reserve, clear
        self.correction = correction
        least, greatest = jaw_range(scene.tissue.length, scene.jaws.width)
        self.low, self.high = LOW.copy(), HIGH.copy()
        if by_force:  # one number tells the force
            self.low[GRIP.start + 1 : GRIP.stop] = self.high[GRIP.start + 1 : GRIP.stop] = 0.1
        self.low[PLACE], self.high[PLACE] = least / scene.tissue.length, greatest / scene.tissue.length
        self.rough = ROUGHNESS.copy()
        if by_force:
            self.rough[:, GRIP] = 0.0

    def standing(self, unknowns: Array) -> tuple[Standing, ...]:
        """Of each of m paths, unknowns (m, COUNT)."""
        flaps = self.flaps
        m, k, length = len(unknowns), len(flaps), self.scene.tissue.length
        poses = motion(self.scene, unknowns)
        force = force_of(self.scene, unknowns) if self.by_force else None
        done = flaps.follow(unknowns[:, PLACE] * length, poses, force=force)
        felt = self.correction.apply(done.felt.reshape(k, m, len(TIMES), -1))
        strain, clearance = felt[..., STRAIN], felt[..., CLEAR] / length
        normal, drag = felt[..., NORMAL], np.abs(felt[..., DRAG])
        holds = np.maximum(flaps.friction - self.reserve, 1e-3)[:, None, None, None]
        slip = (drag + (self.correction.friction[:, None] - holds) * normal) / (holds * HOLDING)
        in_view = clearance >= self.clear
        last = len(TIMES) - 1
        shown = np.where(in_view.any(-1), in_view.argmax(-1), last)
        touches = (felt[..., TOUCHES] > 0) & (np.arange(last + 1) <= shown[..., None])
        sound = ~(done.lost.reshape(k, m) | touches.any(-1))
        return tuple(
            Standing(strain[:, j], slip[:, j], clearance[:, j], shown[:, j], sound[:, j]) for j in range(m)
        )

    def excess(self, s: Standing) -> Array:
        """(k,) by how much each flap's nearest limit is exceeded, negative where all holds; inf where the
        flap was lost."""
        t = np.arange(len(TIMES))
        under_way = t <= self._end(s)[:, None]
        slips = np.where(under_way[..., None], s.slip, -1.0).max((-2, -1))
        strained = np.where(under_way, s.strain, 0.0).max(-1) / self.scene.limits.strain - 1
        hidden = (self.clear - s.clearance[np.arange(len(self.last)), self.last]) / CLEARANCE
        worst = np.maximum(np.maximum(slips, strained), hidden)
        return np.where(s.sound & np.isfinite(worst), worst, np.inf)

    def _end(self, s: Standing) -> Array:
        """(k,) the pose up to which each flap's limits count."""
        return np.where(self.last == len(TIMES) - 1, s.shown, self.last)

    def strain(self, s: Standing) -> float:
        """Greatest eps_1% of the scene's own flap, whose target is to be in view at time 1."""
        return float(s.strain[0, : END + 1].max())

    def merit(self, unknowns: Array, s: Standing) -> float:
        """What the search makes less: strain, penalties for broken limits and for uneven moves; inf where a
        flap was lost."""
        rough = float(np.abs(self.rough @ (unknowns / UNITS) - EVEN).sum())
        worst = max(0.0, float(self.excess(s).max()))
        merit = self.strain(s) / UNIT + PENALTY * worst + SMOOTH * rough
        return merit if np.isfinite(merit) else np.inf

    def solve(self, unknowns: Array, steps: int, radius: float = RADIUS) -> Array:
        """Improve unknowns (COUNT,), step by step, until no step promises to gain more."""
        at = np.clip(unknowns, self.low, self.high)
        standings = self._around(at)
        now = self.merit(at, standings[0])
        for _ in range(steps):
            if not np.isfinite(now) or radius < SMALLEST_RADIUS:
                break
            solved = [self._step(at, standings, r) for r in (radius, radius / 4)]
            if now - solved[0][1] < GAIN:
                break
            steps_ = np.array([part * solved[k][0] for k, part in TRIED])
            trials = np.clip(at + UNITS * steps_, self.low, self.high)
            merits = [self.merit(u, s) for u, s in zip(trials, self.standing(trials), strict=True)]
            best = int(np.argmin(merits))
            if merits[best] < now:
                gained = now - merits[best]
                at, now = trials[best], merits[best]
                standings = self._around(at)
                radius *= GROWS[best]
                if gained < GAIN / 4:
                    break
            else:
                radius /= 10
        return at

    def _around(self, unknowns: Array) -> tuple[Standing, ...]:
        """At unknowns, and with each of them changed."""
        return self.standing(unknowns + DIFFERENCE * np.vstack([np.zeros(COUNT), np.diag(UNITS)]))

    def _step(self, unknowns: Array, standings: tuple[Standing, ...], radius: float) -> tuple[Array, float]:
        """Best step (COUNT,), in UNITS, of at most `radius`, and the merit that it promises.

        The linear program's columns: step, greatest strain, greatest violation, roughness.
        """
        at, *beside = standings

        def slope(name: str) -> Array:
            values = np.stack([getattr(s, name) for s in beside], axis=-1)
            found: Array = (values - getattr(at, name)[..., None]) / DIFFERENCE
            return found

        strain, slip, clearance = (slope(n) for n in ("strain", "slip", "clearance"))
        ends, limit = self._end(at), self.scene.limits.strain
        rows, bounds = [], []
        lines = len(ROUGHNESS)

        def add(gradient: Array, slack: Array, column: int) -> None:
            """gradient @ step - (greatest strain or violation) <= slack, but for what no step can reach"""
            reach = radius * np.abs(gradient).sum(-1)
            least = float(np.fmax.reduce(-slack - reach)) if column == COUNT else 0.0
            matters = reach - slack > least  # not so where a lane beside was lost: no slope is known
            gradient, slack = gradient[matters], slack[matters]
            block = np.zeros((len(slack), COUNT + 2 + lines))
            block[:, :COUNT], block[:, column] = gradient, -1.0
            rows.append(block)
            bounds.append(slack)

        for k in range(len(self.flaps)):
            if not at.sound[k]:
                continue
            n, end = int(ends[k]) + 1, int(self.last[k])
            add(slip[k, :n].reshape(-1, COUNT), -at.slip[k, :n].ravel(), COUNT + 1)
            add(strain[k, :n] / limit, 1 - at.strain[k, :n] / limit, COUNT + 1)
            add(
                -clearance[k, end : end + 1] / CLEARANCE,
                (at.clearance[k, end : end + 1] - self.clear) / CLEARANCE,
                COUNT + 1,
            )
            if k == 0:
                add(strain[k, :n] / UNIT, -at.strain[k, :n] / UNIT, COUNT)
        rough = self.rough @ (unknowns / UNITS) - EVEN
        for sign in (1.0, -1.0):
            block = np.hstack([sign * self.rough, np.zeros((lines, 2)), -np.eye(lines)])
            rows.append(block)
            bounds.append(-sign * rough)
        cost = np.array([*[0.0] * COUNT, 1.0, PENALTY, *[SMOOTH] * lines])
        low, high = np.zeros(len(cost)), np.full(len(cost), np.inf)
        low[:COUNT] = np.maximum(-radius, (self.low - unknowns) / UNITS)
        high[:COUNT] = np.minimum(radius, (self.high - unknowns) / UNITS)
        result = minimised(cost, rows, bounds, low, high)
        if result.x is None:
            return np.zeros(COUNT), np.inf
        return result.x[:COUNT], float(result.fun)
