"""The quasi-static finite-element physics: the flap in equilibrium with every pose of the jaws."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.beam import BeamGuess
from retract_env.fem.model import FlapModel
from retract_env.fem.press import closing, equilibrate, pressing
from retract_env.fem.rest import come_to_rest
from retract_env.fem.solver import MOST_ITERATIONS as SOLVER_ITERATIONS
from retract_env.fem.solver import Equilibrium, Kept
from retract_env.grasp import to_jaws, to_pose
from retract_env.mesh import RESOLUTIONS, Resolution, SectionMesh
from retract_env.mesh.outlines import resolved_section
from retract_env.physics.base import TissueState
from retract_env.physics.measures import Measures
from retract_env.scene import Scene

Array = NDArray[np.float64]

SMALLEST_CUT = 1 / 64
"""Part of a step below which it is not cut any further."""
PATIENCE = 100
"""Iterations for one equilibrium of a move, where steps are cut no further. Where a firm grip's pads begin to
push, the flap snaps over; no step is then small enough, and where it snaps to takes 40 to 60."""
FIRST_PART = 0.3
"""Part of a step that is tried first after a corner of the path."""
MOST_ITERATIONS, MOST_WORK = 800, 8_000_000
"""Newton iterations in one move, a shifted factorisation counted as one, and those times the unknowns, so
that a move takes seconds on usual flaps: at `coarse` the first ends it, on meshes of more than 10,000
unknowns the second. Moves on random flaps take 5 to 20 iterations, the hardest one seen of them 206. At half
of this, shifts counted, the light grips of one wide scene in seven were lost before they touched."""
LEAST_ITERATIONS = 40
"""Whatever the unknowns."""
MEMORY = 4
"""Latest equilibria of a path that the next one is extrapolated from."""


@dataclass(frozen=True, repr=False, eq=False)
class FemState:
    """Where a flap stood, for `FemPhysics.set_state`. Not to be changed: who shares it does not copy it."""

    scene: str
    """hash"""
    jaw_x: float
    """m"""
    resolution: Resolution
    hold: float | None
    """N, by which the jaws hold"""
    pose: Array
    """(4,) x, y, theta, separation"""
    displacements: Array
    """(n,) m"""
    force: Array
    """(n,) N, that holds the prescribed nodes"""
    progress: float
    history: tuple[tuple[float, Array], ...]
    """progress and displacements that the next equilibrium is extrapolated from"""
    kept: Kept | None
    """of the solver"""


class FemPhysics:
    """One flap between two jaws.

    Raises Diverged where a pose has no equilibrium that can be reached from the one before; the state is then
    still the last good one.
    """

    resolutions: ClassVar[tuple[str, ...]] = tuple(RESOLUTIONS)
    flap: ClassVar[type[FlapModel]] = FlapModel

    def __init__(
        self,
        scene: Scene,
        jaw_x: float,
        resolution: str | Resolution = "fine",
        stop_when: Callable[[TissueState], bool] | None = None,
        force: float | None = None,
    ):
        """jaw_x: m, where the jaws grasp; stop_when: called with the state after each part of a move
        that has to be cut; the move ends there if it returns True; force: N, by which the jaws hold, None: by
        their separation. Raises MeshError, and ValueError for an unknown resolution."""
        if isinstance(resolution, str):
            if resolution not in RESOLUTIONS:
                raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(RESOLUTIONS)}")
            resolution = RESOLUTIONS[resolution]
        self.scene, self.resolution, self.jaw_x, self.force = scene, resolution, jaw_x, force
        self._scene_hash = scene.hash
        self.seconds: defaultdict[str, float] = defaultdict(float)
        start = time.perf_counter()
        self.section = self._meshed()
        self.seconds["mesh"] = time.perf_counter() - start
        start = time.perf_counter()
        self.model = self.flap(scene, self.section, jaw_x, resolution)
        self._beam = BeamGuess(self.model.prism, scene, jaw_x)
        self.equilibrium = Equilibrium(self.model)
        layers = len(self.model.prism.blocks)
        self._measures = Measures.of_layers(scene, self.section, self.model.assembly, layers)
        self.seconds["assembly"] = time.perf_counter() - start
        self._stop_when = stop_when
        self._history: list[tuple[float, Array]] = []
        self._rest: tuple[Array, Array, float] | None = None
        self._begin()

    def _meshed(self) -> SectionMesh:
        return resolved_section(self.scene, self.jaw_x, self.resolution)

    def _begin(self) -> None:
        height = self.scene.tissue.height
        self._pose = to_pose(np.array([self.jaw_x, 0.0, self.jaw_x, height]))
        self._u = self.model.at_rest()
        self._force = np.zeros_like(self._u)
        self._progress = 0.0
        self._history.clear()

    def reset(self) -> TissueState:
        """Let the flap rest on its bed, the open jaws holding it where they touch.

        Raises Diverged; the state is then that under the part of its weight that it could be given.
        """
        self._begin()
        self.equilibrium.counts.clear()
        if self._rest is None:
            start = time.perf_counter()
            self.equilibrium.forget()
            self._rest = come_to_rest(self.equilibrium, self._most_iterations())
            self.seconds["equilibrium"] += time.perf_counter() - start
        self.equilibrium.forget()
        self._u, self._force, borne = self._rest
        if borne < 1.0:
            raise Diverged(f"no equilibrium was found under more than {borne:.3g} of the flap's weight")
        self._history.append((0.0, self._u))
        return self.state()

    def _most_iterations(self) -> int:
        """In one move."""
        return min(MOST_ITERATIONS, max(LEAST_ITERATIONS, MOST_WORK // max(len(self.model.free), 1)))

    def move_to(self, pose: Array, progress: float | None = None) -> TissueState:
        """Move the jaws straight to a pose (4,) x, y, theta, separation, cutting the step where it cannot be
        solved.

        progress: where this is on a smooth path; equilibria of one path predict the next one. Without it the
        tangent does. Jaws that hold by force find their separation; below 1, progress says which part of the
        force. Raises Diverged, also where it takes more than `MOST_ITERATIONS` or `MOST_WORK`.
        """
        pose = self._with_separation(pose, self._pose[3])
        equilibrium, allowed = self.equilibrium, self._most_iterations()
        equilibrium.last_work = equilibrium.work + allowed
        start_pose, begin, target = self._pose, self._progress, progress
        before, after = self._levels(progress)
        # With one equilibrium to look back on, the tangent predicts: small steps first, until two or more of
        # them predict better.
        corner = len(self._history) == 1 or (progress is None and bool(self._history))
        done, part, patient = 0.0, FIRST_PART if corner else 1.0, False
        start = time.perf_counter()
        try:
            while done < 1.0:
                if equilibrium.work > equilibrium.last_work:
                    raise Diverged(f"a move took more than {allowed} iterations")
                share = min(done + part, 1.0)
                at = None if target is None else begin + share * (target - begin)
                try:
                    level = None if after is None else before + share * (after - before)
                    self._solve(start_pose + share * (pose - start_pose), at, level)
                except Diverged:
                    part /= 2
                    self._history.clear()
                    if part < SMALLEST_CUT or equilibrium.work > equilibrium.last_work:
                        if patient:
                            raise
                        patient, part = True, max(part, SMALLEST_CUT)
                        equilibrium.max_iterations = PATIENCE
                        equilibrium.last_work += PATIENCE
                else:
                    done = share
                    equilibrium.max_iterations = SOLVER_ITERATIONS
                    if done < 1.0 and self._stop_when is not None and self._stop_when(self.state()):
                        return self.state()
                    part *= 3
        finally:
            equilibrium.max_iterations, equilibrium.last_work = SOLVER_ITERATIONS, math.inf
            self.seconds["equilibrium"] += time.perf_counter() - start
        self._pose = self._with_separation(pose, self._pose[3])
        return self.state()

    def between(
        self, known: Sequence[tuple[float, Array]], start: Array, pose: Array, progress: float
    ) -> tuple[TissueState, Array]:
        """The state at a pose (4,) between known equilibria, and its displacements (n,) m.

        known: progress, ascending, and displacements of at least two, on both sides; start: pose (4,) of the
        last one before. Where the state does not follow from both sides, as where the flap snaps over, the
        jaws go there from the earlier one. The flap itself stays where it is. Raises Diverged.
        """
        kept = self._u, self._force, self._pose, self._progress, self._history
        try:
            nearest = sorted(known, key=lambda k: abs(k[0] - progress))[:MEMORY]
            self._history = sorted(nearest, key=lambda k: k[0])
            u, pose = self._extrapolate(progress), self._with_separation(pose, self._expected(progress))
            self.model.place_jaws(u, to_jaws(pose))
            try:
                self._u, self._force, self._pose = equilibrate(self.equilibrium, u, pose, self.force)
                self._progress = progress
            except Diverged:
                self.resume(start, *max((k for k in known if k[0] < progress), key=lambda k: k[0]))
                self.move_to(pose, progress)
            return self.state(), self._u
        finally:
            self._u, self._force, self._pose, self._progress, self._history = kept

    def resume(self, pose: Array, progress: float, u: Array) -> None:
        """Go back to an equilibrium, at a pose (4,), whose displacements u (n,) m are known."""
        self._u, self._force = u, self.model.residual(u)[1]
        self._pose, self._progress = self._with_separation(pose, self._separation(u)), progress
        self._history = [(progress, u)]
        self.equilibrium.forget()

    def get_state(self) -> FemState:
        """Where the flap stands and all that its next moves depend on; costs nothing, and changes nothing."""
        # no array in it is written to once it is there, here or in the solver
        return FemState(
            self._scene_hash, self.jaw_x, self.resolution, self.force, self._pose, self._u, self._force,
            self._progress, tuple(self._history), self.equilibrium.kept,
        )  # fmt: skip

    def set_state(self, state: object) -> None:
        """Stand where a flap of the same scene, grasp and resolution stood, in this process or another.

        Moves from there lead to the same states as they did there, to the last bit. Raises TypeError for what
        is no state of this physics, ValueError for that of another flap.
        """
        if not isinstance(state, FemState):
            raise TypeError(f"a state of FemPhysics.get_state is needed, not {type(state).__name__}")
        for name, theirs, ours in (
            ("scene", state.scene, self._scene_hash),
            ("grasp", state.jaw_x, self.jaw_x),
            ("resolution", state.resolution, self.resolution),
            ("force", state.hold, self.force),
        ):
            if theirs != ours:
                raise ValueError(f"the state is that of another {name}: {theirs}, here {ours}")
        self._pose, self._u, self._force = state.pose, state.displacements, state.force
        self._progress, self._history = state.progress, list(state.history)
        self.equilibrium.remember(state.kept)

    def close(self) -> None:
        """Nothing to give back: this physics holds only memory of Python's own."""

    def turn(self) -> None:
        """Say that the path has a corner here: what came before does not predict what follows."""
        self._history = self._history[-1:]

    def _solve(self, pose: Array, progress: float | None, level: float | None) -> None:
        if level is not None:
            pose = self._with_separation(pose, self._predicted(progress, level))
        guess = self._guess(pose, progress)
        self._u, self._force, self._pose = equilibrate(self.equilibrium, guess, pose, level, self._u)
        if progress is None:
            self._history.clear()
            # they would help little where the next move goes elsewhere; states stay small
            self.equilibrium.forget_steps()
        else:
            self._progress = progress
            earlier = [h for h in self._history if h[0] != progress]
            self._history = [*earlier[1 - MEMORY :], (progress, self._u)]

    def _guess(self, pose: Array, progress: float | None) -> Array:
        """Displacements near those of the equilibrium at this pose. Infinite energy where nothing better is
        found.

        Of two guesses it is the one of less energy: a beam that goes with its jaws, while they keep their
        distance; and the polynomial through earlier equilibria, better once these follow a smooth path.
        """
        jaws, guesses = to_jaws(pose), []
        if math.isclose(pose[3], self._pose[3], rel_tol=1e-9):
            beam = self._beam.moved(self._u, self._pose, pose)
            beam[self.model.fixed] = 0.0  # not even rounding moves it
            guesses.append(beam)
        if progress is not None and len(self._history) > 1:
            guesses.append(self._extrapolate(progress))
        for u in guesses:
            self.model.place_jaws(u, jaws)
        energies = [self.model.residual(u)[0] for u in guesses]
        if guesses and math.isfinite(min(energies)):
            return guesses[energies.index(min(energies))]
        moved = self._u.copy()
        self.model.place_jaws(moved, jaws)
        self.equilibrium.factorize(self._u)
        u = self._u + self.equilibrium.step(self._u, moved - self._u)
        self.model.place_jaws(u, jaws)  # rotation is not linear in the step
        return u

    def _extrapolate(self, progress: float) -> Array:
        """Lagrange's polynomial through the last equilibria."""
        u = np.zeros_like(self._u)
        for weight, (_, known) in zip(self._weights(progress), self._history, strict=True):
            u += known * weight
        return u

    def _weights(self, progress: float) -> list[float]:
        """Of the last equilibria, in Lagrange's polynomial."""
        at = np.array([p for p, _ in self._history])
        others = [np.delete(at, i) for i in range(len(at))]
        return [
            float(np.prod((progress - rest) / (p - rest)))
            for p, rest in zip(at.tolist(), others, strict=True)
        ]

    # --- Jaws that hold by force

    def _with_separation(self, pose: Array, separation: float) -> Array:
        """The pose as it is, or, where the jaws hold by force, with this separation."""
        pose = np.asarray(pose, float)
        return pose if self.force is None else np.append(pose[:3], separation)

    def _separation(self, u: Array) -> float:
        """m, of the jaws in a shape u (n,) m."""
        return float(to_pose(self.model.jaws(u))[3])

    def _levels(self, progress: float | None) -> tuple[float, float | None]:
        """N: with what the jaws press now, and with what after a move to that progress; None where they do
        not hold by force."""
        if self.force is None:
            return 0.0, None
        part = 1.0 if progress is None else min(progress, 1.0)
        return max(pressing(self.model, self._force, self._pose), 0.0), part * self.force

    def _expected(self, progress: float) -> float:
        """m, the separation that the last equilibria lead to, of jaws that hold by force."""
        if self.force is None:
            return 0.0
        known = (self._separation(u) for _, u in self._history)
        return sum(w * s for w, s in zip(self._weights(progress), known, strict=True))

    def _predicted(self, progress: float | None, level: float) -> float:
        """m, the separation at which the jaws will press with this level, N, or nearly so."""
        if progress is not None and len(self._history) > 1:
            return self._expected(progress)
        more = level - pressing(self.model, self._force, self._pose)
        if abs(more) < 0.01 * level:
            return float(self._pose[3])
        return float(self._pose[3]) + more / closing(self.equilibrium, self._u, self._pose)[0]

    @property
    def displacements(self) -> Array:
        """(n,) m, all unknowns of the last good state, in the numbering of `model.prism`."""
        return self._u.copy()

    def greatest_strain(self, u: Array) -> float:
        """Of any point, in a shape u (n,) m; beside a jaw's edge it grows as the mesh becomes finer."""
        return max(float(strains.max()) for strains in self.model.assembly.strains(u))

    def state(self) -> TissueState:
        """What there is to see and to feel now."""
        start = time.perf_counter()
        model, jaws = self.model, to_jaws(self._pose)
        levels = np.array([model.positions(self._u, k) for k in range(model.prism.levels)])
        state = self._measures.state(self._u, jaws, model.reactions(self._force), levels, self._progress)
        self.seconds["measures"] += time.perf_counter() - start
        return state
