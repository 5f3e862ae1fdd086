"""`retract certify`."""

from __future__ import annotations

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
from baselines.cli.robust import (
    RobustOption,
    check_stated,
    forget_worst_cases,
    is_worst_case,
    stated,
    worst_cases,
)
from baselines.cli.verdict import Clock, Resolution, VerifyOption, check_robust, report, verified_if_meshed
from baselines.jobs.files import write_json, written_whole

if TYPE_CHECKING:
    from planners.certify import Certificate, Robust
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene


SHOWN = 3
"""Differences between a certificate and what its plan comes to that are named."""


def certify_command(
    plan_file: Annotated[
        Path, typer.Argument(metavar="PLAN.json", help="A plan written by `retract plan`, or by hand.")
    ],
    resolution: Annotated[
        Resolution | None, typer.Option(help="Mesh of the finite elements; `fine` if not given.")
    ] = None,
    verify: VerifyOption = False,
    robust: RobustOption = False,
    speed: Annotated[
        float | None,
        typer.Option(help="m/s, mean, of the jaws: say also what the motion comes to in time, with inertia."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File for the certificate, in JSON; worst cases are put beside it.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            metavar="CERTIFICATE.json",
            help="A certificate of this plan: compute it again as it was made, and compare.",
        ),
    ] = None,
) -> None:
    """Simulate the retraction of a plan and judge it."""
    clock = Clock()
    with exit_codes(), ExitStack() as stack:
        given = verify or robust or any(option is not None for option in (out, speed, resolution))
        if check is not None and given:
            raise BadInput(
                "--check: not with --out, --verify, --robust, --speed or --resolution, "
                "the certificate has its own"
            )
        with clock.phase("imports"):
            import planners
            from baselines.cli.progress import Under
            from planners.certify import timed
            from retract_env.errors import MeshError
        scene, grasp, path = read_plan(plan_file)
        if robust:
            check_stated(scene)
        said = None if check is None else read_certificate(check)
        if out is not None:
            stack.enter_context(usable_folder(out.parent))
            check_no_folder(out)
            check_not_read(out, plan_file)
            if is_worst_case(out):
                raise BadInput(f"--out = {out}, allowed another name: files of worst cases are called so")
            if robust and is_worst_case(plan_file) and plan_file.resolve().parent == out.resolve().parent:
                raise BadInput(f"--out = {out}, allowed another folder: worst cases would replace the plan")
        asked = _asked(str(check), said, robust)
        motion = _in_time(str(check), said, scene, speed)
        announce_compilation("fem", *(["planning"] if asked else []))
        with clock.phase("simulation"), Under("simulation") as under:
            try:
                mesh = resolution or "fine" if said is None else said.mesh["resolution"]
                verify = verify if said is None else said.verification is not None
                certificate = planners.certify(scene, grasp, path, mesh, on_increment=under.step)
                if verify:
                    certificate = verified_if_meshed(certificate, scene, grasp, path)
                if motion and (said is not None or certificate.certified):
                    certificate = timed(certificate, scene, **motion, on_increment=under.step)
            except MeshError as problem:
                raise NotCertified(f"not certified: {problem}") from None
        if asked and (said is not None or certificate.certified):
            with clock.phase("robust statement"):
                certificate = stated(certificate, scene, grasp, path, asked)
        if out is not None:
            written = _write(out, scene, grasp, path, certificate)
            typer.echo("written: " + ", ".join(str(file) for file in written))
        typer.echo(clock.summary())
        if said is not None:
            _compare(str(check), said, certificate)
        report(certificate)
        check_robust(certificate)


def _write(out: Path, scene: Scene, grasp: Grasp, path: JawPath, certificate: Certificate) -> list[Path]:
    """Write the certificate, and the worst cases beside it, all or none; returns their paths. Where
    there is a statement, worst cases of an earlier one go."""
    contents = {out: certificate.to_json()}
    for name, case in worst_cases(scene, grasp, path, certificate).items():
        contents[out.parent / name] = case
    with writing(out), ExitStack() as all_or_none:
        for file, content in contents.items():
            write_json(all_or_none.enter_context(written_whole(file)), content)
    if certificate.robust is not None:
        forget_worst_cases(out.parent, contents)
    return list(contents)


def _asked(file: str, said: Certificate | None, robust: bool) -> Robust | None:
    """What is to be stated: what a certificate's statement was asked for, where there is one to check.

    Raises BadInput.
    """
    from planners.certify import Robust

    if said is None:
        return Robust() if robust else None
    if said.robust is None:
        return None
    try:
        return Robust(*(said.robust[name] for name in ("eps", "beta", "samples", "seed")))
    except (KeyError, TypeError, ValueError) as problem:
        raise BadInput(f"{file}: certificate.robust: {problem}") from None


def _in_time(file: str, said: Certificate | None, scene: Scene, speed: float | None) -> dict[str, Any]:
    """How the motion is to be made in time, arguments of `timed`: as a certificate says, where there is one
    to check; none where it is not asked for.

    Raises BadInput.
    """
    from planners.certify.moving import check_motion

    made: dict[str, Any] = {}
    try:
        if said is None and speed is not None:
            made = {"speed": speed}
        elif said is not None and said.moving is not None:
            made = {name: said.moving[name] for name in ("speed", "start", "damping")}
        if made:
            check_motion(scene, **made)
    except (KeyError, TypeError, ValueError) as problem:
        what = "--speed" if said is None else f"{file}: certificate.moving"
        raise BadInput(f"{what}: {problem}") from None
    return made


def _compare(file: str, said: Certificate, found: Certificate) -> None:
    """Raises NotCertified where a certificate is not what its plan comes to, naming what differs."""
    from planners.certify import differences

    if wrong := differences(said, found):
        more = f"; and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
        raise NotCertified(f"{file}: not what the plan comes to: {'; '.join(wrong[:SHOWN])}{more}")
    typer.echo(f"{file}: computed again, all the same")


def read_certificate(file: Path) -> Certificate:
    """Raises BadInput."""
    from planners.certify import Certificate
    from retract_env.config import read_json
    from retract_env.mesh import RESOLUTIONS

    try:
        said = Certificate.from_json(read_json(file))
        if said.mesh.get("resolution") not in RESOLUTIONS:
            raise ValueError(f"certificate.mesh.resolution: allowed {', '.join(RESOLUTIONS)}")
    except (ValueError, TypeError, AttributeError, OverflowError) as problem:
        raise BadInput(f"{file}: {problem}") from None
    return said


def read_plan(file: Path) -> tuple[Scene, Grasp, JawPath]:
    """Raises BadInput."""
    from planners.base import plan_from_json
    from planners.certify import Trial
    from retract_env.config import read_json

    try:
        scene, grasp, path = plan_from_json(read_json(file))
        Trial(scene, grasp, path)  # whether they belong together
    except (ValueError, OverflowError) as problem:  # a whole number may be too long for a float
        raise BadInput(f"{file}: {problem}") from None
    return scene, grasp, path
