"""`retract plan`."""

from __future__ import annotations

import dataclasses
import difflib
import importlib.util
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from baselines.cli.console import (
    BadInput,
    NotCertified,
    announce_compilation,
    check_no_folder,
    exit_codes,
    usable_folder,
    writing,
)
from baselines.cli.robust import RobustOption, check_stated, forget_worst_cases, stated, worst_cases
from baselines.cli.verdict import (
    Clock,
    ResolutionOption,
    VerifyOption,
    check_robust,
    report,
    verified_if_meshed,
)
from baselines.cli.view import page_of, write_page
from baselines.jobs.files import write_json, written_whole
from baselines.pictures.painter import Painter

if TYPE_CHECKING:
    from planners.base import Plan
    from retract_env.scene import Scene


def plan_command(
    scene_name: Annotated[
        str, typer.Argument(metavar="SCENE", help="A scene in YAML, or the name of a shipped one: ten_veins.")
    ],
    planner: Annotated[
        str, typer.Option(help="The planner's name; `ctc` is the reference, that of 2009.")
    ] = "swift",
    grip: Annotated[
        Literal["position", "force"], typer.Option(help="What the jaws are closed by.")
    ] = "position",
    time: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Search for so long; as long as a first search takes if not given."
        ),
    ] = None,
    robust: RobustOption = False,
    known: Annotated[
        bool, typer.Option("--known", help="Plan as if nothing of the scene were unknown.")
    ] = False,
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
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write also a page that shows the plan in 3D, moving."),
    ] = None,
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
        if robust:
            check_stated(scene)
        folder = stack.enter_context(usable_folder(out))
        if html is not None:
            stack.enter_context(usable_folder(html.parent))
            check_no_folder(html)
        with clock.phase("imports"):
            import planners
            from baselines.cli.candidates import CandidateTable
            from planners.base import NoPlan
            from retract_env.errors import MeshError
        _check_asked(planner, grip, time)
        announce_compilation("fem", "planning")
        with clock.phase("planning"), CandidateTable() as table:
            try:
                best = planners.plan(
                    as_if_known(scene) if known else scene,
                    planner=planner,
                    resolution=resolution,
                    workers=workers,
                    on_update=table.update,
                    grip=grip,
                    time=time,
                )
            except NoPlan as none:
                table.update(none.candidates)
                raise NotCertified(f"no plan certified: {none}") from None
            except MeshError as problem:
                raise NotCertified(f"no plan certified: {problem}") from None
            except ImportError as missing:  # it names the extra to install
                raise BadInput(str(missing)) from None
            table.update(best.candidates)
            table.choose(best.grasp)
        best = of_scene(best, scene)
        certificate = best.certificate
        if verify:
            with clock.phase("verification"):
                certificate = verified_if_meshed(certificate, scene, best.grasp, best.path)
        if robust:
            with clock.phase("robust statement"):
                certificate = stated(certificate, scene, best.grasp, best.path)
        best = dataclasses.replace(best, certificate=certificate)
        drawn = None if painter is None else painter.begin(best, ["retraction.png", f"retraction.{film}"])
        report(best.certificate)
        with clock.phase("pictures and files"):
            written = write_plan(best, folder, drawn)
        typer.echo("written: " + ", ".join(str(path) for path in written))
        if html is not None:
            with clock.phase("page"):
                write_page(html, page_of([best]))
        typer.echo(clock.summary(best.timings))
        check_robust(best.certificate)


def as_if_known(scene: Scene) -> Scene:
    """The scene as if nothing of it were unknown."""
    from retract_env.scene import Uncertainty

    return scene.model_copy(update={"uncertainty": Uncertainty.none()})


def of_scene(plan: Plan, scene: Scene) -> Plan:
    """A plan as one for a scene that differs in what is unknown alone: the judge simulates what is said."""
    certificate = dataclasses.replace(plan.certificate, scene_hash=scene.hash)
    return dataclasses.replace(plan, scene=scene, certificate=certificate)


def write_plan(plan: Plan, folder: Path, drawn: Callable[[], dict[str, bytes]] | None = None) -> list[Path]:
    """Write plan, certificate, worst cases and pictures into the folder, all of them or none; returns their
    paths. Worst cases of an earlier plan go.

    drawn: waits for the pictures, None where none are wanted.
    """
    with writing(folder), ExitStack() as all_or_none:
        paths = []

        def place(name: str) -> Path:
            paths.append(folder / name)
            return all_or_none.enter_context(written_whole(folder / name))

        write_json(place("plan.json"), plan.to_json())
        write_json(place("certificate.json"), plan.certificate.to_json())
        for name, case in worst_cases(plan.scene, plan.grasp, plan.path, plan.certificate).items():
            write_json(place(name), case)
        for name, data in ({} if drawn is None else drawn()).items():
            place(name).write_bytes(data)
    forget_worst_cases(folder, paths)
    return paths


def forget_plan(folder: Path) -> None:
    """Delete what `write_plan` wrote into a folder but pictures, if anything."""
    for name in ("plan.json", "certificate.json"):
        (folder / name).unlink(missing_ok=True)
    forget_worst_cases(folder)


def _check_asked(planner: str, grip: str, time: float | None) -> None:
    """Raise BadInput for an unknown planner, or what that planner does not take."""
    import planners

    if planner not in planners.PLANNERS:
        close = difflib.get_close_matches(planner, planners.PLANNERS, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise BadInput(f"unknown planner {planner!r}, allowed {', '.join(sorted(planners.PLANNERS))}{hint}")
    try:
        planners.asked_of(planner, grip, time)
    except ValueError as problem:
        raise BadInput(f"--{problem}") from None
