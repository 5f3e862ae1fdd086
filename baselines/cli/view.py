"""`retract view`: plans as one page that moves in three dimensions."""

from __future__ import annotations

import json
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from baselines.cli.console import (
    BadInput,
    NotCertified,
    announce_compilation,
    check_no_folder,
    check_not_read,
    exit_codes,
    usable_folder,
    writing,
)
from baselines.cli.verdict import Clock
from baselines.jobs.files import written_whole

if TYPE_CHECKING:
    from baselines.pictures.page import Shown
    from planners.base import Plan
    from planners.certify import Certificate
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene

PAGE = "view.html"
NAMES = {"ctc": "ctc, the method of 2009"}
"""Of planners whose own name does not say enough."""
MOST_PLANS = 5


def view_command(
    given: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER_OR_PLAN...",
            help="Plans, folders of `retract plan`, or that of `retract compare`; two move side by side.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The page; view.html in the folder that was given, if not said."),
    ] = None,
    alternatives: Annotated[
        bool,
        typer.Option(
            "--alternatives/--no-alternatives",
            help="Show also how candidates and worst cases move, by the rod.",
        ),
    ] = True,
    browse: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Show plans in three dimensions, moving, with their curves and verdicts: one HTML file, to be opened."""
    clock = Clock()
    with exit_codes(), ExitStack() as stack:
        files = [file for argument in given for file in plan_files(argument)]
        if len(files) > MOST_PLANS:
            raise BadInput(f"{len(files)} plans, allowed at most {MOST_PLANS} on a page")
        out = _place(given) if out is None else out
        check_no_folder(out)
        check_not_read(out, *files, *(file.with_name("certificate.json") for file in files))
        with clock.phase("imports"):
            from baselines.cli.certify import read_plan
            from baselines.pictures.page import page
        stack.enter_context(usable_folder(out.parent))
        read = [(file, *read_plan(file), _data(file)) for file in files]
        announce_compilation("fem")
        plans, ranks = [], []
        for file, scene, grasp, path, data in read:
            name = _name(str(data.get("planner", "")) or file.stem, grasp)
            with clock.phase("certificates"):
                certificate = _certificate(file, name, scene, grasp, path)
            with clock.phase("motions"):
                plans.append(
                    _followed(
                        str(file),
                        name,
                        scene,
                        grasp,
                        path,
                        certificate,
                        data.get("candidates", []),
                        alternatives,
                    )
                )
            ranks.append(_rank(certificate))
        plans = _told_apart(plans, files)
        with clock.phase("page"):
            text = page(plans, first_pair([str(data.get("planner", "")) for *_, data in read], ranks))
        write_page(out, text)
        typer.echo(clock.summary())
        if browse:
            webbrowser.open(out.resolve().as_uri())


def _data(file: Path) -> dict[str, Any]:
    """All that a plan's file says. Raises BadInput for half a character, which JSON may hold and no page."""
    from retract_env.config import read_json

    data: dict[str, Any] = read_json(file)
    try:
        json.dumps(data, ensure_ascii=False).encode()
    except UnicodeEncodeError as problem:
        half = problem.object[problem.start]
        raise BadInput(f"{file}: {half!r} in a text, allowed whole characters") from None
    return data


def plan_files(given: Path) -> list[Path]:
    """The plans in a folder, that of `retract compare` too, or the file itself. Raises BadInput."""
    if not given.is_dir():
        return [given]
    if (file := given / "plan.json").exists():
        return [file]
    files = sorted(given.glob("*/plan.json"), key=lambda file: (file.parent.name != "ctc", file))
    if not files:
        raise BadInput(f"{given}: no plan.json in it or in its folders")
    return files


def first_pair(planners: Sequence[str], ranks: Sequence[tuple[bool, bool, float]]) -> list[int]:
    """The plans that are shown first: the method of 2009, or else the first, and the best of the others."""
    if len(planners) == 1:
        return [0]
    one = planners.index("ctc") if "ctc" in planners else 0
    return [one, min((k for k in range(len(planners)) if k != one), key=lambda k: ranks[k])]


def write_page(file: Path, text: str) -> None:
    """Write a page whole and say how large it is."""
    with writing(file), written_whole(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"written: {file}, {file.stat().st_size / 1e6:.1f} MB; open it in a browser")


def page_of(plans: Sequence[Plan]) -> str:
    """The page of plans that were just made; how candidates move is left to `retract view`.

    Raises NotCertified where one cannot be followed.
    """
    from baselines.pictures.page import page

    shown = []
    for plan in plans:
        name = _name(plan.planner, plan.grasp)
        candidates = plan.to_json()["candidates"]
        shown.append(
            _followed(
                name,
                name,
                plan.scene,
                plan.grasp,
                plan.path,
                plan.certificate,
                candidates,
                alternatives=False,
            )
        )
    ranks = [_rank(plan.certificate) for plan in plans]
    return page(shown, first_pair([plan.planner for plan in plans], ranks))


def _place(given: Sequence[Path]) -> Path:
    """Where the page goes unless told otherwise."""
    if len(given) > 1:
        return Path(PAGE)
    return (given[0] if given[0].is_dir() else given[0].parent) / PAGE


def _name(planner: str, grasp: Grasp) -> str:
    return NAMES.get(planner, planner) + ("" if grasp.force is None else ", by force")


def _told_apart(plans: Sequence[Shown], files: Sequence[Path]) -> list[Shown]:
    """Plans of the same name get their file's, too."""
    import dataclasses

    names = [plan.name for plan in plans]
    return [
        dataclasses.replace(plan, name=f"{plan.name} ({file.parent.name}/{file.stem})")
        if names.count(plan.name) > 1
        else plan
        for plan, file in zip(plans, files, strict=True)
    ]


def _rank(certificate: Certificate) -> tuple[bool, bool, float]:
    """Certified plans first, robust ones first among them, then by strain."""
    robust = certificate.robust
    return not certificate.certified, robust is None or not robust["holds"], certificate.max_strain


def _certificate(file: Path, name: str, scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    """The certificate beside a plan.json, or one that is made now. Raises BadInput where it is of another
    plan."""
    from baselines.cli.certify import read_certificate
    from baselines.cli.progress import Under
    from planners import certify
    from retract_env.errors import MeshError

    beside = file.with_name("certificate.json")
    if file.name != "plan.json" or not beside.exists():
        with Under(f"{name}: certificate") as under:
            try:
                return certify(scene, grasp, path, on_increment=under.step)
            except MeshError as problem:
                raise NotCertified(f"{file}: {problem}") from None
    said = read_certificate(beside)
    if said.scene_hash != scene.hash or said.grasp != {"x": grasp.x, **grasp.firmness}:
        raise BadInput(f"{beside}: not of {file.name} beside it; make it again with `retract certify`")
    return said


def _followed(
    told: str,
    name: str,
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    candidates: Sequence[Any],
    alternatives: bool,
) -> Shown:
    """A plan for the page, with progress; told: its name in messages. Raises BadInput, NotCertified."""
    from baselines.cli.progress import Under
    from baselines.cli.shown import shown
    from baselines.pictures.page import NotFollowed
    from retract_env.errors import MeshError

    with Under(f"{name}: motion") as under:
        try:
            return shown(name, scene, grasp, path, certificate, candidates, alternatives, under.step)
        except (NotFollowed, MeshError) as problem:
            raise NotCertified(f"{told}: {problem}") from None
        except ValueError as problem:
            raise BadInput(f"{told}: {problem}") from None
