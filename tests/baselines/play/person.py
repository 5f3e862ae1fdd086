"""A person made of events, and workers that answer at once, for the tests of the game."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pygame

from baselines.play.aside import Said, Work
from baselines.play.game import Game
from baselines.play.keeping import PlanFiles, Recorder
from baselines.play.scenes import Dealt, named_scene
from baselines.play.session import TASK, Phase, Session
from retract_env.env import TissueRetractEnv

GRASP, FIRM = -0.042, 0.1
"""m, and of the range: a grasp on the flap with ten veins that holds for what `retract` does"""
STRAIGHT_UP = 40
"""frames"""


def session(physics: str = "rod", name: str = "ten_veins") -> Session:
    dealt = named_scene(name)
    return Session(TissueRetractEnv(physics, scene=dealt.source, task=TASK), dealt)


def closed(**kwargs: str) -> Session:
    """With jaws that have taken hold."""
    begun = session(**kwargs)
    begun.propose_at(GRASP)
    begun.propose(firmness=FIRM)
    begun.confirm()
    return begun


def directions() -> Iterator[tuple[int, int, int]]:
    """Of each frame of a retraction that succeeds: up, then to the fixed end too, turning all the time."""
    for frame in range(1000):
        yield (0 if frame < STRAIGHT_UP else 1), 1, -1


def retract(begun: Session) -> Session:
    """To its end."""
    for direction in directions():
        if begun.phase is not Phase.MOVE:
            break
        begun.move(direction)
    return begun


class Answering:
    """A worker that has the answer as soon as it is asked: from a table, or by doing the work here."""

    def __init__(self, table: dict[str, Said] | None = None):
        """table: by the planner's name; None: the work is done."""
        self.table, self.busy = table, False
        self.asked: list[str] = []
        self._said: list[Said] = []

    def start(self) -> None: ...

    def ask(self, work: Work, argument: Any) -> None:
        self.asked.append(work.__name__)
        self.busy = True
        if self.table is None:
            answer = work(argument, lambda value: self._said.append(Said("progress", value)))
            self._said.append(Said("done", answer))
        elif argument["planner"] in self.table:
            self._said.append(self.table[argument["planner"]])

    def poll(self) -> list[Said]:
        said, self._said = self._said, []
        if said and said[-1].kind != "progress":
            self.busy = False
        return said

    def close(self) -> None:
        self.busy, self._said = False, []


SILENT: dict[str, Said] = {}
"""A table for a worker that never answers."""
RIVALS = {"ctc": Said("done", {"strain": 0.2571}), "swift": Said("done", {"strain": 0.1102})}


def game(
    folder: Path,
    judge: Answering | None = None,
    rival: Answering | None = None,
    dealt: Dealt | None = None,
    recorder: Recorder | None = None,
    **more: Any,
) -> Game:
    return Game(
        named_scene("ten_veins") if dealt is None else dealt,
        more.get("deal"),
        "rod",
        Answering(SILENT) if judge is None else judge,
        Answering(SILENT) if rival is None else rival,
        PlanFiles(folder / "play.json"),
        recorder,
        more.get("resolution", "coarse"),
    )


def key(code: int, down: bool = True) -> pygame.event.Event:
    return pygame.event.Event(pygame.KEYDOWN if down else pygame.KEYUP, key=code)


def moved(place: tuple[int, int]) -> pygame.event.Event:
    return pygame.event.Event(pygame.MOUSEMOTION, pos=place, rel=(0, 0), buttons=(0, 0, 0))


def button(place: tuple[int, int], down: bool = True) -> pygame.event.Event:
    kind = pygame.MOUSEBUTTONDOWN if down else pygame.MOUSEBUTTONUP
    return pygame.event.Event(kind, pos=place, button=1)


def wheel(notches: int) -> pygame.event.Event:
    return pygame.event.Event(pygame.MOUSEWHEEL, x=0, y=notches)
