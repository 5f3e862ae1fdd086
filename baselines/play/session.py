"""One retraction by hand, step by step in the environment: grasp, moves, back, and what came of it.

Nothing here knows of windows or keys. Whatever a person does is an action of the environment, at most one a
frame, so that the episode can be played again from its seed and its actions to the last bit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.play.scenes import Dealt
from retract_env.env import EnvState, TissueRetractEnv
from retract_env.grasp import Grasp, to_pose
from retract_env.physics.base import Restorable
from retract_env.rollout import Rollout
from retract_env.task import actions

Array = NDArray[np.float64]

FRAMES = 30
"""a second; a step of the environment is made in each, while the jaws move"""
SHARE = 0.1
"""Of the environment's largest move in one frame: 2 mm and 6 degrees, so that a held key moves the jaws by
6 mm/s and turns them by 18 degrees/s. A retraction of a flap 50 mm long is some 25 mm and 70 degrees: four
seconds in one go, time enough to see the friction rise and turn more."""
SLOW = 0.25
"""Of that speed, for what has to be done with care."""
STEPS = 1800
"""Steps of an episode: a minute of motion."""
TASK: dict[str, Any] = {"steps": STEPS}
"""What differs from the environment's own task."""
UNDONE = 1.0
"""Of the environment's largest move, that is taken back at once, at most, and at least one step."""


class Phase(Enum):
    """What the person is at."""

    GRASP = "grasp"
    MOVE = "move"
    BACK = "back"
    """the moves before those taken back are made again, as this physics cannot be put back"""
    ENDED = "ended"


@dataclass(frozen=True)
class _Mark:
    """Where to go back to: after so many steps."""

    steps: int
    state: EnvState | None
    """None where the physics cannot be put back"""


