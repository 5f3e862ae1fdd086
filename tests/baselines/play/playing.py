"""`retract play` with a person made of events, for a process of its own: python playing.py HOW ARGUMENTS.

HOW: "quits" with the certificate, or is "interrupted" by Ctrl-C while the finite elements are at work. The
frames go to the screen that there is. Exits 77 where there is none.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator

import pygame

from baselines.cli import main
from baselines.play.session import Phase
from baselines.play.window import NoWindow, Window, check_screen
from tests.baselines.play.person import GRASP, STRAIGHT_UP, key, moved, wheel

NO_SCREEN = 77


def person(window: Window, how: str) -> Iterator[None]:
    """Acts before each frame."""
    game, post = window.game, pygame.event.post
    post(moved(window._screen.to_pixels(game.dealt.scene, GRASP, 0.002)))
    post(wheel(2))
    yield
    post(key(pygame.K_RETURN))
    yield
    for code in (pygame.K_DOWN, pygame.K_q):  # a mistake, taken back
        post(key(code))
    for _ in range(5):
        yield
    for code in (pygame.K_DOWN, pygame.K_q):
        post(key(code, down=False))
    post(key(pygame.K_u))
    post(key(pygame.K_u, down=False))
    yield
    for code in (pygame.K_UP, pygame.K_e):
        post(key(code))
    for _ in range(STRAIGHT_UP):
        yield
    post(key(pygame.K_RIGHT))
    while game.session.phase is Phase.MOVE:
        yield
    assert game.session.success, game.lines
    if how == "interrupted":
        os.kill(os.getpid(), signal.SIGINT)
        yield
    while "increments" in game.lines.detail or "follow" in game.lines.detail:
        yield
    post(key(pygame.K_ESCAPE))
    while True:
        yield


def play_as(how: str) -> Callable[..., None]:
    original = Window.play

    def play(self: Window, on_frame: Callable[[], None] = lambda: None) -> None:
        self._paced = False
        acting = person(self, how)
        next(acting)
        original(self, lambda: next(acting))

    return play


if __name__ == "__main__":
    try:
        check_screen()
    except NoWindow as problem:
        sys.stdout.write(f"{problem}\n")
        sys.exit(NO_SCREEN)
    Window.play = play_as(sys.argv[1])  # type: ignore[method-assign]
    sys.exit(main(["play", *sys.argv[2:]]))
