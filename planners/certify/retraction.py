"""A retraction under way on the finite elements: the jaws close, then follow their path. Sec. III-C, IV-A.

The path is followed in increments; after each the three objectives are measured. It ends at success or at the
first broken limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from retract_env.errors import Diverged
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, patch_ends
from retract_env.objectives import verdict
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Limits, Scene

SQUEEZE_INCREMENTS = 4
LONGEST_STEP = 2.5e-3
"""m, farthest that a jaw moves in one increment; longer steps between waypoints are divided."""
ON_TIME = 2e-5
"""m, the moment of visibility is met within this clearance."""
MOST_TIMINGS = 12
"""Solutions spent on that moment; tissue that snaps past the line never meets it."""
FARTHEST = 10.0
"""m, from the origin, that a path may lead; jaws as far away as that hold nothing any more."""


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
    ):
        """limits: at which it ends, None: the scene's.

        Raises ValueError: grasp off the flap, path that does not begin there, or unknown resolution.
        """
        if resolution not in RESOLUTIONS:
            raise ValueError(f"resolution = {resolution!r}, allowed {', '.join(RESOLUTIONS)}")
        grasp.check_inside(scene.tissue.length, scene.tissue.height)
        patch_ends(scene, grasp.x)
        # Squeezed in place too: the closing jaws are not judged, so no motion may hide there.
        height, half = scene.tissue.height, grasp.compression / 2
        for row, gap, state in ((0, 0.0, "at rest"), (1, half, "squeezed")):
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
        self.frames: list[TissueState] = []
        self.reason: str | None = None
        self.max_strain = 0.0
        self.required_friction = 0.0
        self.physics: FemPhysics | None = None

    @property
    def ended(self) -> bool:
        return self.reason is not None

    @property
    def clearance(self) -> float:
        return self.frames[-1].clearance if self.frames else math.nan

    def squeeze(self, on_increment: Callable[[], None] = lambda: None) -> None:
        """Mesh the flap, let it rest on its bed and close the jaws; starts anew when called again.

        The strain of the squeeze bounds that of the whole retraction from below. on_increment: called after
        each increment; what it raises ends the squeeze. Raises MeshError.
        """
        self.physics = FemPhysics(self.scene, self.grasp.x, self.resolution)
        self.frames = [self.physics.state()]
        self.reason, self.max_strain, self.required_friction = None, 0.0, 0.0
        try:
            self.frames = [self.physics.reset()]
        except Diverged:
            self.reason = "diverged"
        for part in np.linspace(0, 1, SQUEEZE_INCREMENTS + 1)[1:]:
            if not self.ended:
                self._advance(float(part))
                on_increment()
        self.physics.turn()

    def move(
        self, bound: Callable[[], float] = lambda: math.inf, on_increment: Callable[[], None] = lambda: None
    ) -> None:
        """Follow the path to success, a broken limit, or its end.

        bound: asked after each increment; a strain above it ends the trial with the reason "pruned".
        """
        assert self.physics is not None, "squeeze first"
        for target in self._increments():
            if self.ended:
                return
            if self.max_strain > bound():
                self.reason = "pruned"
                return
            before = self.frames[-1]
            self._advance(target)
            if self.reason != "diverged" and self.clearance >= 0:
                self._time_visibility(before)
                self.reason = self.reason or "ok"
            on_increment()
        self.reason = self.reason or "not_visible"

    def _increments(self) -> Iterator[float]:
        """Progress at each increment of the motion: every waypoint, long steps divided."""
        jaws = self.path.waypoints
        for k in range(2, len(jaws)):
            step = np.abs(jaws[k] - jaws[k - 1]).reshape(2, 2)
            pieces = max(1, math.ceil(float(np.hypot(*step.T).max()) / LONGEST_STEP))
            for i in range(pieces):
                yield k - 1 + (i + 1) / pieces

    def _advance(self, progress: float) -> None:
        assert self.physics is not None
        try:
            state = self.physics.move_to(self.path.pose_at(progress), progress)
        except Diverged:
            self.reason = "diverged"
            return
        self._judge(state)

    def _judge(self, state: TissueState) -> None:
        limits = self.limits
        self.frames.append(state)
        self.max_strain = max(self.max_strain, state.max_strain)
        friction = 0.0
        if state.progress >= 1:  # security is asked of closed jaws
            friction = float(state.required_friction.max())
            self.required_friction = max(self.required_friction, friction)
        found = verdict(state.max_strain, friction, state.clearance, limits.strain, limits.friction)
        if found != "ok":  # success is for `move` to say, once it is on time
            self.reason = found

    def _time_visibility(self, hidden: TissueState) -> None:
        """Shorten the last increment until the tissue has just cleared the line (regula falsi, Illinois).

        The trial ends on the first state seen to clear it, unless a limit breaks before.
        """
        seen = self.frames[-1]
        # distances to the middle of what is on time; an end that stays is halved, lest it stay for good
        low, high = hidden.clearance - ON_TIME / 2, seen.clearance - ON_TIME / 2
        moved = ""
        for _ in range(MOST_TIMINGS):
            if seen.clearance <= ON_TIME:
                return
            self._take_back()
            part = min(0.95, max(0.05, low / (low - high)))
            self._advance(hidden.progress + (seen.progress - hidden.progress) * part)
            if self.reason == "diverged":  # what was reached counts
                self.reason = None
                self._judge(seen)
                return
            state = self.frames[-1]
            if state.clearance >= 0:
                seen, high = state, state.clearance - ON_TIME / 2
                low = low / 2 if moved == "seen" else low
                moved = "seen"
            elif self.ended:
                return
            else:
                hidden, low = state, state.clearance - ON_TIME / 2
                high = high / 2 if moved == "hidden" else high
                moved = "hidden"
                self._judge(seen)

    def _take_back(self) -> None:
        """Forget the last state and its verdict."""
        self.frames.pop()
        self.reason = None
        self.max_strain = max(f.max_strain for f in self.frames)
        self.required_friction = max(
            (float(f.required_friction.max()) for f in self.frames if f.progress >= 1), default=0.0
        )
