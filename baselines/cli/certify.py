"""`retract certify`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from baselines.cli.verdict import Clock, ResolutionOption, VerifyOption, report
from baselines.jobs.files import write_json, written_whole

if TYPE_CHECKING:
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene


def certify_command(
    plan_file: Annotated[
        Path, typer.Argument(metavar="PLAN.json", help="A plan written by `retract plan`, or by hand.")
    ],
    resolution: ResolutionOption = "fine",
    verify: VerifyOption = False,
    out: Annotated[Path | None, typer.Option(help="File for the certificate, in JSON.")] = None,
) -> None:
    """Simulate the retraction of a plan and judge it."""
    clock = Clock()
    with exit_codes(), ExitStack() as stack:
        with clock.phase("imports"):
            import planners
            from retract_env.errors import MeshError
        scene, grasp, path = _read_plan(plan_file)
        if out is not None:
            stack.enter_context(usable_folder(out.parent))
            check_no_folder(out)
        announce_compilation()
        with clock.phase("simulation"):
            try:
                certificate = planners.certify(scene, grasp, path, resolution=resolution, verify=verify)
            except MeshError as problem:
                raise NotCertified(f"not certified: {problem}") from None
        if out is not None:
            with writing(out), written_whole(out) as temporary:
                write_json(temporary, certificate.to_json())
            typer.echo(f"written: {out}")
        typer.echo(clock.summary())
        report(certificate)


def _read_plan(file: Path) -> tuple[Scene, Grasp, JawPath]:
    from planners.base import plan_from_json
    from planners.certify import Trial
    from retract_env.config import read_json

    try:
        scene, grasp, path = plan_from_json(read_json(file))
        Trial(scene, grasp, path)  # whether they belong together
    except (ValueError, OverflowError) as problem:  # a whole number may be too long for a float
        raise BadInput(f"{file}: {problem}") from None
    return scene, grasp, path
