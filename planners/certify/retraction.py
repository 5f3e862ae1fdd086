"""A retraction under way on the finite elements: the jaws close, then follow their path. Sec. III-C, IV-A.

The path is followed in increments; after each the three objectives are measured. It ends at success or at the
first broken limit. Then the flap is looked at between increments, wherever its greatest strain or needed
friction may be greater there than a tolerance (`peaks`), so that more increments would change no verdict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.certify.peaks import PEELED, doubtful
from retract_env.errors import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, patch_ends
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics, FemState
from retract_env.scene import Limits, Scene

SQUEEZE_INCREMENTS = 4
LONGEST_STEP = 2.5e-3
"""m, farthest that a jaw moves in one increment; longer steps between waypoints are divided."""
ON_TIME = 2e-5
"""m, the moment of visibility is met within this clearance."""
MOST_TIMINGS = 12
"""Equilibria, at most, in search of that moment; tissue that snaps past the line never meets it."""
MOST_HALVINGS = 6
"""How often an increment is halved to tell which of several things came first."""
STRAIN_TOLERANCE = 5e-3
"""The greatest eps_1% along the path is known to this part of it."""
FRICTION_TOLERANCE = 3e-3
"""The greatest needed friction along the path is known to this."""
MOST_LOOKS = 120
"""Equilibria between increments; a retraction that jumps about more than these can follow has diverged."""
FARTHEST = 10.0
"""m, from the origin, that a path may lead; jaws as far away as that hold nothing any more."""
TORN = 2.0
"""Strain of a piece of tissue, three times as long as at rest, that nothing soft survives: elastin breaks at
1.5 (Gosline et al. 2002, Table 1). No limit, as beside a rigid pad's edge it grows with the mesh; but where
no equilibrium is found it says why."""
LOST = ("torn", "diverged")
"""Reasons of retractions for which no further equilibrium is found."""


@dataclass(frozen=True, repr=False, eq=False)
class Closed:
    """A flap between closed jaws, before any motion: all paths that begin with this grip go on from it."""

    frames: tuple[TissueState, ...]
    shapes: tuple[NDArray[np.float64], ...] = ()
    """(n,) m, displacements of each frame"""
    state: FemState | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    """of the solver's work so far"""


