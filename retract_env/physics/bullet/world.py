"""The calls to pybullet: one soft body, two jaws and a bed in a deformable world of their own.

pybullet itself is imported in flap.py alone. What is done here follows from what Bullet 3.2.7 does:

* Anchors to moving bodies are constraints, which double the cost of a step; those of a node without mass are
  skipped, but the node still goes where its jaw goes. So held nodes are anchored first, then lose their mass.
* Contact with a multibody takes twice as long as with a rigid body, which maximal coordinates ask for.
* The soft body's solver stops at an absolute 1e-8 of velocity: with the millisecond as the unit of time this
  is 1e-5 m/s, and iterations are saved.
* Velocities of single nodes cannot be set, but all can be made zero; positions can be set.
* It prints when it loads a mesh, and crashes on bad mesh files: it only gets files that are written here.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import to_jaws
from retract_env.physics.bullet.tetmesh import TetMesh
from retract_env.scene import Scene

Array = NDArray[np.float64]

MARGIN = 2e-4
"""m, Bullet's collision margin: the flap begins that far above the bed; it is taken off what is reported."""
DAMPING = 3e-5
"""s, viscosity over elasticity: it stills fast shaking within a few time steps, and leaves slow swings."""
UNIT_OF_TIME = 1e-3
"""s"""


class World:
    """A private Bullet world. In its own frame all lies `MARGIN` higher, where there is a bed."""

    def __init__(self, pybullet: Any, scene: Scene, mesh: TetMesh, jaw_x: float, node_mass: float):
        """jaw_x: m; node_mass: kg, since Bullet gives all nodes the same."""
        self._bullet = pybullet
        self._scene, self._mesh, self._jaw_x, self._node_mass = scene, mesh, jaw_x, node_mass
        self._lift = np.array([0.0, MARGIN if scene.bed else 0.0, 0.0])
        self._text = mesh.vtk()
        self._client = int(pybullet.connect(pybullet.DIRECT))
        if self._client < 0:
            raise RuntimeError("Bullet has no room for another world")
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
        """Begin anew, the flap at rest and the jaws open."""
        b, scene, mesh = self._bullet, self._scene, self._mesh
        tissue = scene.tissue
        mu = tissue.modulus / (2 * (1 + tissue.poisson))
        lam = 2 * mu * tissue.poisson / (1 - 2 * tissue.poisson)
        b.resetSimulation(b.RESET_USE_DEFORMABLE_WORLD, **self._at)
        b.setGravity(0.0, -scene.gravity * UNIT_OF_TIME**2, 0.0, **self._at)
        with tempfile.TemporaryDirectory(prefix="retract-") as folder:
            file = Path(folder) / "flap.vtk"
            file.write_text(self._text, "ascii")
            with silence():
                self._flap = b.loadSoftBody(
                    str(file),
                    basePosition=self._lift.tolist(),
                    mass=self._node_mass * len(mesh.points),
                    collisionMargin=MARGIN,
                    useNeoHookean=1,
                    # Bullet's parameters are not Lame's; these make its law Hooke's where strain is small.
                    NeoHookeanMu=4 / 3 * mu * UNIT_OF_TIME**2,
                    NeoHookeanLambda=(lam + 5 / 6 * mu) * UNIT_OF_TIME**2,
                    NeoHookeanDamping=DAMPING / UNIT_OF_TIME,
                    frictionCoeff=0.0,
                    **self._at,
                )
        # A flap that rests for two seconds would fall asleep and stay so.
        b.changeDynamics(self._flap, -1, activationState=b.ACTIVATION_STATE_DISABLE_SLEEPING, **self._at)
        self._jaws = [self._jaw(k) for k in range(2)]
        for jaw, nodes in zip(self._jaws, mesh.patches, strict=True):
            for node in nodes.tolist():
                b.createSoftBodyAnchor(self._flap, node, jaw, -1, **self._at)
        for node in np.concatenate([mesh.fixed, *mesh.patches]).tolist():
            b.createSoftBodyAnchor(self._flap, node, -1, -1, **self._at)  # takes its mass
        self._bed: int | None = None
        if scene.bed:
            self.want_bed(True)

    def _jaw(self, k: int) -> int:
        """The lower (0) or the upper jaw (1): a body that nodes are tied to, without a shape."""
        at = [self._jaw_x, k * self._scene.tissue.height + float(self._lift[1]), 0.0]
        return int(self._bullet.createMultiBody(0, -1, -1, at, useMaximalCoordinates=1, **self._at))

    def _block(self) -> int:
        """The bed to lie on."""
        b, tissue = self._bullet, self._scene.tissue
        half = [2 * tissue.length, tissue.height, tissue.depth + tissue.length / 4]
        felt = b.createCollisionShape(b.GEOM_BOX, halfExtents=half, **self._at)
        return int(b.createMultiBody(0, felt, -1, [0.0, -half[1], 0.0], useMaximalCoordinates=1, **self._at))

    @property
    def has_bed(self) -> bool:
        """Whether the bed is there now."""
        return self._bed is not None

    def want_bed(self, wanted: bool) -> None:
        """Put the bed there or take it away, where the scene has one."""
        if not self._scene.bed or wanted == self.has_bed:
            return
        if self._bed is None:
            self._bed = self._block()
        else:
            self._bullet.removeBody(self._bed, **self._at)
            self._bed = None

    def positions(self) -> Array:
        """(n, 3) m."""
        b = self._bullet
        data = b.getMeshData(self._flap, -1, flags=b.MESH_DATA_SIMULATION_MESH, **self._at)
        found: Array = np.array(data[1]) - self._lift
        return found

    def place(self, points: Array) -> None:
        """Put the nodes at points (n, 3) m, their velocities as they are."""
        with _one_at_a_time:
            rows = _rows(len(points))
            for row, point in zip(rows, (points + self._lift).tolist(), strict=True):
                row[:] = point
            self._bullet.resetMeshData(self._flap, rows, **self._at)

    def place_jaws(self, pose: Array) -> None:
        """Put the jaws at a pose (4,); the nodes that they hold follow with the next step."""
        turn = [0.0, 0.0, float(np.sin(pose[2] / 2)), float(np.cos(pose[2] / 2))]
        for body, (x, y) in zip(self._jaws, to_jaws(pose).reshape(2, 2).tolist(), strict=True):
            at = [x, y + float(self._lift[1]), 0.0]
            self._bullet.resetBasePositionAndOrientation(body, at, turn, **self._at)

    def run(self, count: int, step: float) -> None:
        """count time steps of `step` s."""
        self._bullet.setPhysicsEngineParameter(fixedTimeStep=step / UNIT_OF_TIME, **self._at)
        for _ in range(count):
            self._bullet.stepSimulation(**self._at)

    def stop(self) -> None:
        """Take all nodes' velocities."""
        self._bullet.resetBaseVelocity(self._flap, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], **self._at)


_one_at_a_time = threading.Lock()


@functools.cache
def _rows(count: int) -> list[list[float]]:
    """The lists given to resetMeshData: always the same ones, because pybullet never frees them."""
    return [[0.0, 0.0, 0.0] for _ in range(count)]


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep from the console what C code prints."""
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
