"""The dynamic physics: PyBullet's deformable world, a soft body of linear tetrahedra between two jaws.

Bullet integrates explicitly, and a flap's slowest swing takes thousands of its steps. So moves run some 40
times faster than life (9 ms of Bullet's time for 2 mm of the gripper), and two things keep the flap near
equilibrium:

* The flap is carried along: before Bullet's steps every node is moved as the gripper moves, less and less
  towards the fixed end.
* Kinetic damping (Cundall): whenever the kinetic energy has passed a peak, all nodes are stopped.

What is left is the lag: up to 3.5 mm at the flap's tip while it falls back after having been lifted off the
bed, then about 1 mm. Linear tetrahedra lock: the flap bends 15-30 % too stiffly and jaws feel two to three
times the force. Bullet's own law, a "stable" neo-Hookean one, agrees with the certifier's where strain is
small and puts the tip 0.1 mm elsewhere at a squeeze of a quarter. benchmarks/bullet.py measures all this.
Bullet tells neither strain nor the jaws' forces: both are computed from the nodes' positions.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import to_jaws, to_pose
from retract_env.physics.base import Diverged, TissueState
from retract_env.physics.bullet_world import World, silence
from retract_env.physics.measures import TetrahedralFlap
from retract_env.physics.tetmesh import tet_mesh
from retract_env.scene import Scene

Array = NDArray[np.float64]

STRIDE, TURN = 2e-3, float(np.radians(6.0))
"""m and rad, farthest move of the gripper in `BulletResolution.steps`; longer moves take more of them."""
PARTS = 10
"""Parts of a stride; after each one the jaws move on and the kinetic energy is looked at."""
COURANT = 0.7
"""Time step over the longest stable one; above sqrt(1/2) a stop adds energy to the fastest vibrations."""
LIFTED = 3e-4
"""m, the bed is left out while the flap is higher than this, but for what is next to the fixed end."""


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
    """Bullet's time steps in a stride, a multiple of PARTS"""


BULLET_RESOLUTIONS = {
    "coarse": BulletResolution("coarse", 0.57, 2, 1, 100),
    "medium": BulletResolution("medium", 0.38, 2, 2, 140),
    "fine": BulletResolution("fine", 0.32, 3, 2, 300),
}


