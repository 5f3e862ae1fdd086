"""The flap as a planar rod: the physics that is fast enough to learn and to search on.

What it computes and what it leaves out is said in `retract_env.rod`; how far it is from fine finite elements
in docs/rod.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from retract_env.compilation import announce
from retract_env.errors import Diverged
from retract_env.mesh import SectionMesh, patch_ends
from retract_env.physics.base import TissueState
from retract_env.rod import block as rods
from retract_env.rod import grip, measures
from retract_env.rod.flap import FREE, INNER
from retract_env.rod.section import ROWS, columns_of, section_of
from retract_env.scene import Scene
from retract_env.spring.columns import veins_of

COMPILES = 90.0
"""s that the kernels of all of this usually take to compile, once, on the two cores of a virtual machine."""

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


def flap_numbers(scene: Scene) -> Array:
    """(NUMBERS,) as `retract_env.rod.flap` has them."""
    tissue = scene.tissue
    weight = tissue.density * scene.gravity
    numbers = (tissue.length, tissue.height, tissue.depth, tissue.modulus, tissue.poisson, weight)
    return np.array([*numbers, scene.jaws.width, float(scene.bed)])


def sight_numbers(scene: Scene) -> Array:
    """(SIGHT,) as `retract_env.rod.measures` has them."""
    line, jaws = scene.line_of_sight, scene.jaws
    return np.array([*line.camera, line.target[0], float(jaws.in_sight), jaws.thickness, jaws.stem])


@lru_cache(maxsize=1)
def laws() -> tuple[Array, Array]:
    """The grip law's numbers, read once."""
    return grip.load()


@dataclass(frozen=True)
class RodState:
    """Where a `RodPhysics` stands."""

    scene_hash: str
    jaw_x: float
    force: float | None
    pressing: float
    lane: dict[str, Array]
    progress: float
    state: TissueState


class RodPhysics:
    """One flap between two jaws. Moves are made whole or not at all; nothing stops them on their way."""

    resolutions: ClassVar[tuple[str, ...]] = ("rod",)

    def __init__(
        self,
        scene: Scene,
        jaw_x: float,
        resolution: str = "rod",
        stop_when: Callable[[TissueState], bool] | None = None,  # noqa: ARG002
        force: float | None = None,
    ):
        """jaw_x: m, where the jaws grasp; force: N, by which they hold, None: by their separation. Raises
        ValueError for a place off the flap or a resolution."""
        if resolution not in self.resolutions:
            raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(self.resolutions)}")
        patch_ends(scene, jaw_x)
        self.scene, self.jaw_x, self.force = scene, jaw_x, force
        self._veins = veins_of(scene.tissue)
        announce(rods.advance_blocks, "the rod's kernels", COMPILES)
        self._laws, self._held = laws()
        self._blocks = rods.new_blocks(1)
        self._block = rods.block_of(self._blocks, 0)
        self._block.flap[0], self._block.sight[0] = flap_numbers(scene), sight_numbers(scene)
        self._columns = columns_of(scene.tissue.length, scene.tissue.height, jaw_x)
        self.section = _section(scene, self._columns)
        self._progress = self._pressing = 0.0
        self._state: TissueState | None = None

    def _lie(self) -> TissueState:
        """The state at rest; the flap itself is left flat, from where its jaws close."""
        self._progress = self._pressing = 0.0
        rods.hold(self._block, 0, self.jaw_x, 0.0, *self._veins, self._laws, self._held)
        flat = rods.state_of(self._block, 0)
        self._go(self.jaw_x, self.scene.tissue.height / 2, 0.0)
        state = self._measured()
        rods.set_state(self._block, 0, flat)
        return state

    def reset(self) -> TissueState:
        """Let the flap rest on its bed between open jaws. Raises Diverged."""
        self._state = state = self._lie()
        return state

    def move_to(self, pose: Array, progress: float | None = None) -> TissueState:
        """Move the jaws straight to a pose (4,) x, y, theta, separation.

        progress: where this is on a path, in waypoints. Raises Diverged; the flap is then where it was.
        """
        if self._state is None:
            self.reset()
        x, y, theta, separation = np.asarray(pose, float).tolist()
        before = rods.state_of(self._block, 0), self._pressing
        self._close(separation, progress)
        try:
            self._go(x, y, theta)
        except Diverged:
            rods.set_state(self._block, 0, before[0])
            self._pressing = before[1]
            raise
        self._progress = self._progress if progress is None else progress
        self._state = state = self._measured()
        return state

    def _close(self, separation: float, progress: float | None) -> None:
        """Have the jaws close as far, or press as hard, as a move says."""
        block, held = self._block, (*self._veins, self._held)
        if self.force is None:
            compression = (self.scene.tissue.height - separation) / self.scene.tissue.height
            if compression != block.grip[0, grip.COMPRESSION]:
                rods.close(block, 0, self.jaw_x, compression, *held)
            return
        pressing = self.force * (1.0 if progress is None else min(progress, 1.0))
        if pressing != self._pressing:
            rods.press(block, 0, self.jaw_x, pressing, *held)
        self._pressing = pressing

    def _go(self, x: float, y: float, theta: float) -> None:
        rods.aim.py_func(self._block, 0, x, y, theta)  # to hand over all arrays takes longer than to do it
        rods.advance_blocks(self._blocks, self._held, 0, 1)
        if not self._block.done[0]:
            raise Diverged("no equilibrium of the rod was found")

    def state(self) -> TissueState:
        """The last good state."""
        return self.reset() if self._state is None else self._state

    def close(self) -> None:
        """Nothing to give back: this physics holds only memory of Python's own."""

    def get_state(self) -> RodState:
        """Where the flap stands, to be returned to any number of times."""
        state = self.state()
        return RodState(
            self.scene.hash, self.jaw_x, self.force, self._pressing, rods.state_of(self._block, 0),
            self._progress, state,
        )  # fmt: skip

    def set_state(self, state: object) -> None:
        """Go on from there. Raises TypeError for no state, ValueError for that of another flap or grasp."""
        if not isinstance(state, RodState):
            raise TypeError(f"state is a {type(state).__name__}, allowed a RodState")
        if (state.scene_hash, state.jaw_x, state.force) != (self.scene.hash, self.jaw_x, self.force):
            raise ValueError("state: of another flap or grasp")
        rods.set_state(self._block, 0, state.lane)
        self._progress, self._pressing, self._state = state.progress, state.pressing, state.state

    def _measured(self) -> TissueState:
        out = self._block.measured[0].copy()
        points, strain, jaws, reactions, spot = section_of(self._block, 0, self._columns, self.jaw_x)
        along = (jaws[2:] - jaws[:2]) / math.hypot(jaws[2] - jaws[0], jaws[3] - jaws[1])
        return TissueState(
            points=points,
            strain=strain,
            jaws=jaws,
            reactions=reactions,
            normals=np.array([along, -along]),
            worst_strain=float(out[measures.WORST]),
            worst_at=spot,
            required_friction=out[measures.FRICTION_1 : measures.FRICTION_2 + 1],
            clearance=float(out[measures.CLEARANCE]),
            progress=self._progress,
            overlap=bool(out[measures.OVERLAP] > 0),
        )


