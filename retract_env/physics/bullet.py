"""The dynamic physics: PyBullet's deformable world, a soft body of linear tetrahedra between two jaws.

Bullet integrates explicitly, and the slowest swing of a flap takes thousands of its steps. So the gripper's moves run much faster than
life, and two things keep the flap close to equilibrium all the same:

* the flap is carried along: before Bullet's steps every node is moved as the gripper moves, less and less towards the fixed end;
* kinetic damping (Cundall): nothing else damps the motion, and whenever the kinetic energy falls all nodes are stopped.

What is left is the lag. It, the speed and the errors against the finite elements are measured by benchmarks/bullet.py. Linear tetrahedra lock:
they bend 15-30 % too stiffly, and the jaws feel up to two or three times the force. Bullet's own jaw forces and strains cannot be used;
both come from the node positions.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import to_jaws, to_pose
from retract_env.physics.base import Diverged, TissueState
from retract_env.physics.measures import TetrahedralFlap
from retract_env.physics.tetmesh import TetMesh, tet_mesh
from retract_env.scene import Scene

Array = NDArray[np.float64]

MARGIN = 2e-4
"""m, Bullet's collision margin; the flap lies that far above the bed in Bullet's own frame."""
STRIDE = 2e-3, np.radians(6.0)
"""m and rad, farthest move of the gripper within BulletResolution.steps; longer moves take a multiple."""
PARTS = 10
DAMP = 1e-5
UNIT = 1e-4
"""Parts of a stride, after each of which the jaws move on and the kinetic energy is looked at."""
COURANT = 0.8
"""Time step over the longest that is stable for small vibrations."""
LIFTED = 3e-4
"""m, the bed is left out while the flap, but for what is next to the fixed end, is higher than this."""


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
    """Bullet's time steps in a stride"""