class Session:
    """A person's episode on one scene."""

    def __init__(self, env: TissueRetractEnv, dealt: Dealt):
        """env: of the scene's source, with TASK. The grasp proposed is in the middle, half-way firm."""
        self.env, self.dealt = env, dealt
        self.along, self.firmness = 0.0, 0.0
        """the first action of the environment"""
        self.restart()

    # --- The grasp

    def restart(self) -> None:
        """Begin anew with the flap at rest; the grasp is proposed where it was."""
        observation, info = self.env.reset(seed=self.dealt.seed)
        self.phase = Phase.GRASP
        self._observations, self._infos = [observation], [info]
        self._actions: list[NDArray[np.float32]] = []
        self._rewards: list[float] = []
        self._terminated = self._truncated = False
        self._marks: list[_Mark] = []
        self._still, self._since_mark = True, 0.0
        self._again: deque[NDArray[np.float32]] = deque()

    def propose(self, along: float | None = None, firmness: float | None = None) -> None:
        """Where to grasp, from -1, the free end, to 1, and how firmly, from -1, lightly, to 1."""
        if along is not None:
            self.along = min(max(along, -1.0), 1.0)
        if firmness is not None:
            self.firmness = min(max(firmness, -1.0), 1.0)

    @property
    def proposed(self) -> Grasp:
        """The grasp that `confirm` takes."""
        return actions.to_grasp(self._first(), self.dealt.scene, self.env.task_config)

    def propose_at(self, x: float) -> None:
        """Propose a grasp at a place along the flap, m, or the nearest that there is."""
        near, far = (
            actions.to_grasp((end, 0, 0), self.dealt.scene, self.env.task_config).x for end in (-1, 1)
        )
        self.propose(along=2 * (x - near) / (far - near) - 1)

    def _first(self) -> NDArray[np.float32]:
        return np.array([self.along, self.firmness, 0.0], np.float32)

    def confirm(self) -> None:
        """Close the jaws where it was proposed."""
        if self.phase is Phase.GRASP:
            self.phase = Phase.MOVE
            self._step(self._first())
            self._mark()

    # --- Moves

    @property
    def pose(self) -> Array:
        """(4,) x, y, theta, separation of the jaws now."""
        return to_pose(self.env.episode.now.state.jaws)

    def speed(self, slow: bool) -> Array:
        """(3,) m/s, m/s, rad/s that 1 stands for in a direction."""
        return np.asarray(self.env.task_config.move) * SHARE * FRAMES * (SLOW if slow else 1.0)

    def move(self, direction: ArrayLike, seconds: float = 1 / FRAMES, slow: bool = False) -> None:
        """Move the jaws for so long, by one action.

        direction: (3,) of x, y and turn, each in [-1, 1]; the length of the first two is at most 1, so that
        no way is faster than another. All 0 ends a move that is taken back as one.
        """
        wanted = np.clip(np.asarray(direction, np.float64), -1.0, 1.0)
        wanted[:2] /= max(1.0, float(np.hypot(*wanted[:2])))
        if self.phase is not Phase.MOVE or not wanted.any():
            self._still = True
            return
        share = np.clip(wanted * self.speed(slow) * seconds / self.env.task_config.move, -1.0, 1.0)
        part = max(float(np.hypot(share[0], share[1])), abs(float(share[2])))
        if self._still or self._since_mark + part > UNDONE * (1 + 1e-9):
            self._mark()
        self._still = False
        self._since_mark += part
        self._step(share.astype(np.float32))

    def move_towards(
        self, x: float, y: float, turn: float, seconds: float = 1 / FRAMES, slow: bool = False
    ) -> None:
        """Move the jaws' midpoint towards a place, m, at most as fast as `move` does; turn as there."""
        away = np.array([x, y]) - self.pose[:2]
        reach = self.speed(slow)[:2] * seconds
        wanted = away / reach
        if np.hypot(*wanted) < 0.02:  # there, but for what nobody sees
            wanted[:] = 0.0
        self.move([*(wanted / max(1.0, float(np.hypot(*wanted)))), turn], seconds, slow)

    def _step(self, action: NDArray[np.float32]) -> None:
        observation, reward, self._terminated, self._truncated, info = self.env.step(action)
        self._actions.append(action)
        self._observations.append(observation)
        self._rewards.append(float(reward))
        self._infos.append(info)
        if self._terminated or self._truncated:
            self.phase = Phase.ENDED

    # --- Back

    @property
    def restorable(self) -> bool:
        """Whether the physics can be put back; else the moves are made again from the grasp on."""
        return isinstance(self.env.episode.physics, Restorable)

    def _mark(self) -> None:
        if self.phase is Phase.MOVE and (not self._marks or self._marks[-1].steps < len(self._actions)):
            state = self.env.get_state() if self.restorable else None
            self._marks.append(_Mark(len(self._actions), state))
        self._since_mark = 0.0

    def undo(self) -> bool:
        """Take back the last move, or the grasp where nothing has moved; returns whether there was one.

        What has ended well stays.
        """
        if self.phase in (Phase.GRASP, Phase.BACK) or self.success:
            return False
        while self._marks and self._marks[-1].steps >= len(self._actions):
            self._marks.pop()
        if not self._marks:
            self.restart()
            return True
        mark = self._marks[-1]
        if mark.state is not None:
            self._forget(mark.steps)
            self.env.set_state(mark.state)
            self.phase = Phase.MOVE
        else:
            marks, again = self._marks, self._actions[: mark.steps]
            self.restart()
            self._marks, self._again, self.phase = marks, deque(again), Phase.BACK
        self._still, self._since_mark = True, 0.0
        return True

    def go_on(self) -> None:
        """In the phase BACK, make the next of the moves again."""
        if self.phase is Phase.BACK:
            self._step(self._again.popleft())
            if self.phase is Phase.BACK and not self._again:
                self.phase = Phase.MOVE

    def _forget(self, steps: int) -> None:
        """All after so many steps."""
        del self._actions[steps:], self._rewards[steps:]
        del self._observations[steps + 1 :], self._infos[steps + 1 :]
        self._terminated = self._truncated = False

    # --- What came of it

    def __len__(self) -> int:
        """Steps so far."""
        return len(self._actions)

    @property
    def success(self) -> bool:
        """Whether the target is in view and no limit was broken."""
        return bool(self._infos[-1]["is_success"])

    @property
    def failure(self) -> str:
        """What ended it otherwise: the limit's name, "diverged", or "time"; "" while it goes on."""
        if self.phase is not Phase.ENDED or self.success:
            return ""
        return str(self._infos[-1]["failure"]) or "time"

    @property
    def played(self) -> Rollout:
        """The episode so far."""
        return Rollout(
            np.stack(self._observations),
            np.array(self._actions).reshape(-1, actions.SIZE),
            np.array(self._rewards),
            tuple(self._infos),
            self._terminated,
            self._truncated,
        )
