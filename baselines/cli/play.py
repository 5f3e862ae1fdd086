"""`retract play`: a person retracts the tissue."""

from __future__ import annotations

import itertools
import random
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from baselines.cli.console import BadInput, announce_compilation, exit_codes, usable_folder
from baselines.cli.verdict import ResolutionOption
from baselines.cli.work import RUNS, check_physics, command_line, expected

if TYPE_CHECKING:
    from baselines.play.game import Game
    from baselines.play.keeping import Recorder
    from baselines.play.scenes import Dealt

MOST = 100_000
"""Random scenes to choose from where no seed is given."""


def play_command(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="[SCENE]",
            help="A scene in YAML, the name of a shipped one, or one of the benchmark's as test:7; a random "
            "one if not given.",
        ),
    ] = "",
    physics: Annotated[
        str, typer.Option(help="That moves while you play: rod, fem, bullet, or one that was added.")
    ] = "rod",
    record: Annotated[
        str,
        typer.Option(metavar="DATASET", help="Name of a Minari data set to make of what ends with success."),
    ] = "",
    out: Annotated[
        Path,
        typer.Option(help="File of the plan; with -2, -3, ... for the next ones, and where it is taken."),
    ] = Path("out/play.json"),
    seed: Annotated[
        int | None, typer.Option(min=0, help="Number of the first random scene; any if not given.")
    ] = None,
    resolution: ResolutionOption = "fine",
) -> None:
    """Retract the tissue yourself, with keys, mouse or gamepad; the finite elements judge you."""
    with exit_codes(), expected(), ExitStack() as stack:
        if out.suffix != ".json":
            raise BadInput(f"--out = {out}, allowed a file that ends in .json")
        try:
            import pygame  # noqa: F401  (whether it is there)
        except ImportError:
            raise BadInput("this needs pygame: pip install pygame-ce") from None
        from baselines.play.aside import Aside
        from baselines.play.game import Game
        from baselines.play.keeping import PlanFiles
        from baselines.play.scenes import named_scene, random_scene
        from baselines.play.window import Window, check_screen
        from retract_env.physics.registry import physics_kind

        check_physics(physics)
        check_screen()
        numbers = itertools.count(random.randrange(MOST) if seed is None else seed)

        def deal() -> Dealt:
            return random_scene(next(numbers))

        dealt = named_scene(scene) if scene else deal()
        physics_kind(physics).accepted(dealt.scene)
        folder = stack.enter_context(usable_folder(out.parent))
        recorder = _recorder(record, physics, dealt, stack) if record else None
        announce_compilation("fem", "planning", physics)
        judge, rival = Aside(), Aside(nice=10)
        game = Game(
            dealt,
            None if recorder is not None and scene else deal,
            physics,
            judge,
            rival,
            PlanFiles(folder / out.name),
            recorder,
            resolution,
        )
        stack.callback(_tell, game, recorder)
        stack.callback(game.close)
        window = Window(game)
        stack.callback(window.close)
        window.play()


def _recorder(name: str, physics: str, dealt: Dealt, stack: ExitStack) -> Recorder:
    from baselines.play.keeping import Recorder

    journal = RUNS / f"play-{name.replace('/', '-')}.jsonl"
    stack.enter_context(usable_folder(journal.parent))
    return Recorder(name, physics, dealt.source, journal)


def _tell(game: Game, recorder: Recorder | None) -> None:
    """At the end: what was written, and the data set, whatever ended the game."""
    if game.written:
        typer.echo("written: " + ", ".join(game.written))
    if recorder is None:
        return
    count = recorder.write(command_line())
    typer.echo(f"written: {count} episodes into {recorder.name}" if count else "no episode was recorded")