BULLET_RESOLUTIONS = {
    "coarse": BulletResolution("coarse", 0.57, 2, 1, 100),
    "medium": BulletResolution("medium", 0.38, 2, 2, 160),
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
        self._world = World(scene, mesh, jaw_x, self.node_mass)
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
        return self.settle()

    def settle(self, speed: float = 1e-3, longest: int = 20_000) -> TissueState:
        """Run with the jaws at rest until no node was faster than `speed`, m/s, at a peak of the kinetic energy.

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
        _, start, before = self._good
        dx, dy, turn, squeeze = np.abs(pose - start)
        strides = max(np.hypot(dx, dy) / STRIDE[0], squeeze / STRIDE[0], turn / STRIDE[1])
        parts = int(np.ceil(PARTS * max(1.0, strides) - 1e-9))
        with self._keeping_the_last_good_state():
            at = start
            for k in range(1, parts + 1):
                target = start + k / parts * (pose - start)
                self._part(at, target)
                at = target
            return self._accept(pose, before if progress is None else progress)

    def state(self) -> TissueState:
        """What there is to see and to feel now."""
        points, pose, progress = self._good
        u = points - self.mesh.points
        return self.flap.state(u, self.load, to_jaws(pose), progress)

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
        """Move the gripper from one pose to the next; returns the fastest node's speed, m/s, if it was then stopped, else inf."""
        rest, points, world = self.mesh.points, self._points, self._world
        self._frequency, self._mode = self.flap.frequency(points - rest, self.node_mass, self._mode, 2)
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
        """Nodes (n, 3) moved with the gripper, from the fixed end on ever more, and wholly beyond the jaws."""
        turn = end[2] - start[2]
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        moved = points.copy()
        moved[:, :2] += self._carried * ((points[:, :2] - start[:2]) @ rotation + end[:2] - points[:, :2])
        if self.scene.bed:
            moved[:, 1] = np.maximum(moved[:, 1], np.minimum(points[:, 1], 0.0))
        return moved


class World:
    """The calls to pybullet. In Bullet's frame all lies `lift` higher, which is taken off what is returned."""

    def __init__(self, scene: Scene, mesh: TetMesh, jaw_x: float, node_mass: float):
        self._bullet = _pybullet()
        self._scene, self._mesh, self._jaw_x, self._node_mass = scene, mesh, jaw_x, node_mass
        self._lift = np.array([0.0, MARGIN if scene.bed else 0.0, 0.0])
        self._text = mesh.vtk()
        # Always the same lists: resetMeshData never frees what it is given.
        self._rows = [[0.0, 0.0, 0.0] for _ in mesh.points]
        self._client = self._bullet.connect(self._bullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("Bullet has no free client")
        self._at = {"physicsClientId": self._client}

    def close(self) -> None:
        if self._client >= 0:
            client, self._client = self._client, -1
            self._bullet.disconnect(client)

    def __del__(self) -> None:
        if getattr(self, "_client", -1) >= 0:
            with contextlib.suppress(Exception):  # at the interpreter's end
                self.close()

    def load(self) -> None:
        """Begin anew with the flap at rest."""
        b, scene, mesh = self._bullet, self._scene, self._mesh
        tissue = scene.tissue
        mu = tissue.modulus / (2 * (1 + tissue.poisson))
        lam = 2 * mu * tissue.poisson / (1 - 2 * tissue.poisson)
        b.resetSimulation(b.RESET_USE_DEFORMABLE_WORLD, **self._at)
        b.setGravity(0.0, -scene.gravity * UNIT**2, 0.0, **self._at)
        with tempfile.TemporaryDirectory(prefix="retract-") as folder:
            file = Path(folder) / "flap.vtk"
            file.write_text(self._text, "ascii")
            with _silence():
                self._flap = b.loadSoftBody(
                    str(file),
                    basePosition=self._lift.tolist(),
                    mass=self._node_mass * len(mesh.points),
                    collisionMargin=MARGIN,
                    useNeoHookean=1,
                    # Bullet's law is another one; with these it is Hooke's at small strain.
                    NeoHookeanMu=4 / 3 * mu * UNIT**2,
                    NeoHookeanLambda=(lam + 5 / 6 * mu) * UNIT**2,
                    NeoHookeanDamping=DAMP / UNIT,
                    frictionCoeff=0.0,
                    **self._at,
                )
        b.changeDynamics(self._flap, -1, activationState=b.ACTIVATION_STATE_DISABLE_SLEEPING, **self._at)
        self._jaws = [self._jaw(k) for k in range(2)]
        for jaw, nodes in zip(self._jaws, mesh.patches, strict=True):
            for node in nodes.tolist():
                b.createSoftBodyAnchor(self._flap, node, jaw, -1, **self._at)
        # A node without mass is no constraint to be solved for: an anchored one just goes where its jaw goes.
        for node in np.concatenate([mesh.fixed, *mesh.patches]).tolist():
            b.createSoftBodyAnchor(self._flap, node, -1, -1, **self._at)
        b.changeVisualShape(self._flap, -1, rgbaColor=[0.87, 0.55, 0.5, 1.0], **self._at)
        self._bed: int | None = None
        if scene.bed:
            self._block(solid=False)
            self.want_bed(True)

    def _jaw(self, k: int) -> int:
        b, tissue, jaws = self._bullet, self._scene.tissue, self._scene.jaws
        thick = tissue.height / 8
        half = [jaws.width / 2, thick, (jaws.depth or 1.1 * tissue.depth) / 2]
        shape = b.createVisualShape(
            b.GEOM_BOX,
            halfExtents=half,
            rgbaColor=[0.25, 0.27, 0.32, 1.0],
            visualFramePosition=[0.0, thick * (2 * k - 1), 0.0],
            **self._at,
        )
        at = self._lift + [self._jaw_x, k * tissue.height, 0.0]
        return b.createMultiBody(0, -1, shape, at.tolist(), useMaximalCoordinates=1, **self._at)

    def _block(self, solid: bool) -> int:
        """The bed to be seen, or also to lie on."""
        b, tissue = self._bullet, self._scene.tissue
        half = [2 * tissue.length, tissue.height, 2 * tissue.depth]
        grey = [0.6, 0.63, 0.68, 1.0]
        seen = b.createVisualShape(b.GEOM_BOX, halfExtents=half, rgbaColor=grey, **self._at)
        felt = b.createCollisionShape(b.GEOM_BOX, halfExtents=half, **self._at) if solid else -1
        below = [0.0, -half[1], 0.0]
        # maximal coordinates make it a rigid body; contact with a multibody takes twice as long
        return b.createMultiBody(0, felt, seen, below, useMaximalCoordinates=1, **self._at)

    @property
    def has_bed(self) -> bool:
        return self._bed is not None

    def want_bed(self, wanted: bool) -> None:
        """Put the bed there or take it away, if the scene has one."""
        if not self._scene.bed or wanted == self.has_bed:
            return
        if self._bed is None:
            self._bed = self._block(solid=True)
        else:
            self._bullet.removeBody(self._bed, **self._at)
            self._bed = None

    def positions(self) -> Array:
        """(n, 3) m."""
        b = self._bullet
        data = b.getMeshData(self._flap, -1, flags=b.MESH_DATA_SIMULATION_MESH, **self._at)
        return np.array(data[1]) - self._lift

    def place(self, points: Array) -> None:
        """Put the nodes at points (n, 3) m, their velocities as they are."""
        for row, point in zip(self._rows, (points + self._lift).tolist(), strict=True):
            row[:] = point
        self._bullet.resetMeshData(self._flap, self._rows, **self._at)

    def place_jaws(self, pose: Array) -> None:
        jaws = to_jaws(pose).reshape(2, 2)
        turn = [0.0, 0.0, float(np.sin(pose[2] / 2)), float(np.cos(pose[2] / 2))]
        for body, (x, y) in zip(self._jaws, jaws.tolist(), strict=True):
            at = [x, y + float(self._lift[1]), 0.0]
            self._bullet.resetBasePositionAndOrientation(body, at, turn, **self._at)

    def run(self, count: int, step: float) -> None:
        """count steps of step s."""
        self._bullet.setPhysicsEngineParameter(fixedTimeStep=step / UNIT, **self._at)
        for _ in range(count):
            self._bullet.stepSimulation(**self._at)

    def stop(self) -> None:
        """Take all velocity from the nodes."""
        self._bullet.resetBaseVelocity(self._flap, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], **self._at)

    def picture(self, width: int, height: int) -> NDArray[np.uint8]:
        b, length = self._bullet, self._scene.tissue.length
        eye, target = [-1.1 * length, 0.7 * length, 1.4 * length], [-0.5 * length, 0.15 * length, 0.0]
        view = b.computeViewMatrix(eye, target, [0.0, 1.0, 0.0])
        lens = b.computeProjectionMatrixFOV(40.0, width / height, 0.1 * length, 10 * length)
        image = b.getCameraImage(
            width,
            height,
            view,
            lens,
            lightDirection=[-1.0, 3.0, 2.0],
            renderer=b.ER_TINY_RENDERER,
            **self._at,
        )
        return np.reshape(np.asarray(image[2], np.uint8), (height, width, 4))[..., :3].copy()


def _pybullet() -> Any:
    """The module. Raises ImportError, one line, where it is missing."""
    try:
        with _silence():
            import pybullet
    except ImportError:
        hint = 'pip install "retract[bullet]"; TissueRetractFEM-v0 needs none'
        raise ImportError(f"pybullet is not installed: {hint}") from None
    return pybullet


_one_at_a_time = threading.Lock()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep from the console what Bullet's C code prints."""
    with _one_at_a_time, contextlib.ExitStack() as undo:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):  # it may be closed, or none
                stream.flush()
        null = os.open(os.devnull, os.O_WRONLY)
        undo.callback(os.close, null)
        for number in (1, 2):
            with contextlib.suppress(OSError):
                kept = os.dup(number)
                undo.callback(os.close, kept)
                undo.callback(os.dup2, kept, number)
                os.dup2(null, number)
        yield
        with contextlib.suppress(Exception):  # C's own buffer, where it can be reached
            ctypes.CDLL(None).fflush(None)