class BulletPhysics:
    """One flap between two jaws, in a Bullet world of its own; not to be shared between threads.

    Raises Diverged where the motion runs away or an element is turned inside out; the state is then still the
    last good one, and the flap goes on from there.
    """

    def __init__(self, scene: Scene, jaw_x: float, resolution: str | BulletResolution = "medium"):
        """jaw_x: m, where the jaws grasp.

        Raises ImportError, one line, without pybullet, and ValueError as `tet_mesh`.
        """
        if isinstance(resolution, str):
            if resolution not in BULLET_RESOLUTIONS:
                raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(BULLET_RESOLUTIONS)}")
            resolution = BULLET_RESOLUTIONS[resolution]
        self.scene, self.resolution, self.jaw_x = scene, resolution, jaw_x
        tissue = scene.tissue
        self.mesh = mesh = tet_mesh(scene, jaw_x, resolution.along, resolution.across, resolution.deep)
        self.section = mesh.section
        self.flap = TetrahedralFlap(scene, mesh)
        # Bullet gives every node the same mass: this one keeps the moment of the weight about the fixed end.
        line = tissue.density * tissue.height * tissue.depth
        self.node_mass = line * tissue.length**2 / 2 / float(-mesh.points[:, 0].sum())
        self.load = np.zeros_like(mesh.points)
        self.load[:, 1] = -self.node_mass * scene.gravity
        part = np.clip(mesh.points[:, 0] / jaw_x, 0.0, 1.0)
        self._carried = (part**2 * (3 - 2 * part))[:, None]
        self._far = mesh.points[:, 0] < -1.5 * tissue.height
        self._world = World(_pybullet(), scene, mesh, jaw_x, self.node_mass)
        self._begin()

    def _begin(self) -> None:
        rest = to_pose(np.array([self.jaw_x, 0.0, self.jaw_x, self.scene.tissue.height]))
        self._good = self.mesh.points, rest, 0.0
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
        return self.settle(5e-3 if self.scene.bed else 1e-3)

    def settle(self, speed: float = 1e-3, longest: int = 20_000) -> TissueState:
        """Hold the jaws until no node is faster than `speed`, m/s, at a peak of the kinetic energy.

        longest: Bullet's time steps. Raises Diverged, also where the flap does not come to rest.
        """
        _, pose, progress = self._good
        steps = self.resolution.steps // PARTS
        with self._keeping_the_last_good_state():
            for _ in range(0, longest, steps):
                if self._part(pose, pose) < speed:
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
        dx, dy, turn, squeeze = np.abs(pose - start)
        strides = max(np.hypot(dx, dy) / STRIDE, squeeze / STRIDE, turn / TURN)
        parts = int(np.ceil(PARTS * max(1.0, strides) - 1e-9))
        with self._keeping_the_last_good_state():
            at = start
            for k in range(1, parts + 1):
                target = start + k / parts * (pose - start)
                self._part(at, target)
                at = target
            return self._accept(pose, before if progress is None else progress)

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

    def render_3d(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        """The flap, the jaws and the bed as Bullet's software renderer sees them, (height, width, 3)."""
        return self._world.picture(width, height)

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

    def _part(self, start: Array, end: Array) -> float:
        """Move the gripper by a part of a stride, and stop the nodes where the kinetic energy falls.

        Returns the fastest node's speed, m/s, before it was stopped, inf where none was. Raises Diverged.
        """
        rest, points, world = self.mesh.points, self._points, self._world
        self._frequency, self._mode = self.flap.frequency(points - rest, self.node_mass, self._mode, 1)
        if not np.isfinite(self._frequency):
            raise Diverged("an element is inside out")
        if not 0.85 * COURANT < self._step * self._frequency / 2 < 1.1 * COURANT:
            self._step = 2 * COURANT / self._frequency
        step, count = self._step, self.resolution.steps // PARTS
        if start is not end:
            points = self._carry(points, start, end)
            world.place(points)
            world.place_jaws(end)
        world.run(count, step)
        moved = world.positions()
        if not np.isfinite(moved).all() or np.abs(moved - rest).max() > 3 * self.scene.tissue.length:
            raise Diverged("the flap runs away")
        velocity = (moved - points) / (count * step)
        velocity[self.flap.held] = 0.0
        energy = float((velocity**2).sum())
        self._points = moved
        if self._far.any():
            low = float(moved[self._far, 1].min())
            world.want_bed(low < (LIFTED / 2 if not world.has_bed else LIFTED))
        if energy >= self._energy:
            self._energy = energy
            return np.inf
        world.stop()
        self._energy = 0.0
        return float(np.sqrt((velocity**2).sum(axis=1).max()))

    def _carry(self, points: Array, start: Array, end: Array) -> Array:
        """Nodes (n, 3) moved with the gripper, from the fixed end on ever more, wholly beyond the jaws."""
        turn = end[2] - start[2]
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        moved = points.copy()
        moved[:, :2] += self._carried * ((points[:, :2] - start[:2]) @ rotation + end[:2] - points[:, :2])
        if self.scene.bed:
            moved[:, 1] = np.maximum(moved[:, 1], np.minimum(points[:, 1], 0.0))
        return moved


def _pybullet() -> Any:
    """The module. Raises ImportError, one line, where it is missing."""
    try:
        with silence():
            import pybullet
    except ImportError:
        hint = 'pip install "retract[bullet]"; TissueRetractFEM-v0 needs none'
        raise ImportError(f"pybullet is not installed: {hint}") from None
    return pybullet
