"""`retract plan`."""

from __future__ import annotations

import dataclasses
import difflib
import importlib.util
from collections.abc import Callable, Collection
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from baselines.cli.console import (
    BadInput,
    NotCertified,
    announce_compilation,
    exit_codes,
    usable_folder,
    writing,
)
from baselines.cli.verdict import Clock, ResolutionOption, VerifyOption, report
from baselines.jobs.files import write_json, written_whole
from baselines.pictures.painter import Painter

if TYPE_CHECKING:
    from planners.base import Plan


def plan_command(
    scene_name: Annotated[
        str, typer.Argument(metavar="SCENE", help="A scene in YAML, or the name of a shipped one: ten_veins.")
    ],
    planner: Annotated[str, typer.Option(help="The planner's name.")] = "ctc",
    out: Annotated[
        Path, typer.Option(help="Folder for plan.json, certificate.json and the pictures.")
    ] = Path("out"),
    resolution: ResolutionOption = "fine",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; as many as cores if not given.")
    ] = None,
    verify: VerifyOption = False,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Draw retraction.png and the film.")
    ] = True,
    film: Annotated[Literal["gif", "mp4"], typer.Option("--format", help="Format of the film.")] = "gif",
) -> None:
    """Find the certified retraction with least strain, and write it with its certificate and pictures."""
    clock = Clock()
    with exit_codes(), ExitStack() as stack:
        if pictures and film == "mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
            raise BadInput("--format mp4 needs imageio-ffmpeg: pip install 'retract[video]', or choose gif")
        painter = stack.enter_context(Painter()) if pictures else None  # gets ready while we plan
        with clock.phase("imports"):
            from retract_env.scene import SceneError, load_scene
        try:
            scene = load_scene(scene_name)
        except SceneError as problem:
            raise BadInput(str(problem)) from None
        folder = stack.enter_context(usable_folder(out))
        with clock.phase("imports"):
            import planners
            from baselines.cli.candidates import CandidateTable
            from planners.base import NoPlan
        _check_planner(planner, planners.PLANNERS)
        announce_compilation()
        with clock.phase("planning"), CandidateTable() as table:
            try:
                best = planners.plan(
                    scene, planner=planner, resolution=resolution, workers=workers, on_update=table.update
                )
            except NoPlan as none:
                table.update(none.candidates)
                raise NotCertified(f"no plan certified: {none}") from None
            except ImportError as missing:  # it names the extra to install
                raise BadInput(str(missing)) from None
            table.update(best.candidates)
            table.choose(best.grasp)
        if verify:
            from planners.certify import verified

            with clock.phase("verification"):
                certificate = verified(best.certificate, scene, best.grasp, best.path)
            best = dataclasses.replace(best, certificate=certificate)
        drawn = None if painter is None else painter.begin(best, ["retraction.png", f"retraction.{film}"])
        report(best.certificate)
        written = _write_plan(best, folder, drawn, clock)
        typer.echo("written: " + ", ".join(str(path) for path in written))
        typer.echo(clock.summary(best.timings))


def _write_plan(
    plan: Plan, folder: Path, drawn: Callable[[], dict[str, bytes]] | None, clock: Clock
) -> list[Path]:
    """Write plan, certificate and pictures into the folder, all of them or none; returns their paths.

    drawn: waits for the pictures, None where none are wanted.
    """
    with writing(folder), clock.phase("pictures and files"), ExitStack() as all_or_none:
        paths = []

        def place(name: str) -> Path:
            paths.append(folder / name)
            return all_or_none.enter_context(written_whole(folder / name))

        write_json(place("plan.json"), plan.to_json())
        write_json(place("certificate.json"), plan.certificate.to_json())
        for name, data in ({} if drawn is None else drawn()).items():
            place(name).write_bytes(data)
    return paths


def _check_planner(name: str, known: Collection[str]) -> None:
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise BadInput(f"unknown planner {name!r}, allowed {', '.join(sorted(known))}{hint}")
