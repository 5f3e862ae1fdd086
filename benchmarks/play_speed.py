"""Speed of `retract play`: python -m benchmarks.play_speed [--physics rod fem bullet].

The same keys retract the flap with ten veins in the window, as fast as it goes: 40 frames straight up, then
towards the fixed end too, turning all the time, at most FRAMES in all. Where there is a screen it is drawn
there, else on SDL's driver without one. Each line says how many frames a second that is, certificates and
planners aside, and what of a frame's time the physics and the drawing take: wall-clock. On a busy machine the
processor's time that a frame takes says more.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pygame

from baselines.play.aside import Said
from baselines.play.game import Game
from baselines.play.keeping import PlanFiles
from baselines.play.scenes import named_scene
from baselines.play.session import Phase
from baselines.play.window import NoWindow, Window, check_screen
from benchmarks._report import machine, progress, table

SCENE, PLACE, FIRMNESS = "ten_veins", -0.042, 0.1
"""The flap, where it is grasped, m, and how firmly, of the range."""
STRAIGHT, FRAMES = 40, 200


class Nobody:
    """Computes nothing aside."""

    busy = False

    def start(self) -> None: ...
    def ask(self, work: Any, argument: Any) -> None: ...
    def close(self) -> None: ...

    def poll(self) -> list[Said]:
        return []


class Stopwatch:
    """ms of every call of a function."""

    def __init__(self, function: Callable[..., Any]):
        self.function = function
        self.spent: list[float] = []

    def __call__(self, *arguments: Any) -> Any:
        start = time.perf_counter()
        found = self.function(*arguments)
        self.spent.append(1e3 * (time.perf_counter() - start))
        return found


def measure(physics: str, folder: Path) -> list[object]:
    """A row of the table."""
    progress(physics)
    game = Game(named_scene(SCENE), None, physics, Nobody(), Nobody(), PlanFiles(folder / "play.json"))
    window = Window(game, paced=False)
    session = game.session
    session.propose_at(PLACE)
    session.propose(firmness=FIRMNESS)
    session.confirm()
    window.frame([])  # the first one of a flap takes longer
    step = Stopwatch(game.session.env.step)
    draw = Stopwatch(window._screen.draw)
    setattr(game.session.env, "step", step)  # noqa: B010
    setattr(window._screen, "draw", draw)  # noqa: B010
    held = [pygame.K_UP, pygame.K_e]
    frames: list[float] = []
    begun = time.process_time()
    for number in range(FRAMES):
        down = held if number == 0 else [pygame.K_RIGHT] if number == STRAIGHT else []
        start = time.perf_counter()
        window.frame([pygame.event.Event(pygame.KEYDOWN, key=key) for key in down])
        frames.append(1e3 * (time.perf_counter() - start))
        if session.phase is not Phase.MOVE:
            break
    processor = 1e3 * (time.process_time() - begun) / len(frames)
    window.close()
    game.close()
    times = [float(np.median(spent)) for spent in (step.spent, draw.spent)]
    return [
        physics,
        len(frames),
        1e3 / float(np.mean(frames)),
        processor,
        *times,
        float(np.percentile(frames, 95)),
        session.failure or ("in view" if session.success else "under way"),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--physics", nargs="+", default=["rod", "fem"])
    physics = parser.parse_args().physics
    try:
        check_screen()
    except NoWindow:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
    print(machine())
    head = [
        "physics",
        "frames",
        "frames/s",
        "processor, ms",
        "step, ms",
        "drawing, ms",
        "95 % within, ms",
        "ended",
    ]
    with tempfile.TemporaryDirectory() as folder:
        print(table(head, [measure(name, Path(folder)) for name in physics]))


if __name__ == "__main__":
    main()
