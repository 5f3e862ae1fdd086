"""The loop: events in, a frame out, thirty times a second."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable

import pygame

from baselines.play.controls import Controls
from baselines.play.game import Command, Game
from baselines.play.screen import SIZE, Screen
from baselines.play.session import FRAMES, Phase
from retract_env.errors import ConfigError

TITLE = "retract play: lift the tissue out of the camera's sight"
LONGEST = 1 / 3
"""s that a frame stands for at most, so that jaws do not leap where a slow physics keeps them waiting. At the
usual speed that is the environment's largest move."""
COUNTED = 15
"""Frames from which it is told how many there are a second."""
UNSEEN = ("dummy", "offscreen")
"""SDL's drivers without a screen. Where there is none it may take one by itself, and nobody sees a thing."""


class NoWindow(ConfigError):
    """There is no screen; the message is one line."""


class Window:
    """A game in a window. Whoever makes one closes it."""

    def __init__(self, game: Game, paced: bool = True):
        """paced: keeps to FRAMES a second; else as fast as it goes, each frame standing for as long as it
        should take. Raises NoWindow."""
        self.game = game
        Screen(pygame.Surface(SIZE)).draw(game)  # once before it opens: a first run compiles what draws
        self._surface = _opened()
        pygame.display.set_caption(TITLE)
        pygame.joystick.init()
        self._paced = paced
        self._clock = pygame.time.Clock()
        self._passed: deque[float] = deque([1 / FRAMES], COUNTED)
        self._screen = Screen(self._surface)
        self._controls = Controls(lambda place: Screen.to_metres(game.dealt.scene, place))

    @property
    def frames(self) -> float:
        """A second, at present."""
        return len(self._passed) / max(sum(self._passed), 1e-3)

    def frame(self, events: Iterable[pygame.event.Event] | None = None) -> None:
        """One round: what was asked for, one step, a picture. events: pygame's own if not given.

        Raises OSError where something cannot be written.
        """
        game, controls = self.game, self._controls
        passed = self._clock.tick(FRAMES if self._paced else 0) / 1e3
        self._passed.append(passed)
        usual = 1 / FRAMES
        # what is a little late moves no farther: equal moves make a straight path
        seconds = usual if passed < 1.5 * usual or not self._paced else min(passed, LONGEST)
        choosing = game.session.phase is Phase.GRASP
        for event in pygame.event.get() if events is None else events:
            self._do(controls.read(event, choosing), seconds, choosing)
        self._do(controls.repeated(seconds), seconds, choosing)
        if not game.over:
            self._drive(seconds, game.session.phase is Phase.GRASP)
            game.tick()
            self._screen.draw(game, controls.has_pad, self.frames)
            pygame.display.flip()

    def _do(self, command: Command | None, seconds: float, choosing: bool) -> None:
        if command is Command.CONFIRM and choosing:
            self._drive(seconds, True)  # where a click points counts
        if command is not None:
            self.game.command(command)

    def _drive(self, seconds: float, choosing: bool) -> None:
        session = self.game.session
        turn_speed = float(session.speed(False)[2])
        self.game.drive(self._controls.drive(session.pose, turn_speed, seconds, choosing), seconds)

    def play(self, on_frame: Callable[[], None] = lambda: None) -> None:
        """Until the person quits; on_frame is called after each frame."""
        while not self.game.over:
            self.frame()
            on_frame()

    def close(self) -> None:
        """Close the window; again does no harm."""
        pygame.joystick.quit()
        pygame.display.quit()


def check_screen() -> None:
    """Raise NoWindow where there is no screen to open a window on."""
    try:
        pygame.display.init()
    except pygame.error as problem:
        raise NoWindow(f"no window can be opened: {str(problem).lower()}") from None
    if pygame.display.get_driver() in UNSEEN and "SDL_VIDEODRIVER" not in os.environ:
        pygame.display.quit()
        raise NoWindow("no window can be opened: there is no screen")


def _opened() -> pygame.Surface:
    """A window's surface of SIZE. Raises NoWindow."""
    check_screen()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a screen without a fast renderer does
            return pygame.display.set_mode(SIZE, pygame.SCALED | pygame.RESIZABLE)
    except pygame.error as problem:
        pygame.display.quit()
        raise NoWindow(f"no window can be opened: {str(problem).lower()}") from None
