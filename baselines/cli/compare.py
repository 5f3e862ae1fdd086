"""`retract compare`: what the method of 2009 finds in a scene, and what the planner finds by each grip."""

from __future__ import annotations

import dataclasses
import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from baselines.cli.console import (
    BadInput,
    NotCertified,
    announce_compilation,
    exit_codes,
    usable_folder,
    writing,
)
from baselines.cli.plan import forget_plan, write_plan
from baselines.cli.robust import check_stated, hurts, stated
from baselines.cli.verdict import Clock, ResolutionOption
from baselines.cli.view import PAGE, page_of, write_page
from baselines.jobs.files import written_whole
from baselines.pictures.painter import Painter
from baselines.pictures.words import percent

if TYPE_CHECKING:
    from rich.table import Table

    from baselines.pictures.comparison import Compared
    from planners.base import Plan
    from retract_env.scene import Scene

METHODS = (
    ("ctc", "the method of 2009", "ctc", "position"),
    ("swift", "swift, by position", "swift", "position"),
    ("swift-force", "swift, by force", "swift", "force"),
)
"""Folder, name, planner and grip of what is compared."""


def compare_command(
    scene_name: Annotated[
        str, typer.Argument(metavar="SCENE", help="A scene in YAML, or the name of a shipped one: ten_veins.")
    ],
    out: Annotated[
        Path,
        typer.Option(help="Folder for comparison.png, view.html, the plans, and pictures of the best."),
    ] = Path("out"),
    resolution: ResolutionOption = "fine",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; as many as cores if not given.")
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option("--pictures/--no-pictures", help="Draw comparison.png, view.html and a film."),
    ] = True,
) -> None:
    """Plan as in 2009 and with swift, by position and by force, and show side by side what each survives."""
    clock = Clock()
    with exit_codes(), ExitStack() as stack:
        painter = stack.enter_context(Painter()) if pictures else None  # gets ready while we plan
        with clock.phase("imports"):
            from retract_env.scene import SceneError, load_scene
        try:
            scene = load_scene(scene_name)
        except SceneError as problem:
            raise BadInput(str(problem)) from None
        check_stated(scene)
        folder = stack.enter_context(usable_folder(out))
        announce_compilation("fem", "planning")
        compared = []
        for _, name, planner, grip in METHODS:
            with clock.phase(name):
                compared.append(_compared(scene, name, planner, grip, resolution, workers))
        plans = {
            of: one.plan for (of, *_), one in zip(METHODS, compared, strict=True) if one.plan is not None
        }
        if not plans:
            raise NotCertified("; ".join(f"{one.name}: no plan certified: {one.why}" for one in compared))
        best = min(plans.values(), key=_rank)
        drawn = None if painter is None else painter.begin(best, ["retraction.png", "retraction.gif"])
        _print(scene, compared)
        written = [folder / name for name in plans]
        with clock.phase("pictures and files"):
            if drawn is not None:
                from baselines.pictures.comparison import comparison

                files = {"comparison.png": comparison(scene, compared), **drawn()}
                with writing(folder), ExitStack() as all_or_none:
                    for name, data in files.items():
                        all_or_none.enter_context(written_whole(folder / name)).write_bytes(data)
                written = [*(folder / name for name in files), *written]
            for name in ("", *(name for name, *_ in METHODS)):  # of an earlier run: no plan of this scene
                if name not in plans:
                    forget_plan(folder / name)
            for name, plan in plans.items():
                write_plan(plan, stack.enter_context(usable_folder(folder / name)))
        typer.echo("written: " + ", ".join(str(path) for path in written))
        if pictures:
            with clock.phase("page"):
                write_page(folder / PAGE, page_of(list(plans.values())))
        typer.echo(clock.summary())


def _compared(
    scene: Scene, name: str, planner: str, grip: str, resolution: str, workers: int | None
) -> Compared:
    """Plan with one method and state what the plan survives, showing how far it is."""
    import planners
    from baselines.cli.progress import Under
    from baselines.pictures.comparison import Compared
    from planners.base import NoPlan

    with Under(name) as under:
        try:
            plan = planners.plan(scene, planner, resolution, workers, under.candidates, grip=grip)
        except NoPlan as none:
            return Compared(name, None, str(none))
    certificate = stated(plan.certificate, scene, plan.grasp, plan.path)
    return Compared(name, dataclasses.replace(plan, certificate=certificate))


def _rank(plan: Plan) -> tuple[bool, float]:
    """Robust plans first, of least strain."""
    robust = plan.certificate.robust
    return robust is None or not robust["holds"], plan.certificate.max_strain


def _print(scene: Scene, compared: list[Compared]) -> None:
    """The table, and what hurts each of them most."""
    from rich.console import Console

    console = Console()
    console.print(table(scene, compared))
    for one in compared:
        if one.plan is None:
            typer.echo(f"{one.name}: no plan certified: {one.why}")
        elif (most := next(hurts(one.plan.certificate), None)) is not None:
            typer.echo(f"{one.name}: what hurts most is the {most}")


def table(scene: Scene, compared: list[Compared]) -> Table:
    """A line a method, and the limits."""
    from rich.table import Table

    out = Table(box=None, pad_edge=False, padding=(0, 2), collapse_padding=True, header_style="bold")
    for column in (
        "",
        "strain",
        "friction\nneeded",
        "jaws\nclosed by",
        "failed of\nso many",
        "fails in\nat most",
        "s",
    ):
        out.add_column(column, justify="right" if column else "left", no_wrap=True)
    asked = ""
    for one in compared:
        if one.plan is None:
            out.add_row(one.name, "no plan", style="dim")
            continue
        c = one.plan.certificate
        holds = c.robust is not None and c.robust["holds"]
        out.add_row(
            one.name,
            f"{c.max_strain:.3f}",
            f"{c.required_friction:.2f}",
            one.held,
            "" if c.robust is None else f"{sum(c.robust['failures'].values()):,} / {c.robust['samples']:,}",
            "" if math.isnan(one.bound) else percent(one.bound),
            f"{one.plan.timings.get('total', 0.0):.1f}",
            style="green" if holds else "",
        )
        asked = asked if c.robust is None else percent(c.robust["eps"])
    limits = scene.limits
    out.add_row("allowed", f"{limits.strain:g}", f"{limits.friction:g}", "", "", asked, "", style="dim")
    return out
