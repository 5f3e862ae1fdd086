"""The dynamic physics: PyBullet's deformable world, a soft body of linear tetrahedra between two jaws.

Bullet integrates explicitly, and a flap's slowest swing takes a thousand of its steps. So moves run about a
hundred times faster than life (2 mm of the gripper in some 4 ms of Bullet's time), and two things keep the
flap near equilibrium:

* Each part of a move begins where linearised statics of the same tetrahedra puts the flap (prediction.py).
* Kinetic damping (Cundall): whenever the kinetic energy has passed a peak, all nodes are stopped.

What is left is the lag: up to 0.5 mm between the flap's tip at the end of a move and where it would come to
rest. Linear tetrahedra lock: the flap bends 15-30 % too stiffly and jaws feel two to three times the force.
Bullet's own law, a "stable" neo-Hookean one, agrees with the certifier's where strain is small and puts the
tip 0.1 mm elsewhere at a squeeze of a quarter. benchmarks/bullet.py measures all this. Bullet tells neither
strain nor the jaws' forces: both are computed from the nodes' positions.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged, FlapRefused
from retract_env.grasp import to_jaws, to_pose
from retract_env.physics.base import TissueState
from retract_env.physics.bullet.prediction import Prediction
from retract_env.physics.bullet.tetmesh import tet_mesh
from retract_env.physics.bullet.world import World, silence
from retract_env.physics.measures import TetrahedralFlap
from retract_env.physics.registry import PHYSICS
from retract_env.scene import Scene

Array = NDArray[np.float64]

STRIDE, TURN = 2e-3, float(np.radians(6.0))
"""m and rad: the farthest that the gripper goes in one stride, of `BulletResolution.steps` time steps. A
longer move is made in several strides."""
PARTS = 2
"""Parts of a stride, each of which begins with a prediction."""
LOOKS = 2
"""Times in each part of a stride, equally spaced, that the kinetic energy is looked at."""
COURANT = 0.7
"""Time step over the longest stable one; above sqrt(1/2) a stop adds energy to the fastest vibrations."""
QUARTER_SWING = 0.03
"""s of Bullet's time, a quarter of a hanging flap's slowest swing: at some moment in it the swing is
fastest."""
MOST_WORK = 25_000_000
"""Time steps times tetrahedra until a flap has to be at rest: some 20 s."""
NEAREST = 0.05
"""Heights; jaws that are to come nearer than this have met."""
SMALLEST_CUT = 1 / 64
"""Part of a move below which it is not cut any further."""
FORCE_TOLERANCE = 0.02
"""Jaws that hold by force press with it to this part, as measured when a move ends. The flap is not quite at
rest then, which is worth 1 %."""
MOST_PRESSES = 16
"""Short moves in search of one separation; two or three are the rule."""
FIRMER = 6.0
"""N/(E w d), with w the jaws' width and d the flap's depth, that one height of closing adds to the force, as
the search for a separation begins: these tetrahedra press back twice as hard as the flap would."""
LIFTED = 3e-4
"""m. The bed is taken away while all of the flap is higher than this, except next to the fixed end."""


@dataclass(frozen=True)
class BulletResolution:
    """Mesh and effort."""

    name: str
    along: float
    """length of a cube of five tetrahedra over the flap's height"""
    across: int
    """cubes over the height"""
    deep: int
    """cubes over the depth"""
    steps: int
    """Bullet's time steps in a stride, a multiple of PARTS * LOOKS"""


BULLET_RESOLUTIONS = {
    "coarse": BulletResolution("coarse", 0.57, 2, 1, 40),
    "medium": BulletResolution("medium", 0.38, 2, 2, 60),
    "fine": BulletResolution("fine", 0.32, 3, 2, 80),
}