class Retraction:
    """One retraction under way: squeeze it, then move it. From any thread, one call at a time.

    Planners that try things own retractions, at whatever limits help them; certificates come from `Trial`.
    """

    def __init__(
        self,
        scene: Scene,
        grasp: Grasp,
        path: JawPath,
        resolution: str = "fine",
        limits: Limits | None = None,
        division: int = 1,
    ):
        """limits: at which it ends, None: the scene's; division: of each increment of the motion into parts.

        Raises ValueError: grasp off the flap, path that does not begin there, or unknown resolution.
        """
        if resolution not in RESOLUTIONS:
            raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(RESOLUTIONS)}")
        grasp.check_inside(scene.tissue.length, scene.tissue.height)
        patch_ends(scene, grasp.x)
        # Squeezed in place too: the closing jaws are not judged, so no motion may hide there.
        height = scene.tissue.height
        closed = grasp.compression if grasp.force is None else height - float(path.poses[1, 3])
        for row, gap, state in ((0, 0.0, "at rest"), (1, closed / 2, "squeezed")):
            start = np.array([grasp.x, gap, grasp.x, height - gap])
            if not np.allclose(path.waypoints[row], start, rtol=0, atol=1e-6 * scene.tissue.length):
                found = path.waypoints[row].tolist()
                raise ValueError(
                    f"path.waypoints[{row}] = {found} m, allowed the grasp {state} {start.tolist()} m"
                )
        far = float(np.abs(path.waypoints).max())
        if far > FARTHEST:
            raise ValueError(f"path.waypoints reach {far:g} m from the fixed end, allowed {FARTHEST:g} m")
        self.scene, self.grasp, self.path, self.resolution = scene, grasp, path, resolution
        self.limits = scene.limits if limits is None else limits
        self.division = division
        self.frames: list[TissueState] = []
        """states so far, by progress"""
        self._shapes: list[NDArray[np.float64]] = []
        """displacements of each frame while the retraction is under way"""
        self.reason: str | None = None
        """why it ended, one of REASONS or "pruned"; None until that is final"""
        self.max_strain = 0.0
        self.required_friction = 0.0
        self.physics: FemPhysics | None = None

    @property
    def ended(self) -> bool:
        """Whether it is final what became of it."""
        return self.reason is not None

    @property
    def clearance(self) -> float:
        """m, in the last frame; nan before the first."""
        return self.frames[-1].clearance if self.frames else math.nan

    def squeeze(self, on_increment: Callable[[], None] = lambda: None) -> None:
        """Mesh the flap, let it rest on its bed and close the jaws; starts anew when called again.

        The strain of the squeeze bounds that of the whole retraction from below. on_increment: called after
        each increment; what it raises ends the squeeze. Raises MeshError.
        """
        self.physics = physics = self._physics()
        self.reason, self.max_strain, self.required_friction = None, 0.0, 0.0
        found: str | None = None
        try:
            first = physics.reset()
        except Diverged:
            first = physics.state()  # under a part of its weight, which may tear it already
            found = "strain" if first.worst_strain > self.limits.strain else self._lost(physics.displacements)
        self.frames, self._shapes = [first], [physics.displacements]
        self._measure(first)
        for part in np.linspace(0, 1, SQUEEZE_INCREMENTS + 1)[1:]:
            if found in (None, "ok"):
                found = self._advance(float(part))
                on_increment()
        physics.turn()
        self.reason = None if found == "ok" else found  # success is for `move` to say

    def closed(self, lasting: bool = True) -> Closed:
        """What `squeeze` came to; lasting: with all that `go_on` needs."""
        assert self.physics is not None and not self.ended, "squeeze first"
        if not lasting:
            return Closed(tuple(self.frames))
        counts = dict(self.physics.equilibrium.counts)
        return Closed(tuple(self.frames), tuple(self._shapes), self.physics.get_state(), counts)

    def close_as(self, closed: Closed) -> None:
        """What `squeeze` would find, without a mesh; then `go_on` before `move`."""
        self.physics, self.reason, self.max_strain, self.required_friction = None, None, 0.0, 0.0
        self.frames, self._shapes = list(closed.frames), list(closed.shapes)
        for state in self.frames:
            self._measure(state)

    def go_on(self, closed: Closed) -> None:
        """As after `squeeze`, to the same bits, where the jaws were closed alike."""
        assert closed.state is not None, "what does not last cannot go on"
        self.close_as(closed)
        self.physics = self._physics()
        self.physics.set_state(closed.state)
        self.physics.equilibrium.counts.update(closed.counts)

    def _physics(self) -> FemPhysics:
        """A motion that cannot be made whole ends where it breaks a limit on the way."""
        limits = self.limits
        return FemPhysics(
            self.scene,
            self.grasp.x,
            self.resolution,
            lambda state: state.verdict(limits) not in (None, "ok"),
            self.grasp.force,
        )

    def move(
        self, bound: Callable[[], float] = lambda: math.inf, on_increment: Callable[[], None] = lambda: None
    ) -> None:
        """Follow the path to success, a broken limit, or its end.

        bound: asked before each increment; a strain above it ends the retraction with the reason "pruned".
        on_increment: called after each; what it raises ends the motion.
        """
        assert self.physics is not None, "squeeze first"
        if self.ended:
            return
        found: str | None = None
        whole = [1.0]
        for target in self._increments():
            if self.max_strain > bound():
                self.reason = "pruned"
                return
            found = self._advance(target)
            if found is not None and found not in LOST:
                found = self._first()
            whole.append(self.frames[-1].progress)
            on_increment()
            if found is not None:
                break
        found = self._looked_between(found or "not_visible", whole, on_increment)
        self._shapes = []
        self.reason = found

    def history(self) -> dict[str, list[Any]]:
        """What a certificate tells of each frame."""
        frames = self.frames
        return {
            "progress": [f.progress for f in frames],
            "strain": [f.worst_strain for f in frames],
            "worst_at": [f.worst_at.tolist() for f in frames],
            "friction": [f.required_friction.tolist() if f.progress >= 1 else [0.0, 0.0] for f in frames],
            "reactions": [f.reactions.tolist() for f in frames],
            "clearance": [f.clearance for f in frames],
            "jaws": [f.jaws.tolist() for f in frames],
        }

    def _increments(self) -> Iterator[float]:
        """Progress at each increment of the motion: every waypoint, long steps divided."""
        jaws = self.path.waypoints
        for k in range(2, len(jaws)):
            step = np.abs(jaws[k] - jaws[k - 1]).reshape(2, 2)
            pieces = max(1, math.ceil(float(np.hypot(*step.T).max()) / LONGEST_STEP)) * self.division
            for i in range(pieces):
                yield k - 1 + (i + 1) / pieces

    def _advance(self, progress: float) -> str | None:
        """Move the jaws on; what that state comes to, or one of LOST."""
        assert self.physics is not None
        try:
            state = self.physics.move_to(self.path.pose_at(progress), progress)
        except Diverged:
            return self._lost(self.physics.displacements)
        self._put(len(self.frames), state, self.physics.displacements)
        return state.verdict(self.limits)

    def _lost(self, shape: NDArray[np.float64]) -> str:
        """Why there is no equilibrium after that of a shape (n,) m, one of LOST."""
        assert self.physics is not None
        return "torn" if self.physics.greatest_strain(shape) > TORN else "diverged"

    def _put(self, place: int, state: TissueState, shape: NDArray[np.float64]) -> None:
        self.frames.insert(place, state)
        self._shapes.insert(place, shape)
        self._measure(state)

    def _measure(self, state: TissueState) -> None:
        self.max_strain = max(self.max_strain, state.worst_strain)
        self.required_friction = max(self.required_friction, state.asked_friction)

    def _cut(self, count: int) -> None:
        """Forget all but the first `count` frames."""
        del self.frames[count:], self._shapes[count:]
        self.max_strain = self.required_friction = 0.0
        for state in self.frames:
            self._measure(state)

    def _events(self, state: TissueState) -> int:
        """How many things have happened in a state, any of which ends a retraction."""
        limits = self.limits
        return (
            (state.worst_strain > limits.strain)
            + (state.asked_friction > limits.friction)
            + state.overlap
            + (state.clearance >= limits.clearance)
        )

    def _first(self) -> str | None:
        """What ended the retraction, the last increment cut down to where that alone has happened."""
        for _ in range(MOST_HALVINGS):
            if self._events(self.frames[-1]) < 2:
                break
            place = len(self.frames) - 1
            try:
                state, shape = self._between(place)
            except Diverged:
                break
            if self._events(state):
                self._cut(place)
            self._put(place, state, shape)
        found = self.frames[-1].verdict(self.limits)
        return self._time_visibility() if found == "ok" else found

    def _between(self, place: int) -> tuple[TissueState, NDArray[np.float64]]:
        """State and displacements half-way to a place from the frame before it. Raises Diverged."""
        assert self.physics is not None
        before, after = self.frames[place - 1], self.frames[place]
        progress = (before.progress + after.progress) / 2
        pose = self.path.pose_at(progress)
        known = [(f.progress, u) for f, u in zip(self.frames, self._shapes, strict=True) if f.progress >= 1]
        return self.physics.between(known, self.path.pose_at(before.progress), pose, progress)

    def _time_visibility(self) -> str:
        """Shorten the last increment until the tissue has just cleared the line (regula falsi, Illinois).

        The retraction ends on the first state seen to clear it, unless a limit breaks before.
        """
        assert self.physics is not None
        limit = self.limits.clearance
        seen, shape = self.frames[-1], self._shapes[-1]
        hidden = self.frames[-2]
        self._cut(len(self.frames) - 1)
        # distances to the middle of what is on time; an end that stays is halved, lest it stay for good
        goal = limit + ON_TIME / 2
        low, high = hidden.clearance - goal, seen.clearance - goal
        moved = ""
        for _ in range(MOST_TIMINGS):
            if seen.clearance <= limit + ON_TIME:
                break
            part = min(0.95, max(0.05, low / (low - high)))
            progress = hidden.progress + (seen.progress - hidden.progress) * part
            found = self._advance(progress)
            if found in LOST:  # what was reached counts
                break
            if found not in (None, "ok"):
                return str(found)
            state = self.frames[-1]
            if found == "ok":
                seen, shape, high = state, self._shapes[-1], state.clearance - goal
                self._cut(len(self.frames) - 1)
                low = low / 2 if moved == "seen" else low
                moved = "seen"
            else:
                hidden, low = state, state.clearance - goal
                high = high / 2 if moved == "hidden" else high
                moved = "hidden"
        self._put(len(self.frames), seen, shape)
        return "ok"

    def _looked_between(self, found: str, whole: list[float], on_increment: Callable[[], None]) -> str:
        """What the retraction came to once no peak hides between its frames any more.

        whole: progress at the increments; found: what it came to at those.
        """
        assert self.physics is not None
        end = self.frames[-1].progress
        for _ in range(MOST_LOOKS):
            place = self._doubt(found, whole)
            if place is None:
                if self.frames[-1].progress != end:
                    last = self.frames[-1]
                    self.physics.resume(self.path.pose_at(last.progress), last.progress, self._shapes[-1])
                return found
            try:
                state, shape = self._between(place)
            except Diverged:
                self._cut(place)
                return self._lost(self._shapes[-1])
            self._put(place, state, shape)
            on_increment()
            if state.verdict(self.limits) is not None:
                self._cut(place + 1)
                self.physics.resume(self.path.pose_at(state.progress), state.progress, shape)
                found = str(self._first())
        return "diverged"

    def _doubt(self, found: str, whole: list[float]) -> int | None:
        """The frame before which more may hide than is tolerated; None where nothing does."""
        begin = next((i for i, f in enumerate(self.frames) if f.progress >= 1), len(self.frames))
        frames, limits = self.frames[begin:], self.limits
        if len(frames) < 2:
            return None
        at = np.array([f.progress for f in frames])
        lying = np.array([self._lying(f) for f in frames])
        steps = set(pairwise(whole))
        for i, change in enumerate(np.abs(np.diff(lying))):
            if change > PEELED and (at[i], at[i + 1]) in steps:
                return begin + i + 1

        # no need to know how far beyond a limit, nor beyond what double would tell
        friction = np.array([np.minimum(f.required_friction, 2 * limits.friction) for f in frames])
        strain = np.array([f.worst_strain for f in frames])
        known_to = _known_to(float(friction.max()), FRICTION_TOLERANCE, limits.friction)
        looks = [(friction[:, 0], known_to), (friction[:, 1], known_to)]
        known_to = _known_to(self.max_strain, STRAIN_TOLERANCE * self.max_strain, limits.strain)
        looks.append((strain, known_to))
        for values, most in looks:
            if (doubt := doubtful(at, values, most)) is not None:
                return begin + doubt + 1
        hidden = len(frames) - (found == "ok")  # that the last one is seen is known
        clearance = np.array([f.clearance for f in frames[:hidden]])
        doubt = doubtful(at[:hidden], clearance, limits.clearance + ON_TIME)
        return None if doubt is None else begin + doubt + 1

    def _lying(self, state: TissueState) -> float:
        """Part of the flap's length that lies on the bed."""
        if not self.scene.bed:
            return 0.0
        assert self.physics is not None
        section = self.physics.section
        low = state.points[section.bottom, 1] < 0
        return float(section.bottom_length[low].sum()) / self.scene.tissue.length


def _known_to(greatest: float, tolerance: float, limit: float) -> float:
    """What a quantity may reach unseen: within the tolerance, but never past its limit."""
    return greatest + tolerance if greatest > limit else min(greatest + tolerance, limit)