@lru_cache(maxsize=1)
def _topology() -> tuple[Ints, Ints]:
    """Triangles, two an element, and the edges of the outline: the same for every flap."""
    cell = 2 * ROWS * np.arange(FREE + INNER, dtype=np.int32)[:, None]
    corner, middle, far = cell, cell + ROWS, cell + 2 * ROWS
    lower = np.hstack([corner, far, far + 2, middle, far + 1, middle + 1])
    upper = np.hstack([corner, far + 2, corner + 2, middle + 1, middle + 2, corner + 1])
    triangles = np.stack([lower, upper], axis=1).reshape(-1, 6).astype(np.int32)
    none = np.empty(0, np.int32)
    some = SectionMesh(np.empty((0, 2)), triangles, none, none, (none, none), none, np.empty(0))
    return triangles, some.boundary


def _section(scene: Scene, x: Array) -> SectionMesh:
    """The section between places at x (COLUMNS,) m. Veins are not followed: they are in the sections'
    stiffness."""
    tissue = scene.tissue
    y = np.array([0.0, tissue.height / 2, tissue.height])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    triangles, boundary = _topology()
    grasp = ROWS * measures.JAWS_COLUMN
    lengths = x[2::2] - x[:-2:2]
    share = np.zeros(len(x))
    share[:-2:2] += lengths / 6
    share[1:-1:2] += 4 * lengths / 6
    share[2::2] += lengths / 6
    section = SectionMesh(
        points=points,
        triangles=triangles,
        vein=np.full(len(triangles), -1, np.int32),
        fixed=np.arange(len(points) - ROWS, len(points), dtype=np.int32),
        patches=(np.array([grasp], np.int32), np.array([grasp + 2], np.int32)),
        bottom=np.arange(0, len(points), ROWS, dtype=np.int32),
        bottom_length=share,
        smeared=tissue.veins,
    )
    section.__dict__["boundary"] = boundary  # which it would find anew for every flap
    return section