class BulletPhysics:
    """One flap between two jaws, in a Bullet world of its own; not to be shared between threads.

    Raises Diverged where the motion runs away or an element is turned inside out; the state is then still the
    last good one, and the flap goes on from there.
    """

    resolutions: ClassVar[tuple[str, ...]] = tuple(BULLET_RESOLUTIONS)

    def __init__(
        self,
        scene: Scene,
        jaw_x: float,
        resolution: str | BulletResolution = "medium",
        stop_when: Callable[[TissueState], bool] | None = None,
        force: float | None = None,
    ):
        """jaw_x: m, where the jaws grasp; stop_when: called with the farthest state that is
        reached by a move which cannot be completed; the move ends there if it returns True; force: N, by
        which the jaws hold, to `FORCE_TOLERANCE`, None: by their separation.

        Raises ImportError, one line, without pybullet, FlapRefused for tissue without mass, and ValueError as
        `tet_mesh`.
        """
        if isinstance(resolution, str):
            if resolution not in BULLET_RESOLUTIONS:
                raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(BULLET_RESOLUTIONS)}")
            resolution = BULLET_RESOLUTIONS[resolution]
        self.scene, self.resolution, self.jaw_x, self.force = scene, resolution, jaw_x, force
        self._stop_when = stop_when
        tissue = scene.tissue
        if tissue.density == 0:
            raise FlapRefused("tissue.density = 0 kg/m^3, allowed in Bullet above 0 kg/m^3")
        self.mesh = mesh = tet_mesh(scene, jaw_x, resolution.along, resolution.across, resolution.deep)
        self.section = mesh.section
        self.flap = TetrahedralFlap(scene, mesh)
        # Bullet gives every node the same mass: this one keeps the moment of the weight about the fixed end.
        line = tissue.density * tissue.height * tissue.depth
        self.node_mass = line * tissue.length**2 / 2 / float(-mesh.points[:, 0].sum())
        self.load = np.zeros_like(mesh.points)
        self.load[:, 1] = -self.node_mass * scene.gravity
        self._predicted = Prediction(self.flap, self.load, scene.bed)
        self._far = mesh.points[:, 0] < -1.5 * tissue.height
        self._count = resolution.steps // (PARTS * LOOKS)
        self._world = World(_pybullet(), scene, mesh, jaw_x, self.node_mass)
        self._begin()

    def _begin(self) -> None:
        rest = to_pose(np.array([self.jaw_x, 0.0, self.jaw_x, self.scene.tissue.height]))
        self._good = self.mesh.points, rest, 0.0
        tissue = self.scene.tissue
        self._slope = -FIRMER * tissue.modulus * self.scene.jaws.width * tissue.depth / tissue.height
        self._restore()

    def _restore(self) -> None:
        """Take up the last good state, at a standstill."""
        points, pose, _ = self._good
        self._world.load()
        if points is not self.mesh.points:
            self._world.place(points)
        self._world.place_jaws(pose)
        self._points = points
        self._energy = self._step = 0.0
        self._frequency, self._mode = self.flap.frequency(points - self.mesh.points, self.node_mass, None, 30)

    def close(self) -> None:
        """Give the Bullet world back; may be called again."""
        self._world.close()

    def reset(self) -> TissueState:
        """Let the flap rest on its bed, the open jaws holding it where they touch. Raises Diverged."""
        self._begin()
        # on the bed only fast, tiny vibrations are left; a hanging flap swings slowly and far
        return self.settle(5e-3, calm=1e-3) if self.scene.bed else self.settle()

    def settle(self, speed: float = 1e-3, calm: float = QUARTER_SWING, longest: int = 20_000) -> TissueState:
        """Hold the jaws until no node has been faster than `speed`, m/s, for a time `calm`, s of Bullet's.

        longest: Bullet's time steps, fewer where there are many tetrahedra (`MOST_WORK`). Raises Diverged,
        also where the flap does not come to rest.
        """
        longest = min(longest, MOST_WORK // int(self.mesh.copies.sum()))
        _, pose, progress = self._good
        quiet = 0.0
        with self._keeping_the_last_good_state():
            for _ in range(0, longest, self._count):
                slow = self._run(speed) < speed
                quiet = quiet + self._count * self._step if slow else 0.0
                if quiet >= calm:
                    return self._accept(pose, progress)
            raise Diverged(f"the flap is not at rest after {longest} steps")

    def move_to(self, pose: Array, progress: float | None = None) -> TissueState:
        """Move the jaws straight to a pose (4,) x, y, theta, separation. Raises Diverged.

        progress: where this is on a path, for the state alone.
        """
        pose = np.asarray(pose, float)
        if pose.shape != (4,) or not np.isfinite(pose).all():
            raise ValueError(f"pose = {pose.tolist()}, allowed 4 finite numbers")
        _, start, before = self._good
        end = before if progress is None else progress
        # by which part jaws that hold by force press while they close
        self._part = 1.0 if progress is None else min(progress, 1.0)
        try:
            return self._reach(pose, end)
        except Diverged:
            if self._stop_when is None:
                raise
            good, part = self._good, 1.0
            while part > SMALLEST_CUT:
                part /= 2
                with contextlib.suppress(Diverged):
                    state = self._reach(start + part * (pose - start), before + part * (end - before))
                    if self._stop_when(state):
                        return state
                    break
            self._good = good
            self._restore()
            raise

    def _reach(self, pose: Array, progress: float) -> TissueState:
        """Move to a pose; jaws that hold by force find its separation: secants on the measured force."""
        if self.force is None:
            return self._move(pose, progress)
        good, level, slope = self._good, self.force * self._part, self._slope
        pose = np.append(pose[:3], good[1][3])
        try:
            state = self._move(pose, progress)
            pressed = _pressing(state)
            for _ in range(MOST_PRESSES):
                if abs(pressed - level) <= FORCE_TOLERANCE * level:
                    self._slope = slope
                    return state
                step = float(np.clip((level - pressed) / slope, -STRIDE / 4, STRIDE / 4))
                pose, was = np.append(pose[:3], pose[3] + step), pressed
                if pose[3] <= NEAREST * self.scene.tissue.height:
                    raise Diverged(f"the jaws meet before they press with {1e3 * level:.4g} mN")
                state = self._move(pose, progress)
                pressed = _pressing(state)
                # the flap's swing is in what is measured: no slope is believed that is far from the last
                slope = float(np.clip((pressed - was) / step, 2 * slope, slope / 2))
            raise Diverged(f"no separation at which the jaws press with {1e3 * level:.4g} mN")
        except Diverged:
            self._good = good
            self._restore()
            raise

    def _move(self, pose: Array, progress: float) -> TissueState:
        _, start, _ = self._good
        dx, dy, turn, squeeze = np.abs(pose - start)
        strides = max(np.hypot(dx, dy) / STRIDE, squeeze / STRIDE, turn / TURN)
        parts = int(np.ceil(PARTS * max(1.0, strides) - 1e-9))
        with self._keeping_the_last_good_state():
            for k in range(1, parts + 1):
                self._advance(start + k / parts * (pose - start))
                for _ in range(LOOKS):
                    self._run()
            return self._accept(pose, progress)

    def turn(self) -> None:
        """Say that the path has a corner here, which makes no difference to this physics."""

    def state(self) -> TissueState:
        """What there is to see and to feel now."""
        points, pose, progress = self._good
        u = points - self.mesh.points
        return self.flap.state(u, self.load, to_jaws(pose), progress)

    @property
    def nodes(self) -> Array:
        """(n, 3) m, where the mesh's nodes are now."""
        return self._good[0]

    @property
    def time_step(self) -> float:
        """s, of Bullet, since the last move."""
        return self._step

    def _accept(self, pose: Array, progress: float) -> TissueState:
        kept = self._good
        self._good = self._points, pose, progress
        try:
            return self.state()
        except Diverged:
            self._good = kept
            raise

    @contextlib.contextmanager
    def _keeping_the_last_good_state(self) -> Iterator[None]:
        try:
            yield
        except Diverged:
            self._restore()
            raise

    def _advance(self, pose: Array) -> None:
        """Put the jaws at a pose and the nodes, at a standstill, where statics predicts them."""
        self._points = self._predicted(self._points, self._held_at(pose))
        self._world.stop()
        self._world.place(self._points)
        self._world.place_jaws(pose)
        self._energy = 0.0

    def _held_at(self, pose: Array) -> Array:
        """Nodes (n, 3) m, those under the jaws as they are at a pose, all others where they are now."""
        moved, rest = self._points.copy(), self.mesh.points
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        turned = np.array([[cosine, sine], [-sine, cosine]])
        open_jaws = np.array([[self.jaw_x, 0.0], [self.jaw_x, self.scene.tissue.height]])
        for nodes, jaw, before in zip(self.mesh.patches, to_jaws(pose).reshape(2, 2), open_jaws, strict=True):
            moved[nodes, :2] = jaw + (rest[nodes, :2] - before) @ turned
        return moved

    def _run(self, slow: float = 0.0) -> float:
        """Let Bullet go on until the kinetic energy is next looked at; stop the nodes where it has fallen.

        slow: m/s, nodes that are all slower than this are left alone, so that slow swings show. Returns the
        fastest node's speed, m/s. Raises Diverged.
        """
        rest, points, world, count = self.mesh.points, self._points, self._world, self._count
        self._frequency, self._mode = self.flap.frequency(points - rest, self.node_mass, self._mode, 1)
        if not np.isfinite(self._frequency):
            raise Diverged("an element is inside out")
        if not 0.85 * COURANT < self._step * self._frequency / 2 < 1.1 * COURANT:
            self._step = 2 * COURANT / self._frequency
        world.run(count, self._step)
        moved = world.positions()
        if not np.isfinite(moved).all() or np.abs(moved - rest).max() > 3 * self.scene.tissue.length:
            raise Diverged("the flap runs away")
        velocity = (moved - points) / (count * self._step)
        velocity[self.flap.held] = 0.0
        energy = float((velocity**2).sum())
        self._points = moved
        if self._far.any():
            low = float(moved[self._far, 1].min())
            world.want_bed(low < (LIFTED / 2 if not world.has_bed else LIFTED))
        fastest = float(np.sqrt((velocity**2).sum(axis=1).max()))
        if energy >= self._energy:
            self._energy = energy
        elif fastest >= slow:
            world.stop()
            self._energy = 0.0
        return fastest


def _pressing(state: TissueState) -> float:
    """N, the mean of both jaws' normal reactions."""
    return -float((state.reactions * state.normals).sum()) / 2


def _pybullet() -> Any:
    """The module. Raises ImportError, one line, where it is missing."""
    try:
        with silence():
            import pybullet
    except ImportError:
        raise ImportError(PHYSICS["bullet"].missing) from None
    return pybullet
