"""The pictures of the window in docs/play.md: python docs/images/play.py.

A person made of a few lines plays the flap with ten veins: half-way, and at the end with the certificate
and what planners do. No screen is needed; takes a minute.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ["SDL_VIDEODRIVER"] = "dummy"

import pygame
from PIL import Image

from baselines.play.aside import Aside
from baselines.play.game import Command, Drive, Game
from baselines.play.keeping import PlanFiles
from baselines.play.scenes import named_scene, random_scene
from baselines.play.screen import SIZE, Screen
from baselines.play.session import FRAMES, Phase

HERE = Path(__file__).resolve().parent
PLACE, FIRMER, STRAIGHT, HALF = -0.042, 0.1, 40, 60
"""m; of the range; frames straight up; frames until the first picture"""


def main() -> None:
    screen = Screen(pygame.Surface(SIZE))
    with tempfile.TemporaryDirectory() as folder:
        files, deal = PlanFiles(Path(folder) / "play.json"), lambda: random_scene(0)
        game = Game(named_scene("ten_veins"), deal, "rod", Aside(), Aside(), files)
        wait(game, lambda: bool(game.known.best))
        game.drive(Drive(place=PLACE, firmer=FIRMER))
        game.command(Command.CONFIRM)
        while game.session.phase is Phase.MOVE:
            if len(game.session) == HALF:
                keep(screen, game, "play_moving.png")
            game.drive(Drive(float(len(game.session) > STRAIGHT), 1.0, -1.0))
        wait(game, lambda: bool(game.written))
        keep(screen, game, "play.png")
        game.close()


def wait(game: Game, until: Callable[[], bool]) -> None:
    """Let what goes on aside come to an end."""
    while not until():
        game.tick()
        time.sleep(1 / FRAMES)


def keep(screen: Screen, game: Game, name: str) -> None:
    """Draw the game as it stands into a file."""
    screen.draw(game)
    image = Image.frombytes("RGB", SIZE, pygame.image.tobytes(screen.surface, "RGB"))
    image.quantize(256, dither=Image.Dither.NONE).save(HERE / name, optimize=True)


if __name__ == "__main__":
    main()
