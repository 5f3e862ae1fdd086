"""The console command `retract`.

Exit 0: certified, or done. 1: nothing certified, with the reasons. 2: bad input, one line on standard error.
130: interrupted. What is heavy is imported inside the commands, so that `retract --help` answers at once.
"""

from __future__ import annotations

import dataclasses
import difflib
import importlib.util
import json
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from baselines.cli.benchmark import benchmark_command
from baselines.cli.console import (
    BadInput,
    NotCertified,
    announce_compilation,
    check_no_folder,
    exit_codes,
    tell_error,
    usable_folder,
    why,
    writing,
)
from baselines.cli.demos import demos_command
from baselines.cli.evaluate import evaluate_command
from baselines.cli.train import train_command
from baselines.jobs.files import write_json, written_whole

if TYPE_CHECKING:
    from planners.base import Plan
    from planners.certify import Certificate
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene

MM = 1e3

app = typer.Typer(
    help="Plan surgical tissue retractions and certify them with finite elements.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command("demos")(demos_command)
app.command("train")(train_command)
app.command("evaluate")(evaluate_command)
app.command("benchmark")(benchmark_command)

Resolution = Literal["fine", "medium", "coarse"]
ResolutionOption = Annotated[
    Resolution, typer.Option(help="Mesh of the finite elements; `fine` is for certificates.")
]
VerifyOption = Annotated[
    bool, typer.Option("--verify", help="Repeat it on a finer mesh and report the differences.")
]


def main(args: Sequence[str] | None = None) -> int:
    """Run the command with these arguments (default: the process's) and return its exit code."""
    try:
        code = app(None if args is None else list(args), prog_name="retract", standalone_mode=False)
    except Exception as problem:
        # A wrong option or argument. Its class has moved between typer's releases; this method stays.
        if not hasattr(problem, "format_message"):
            raise
        message = problem.format_message()
        if message:  # none where no command was given: typer has printed the help
            tell_error(message)
        return 2
    return code if isinstance(code, int) else 0


def _print_version(asked: bool) -> None:
    if asked:
        from retract_env import __version__

        typer.echo(f"retract {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Options that stand before the command."""


@app.command("plan")
def plan_command(
    scene_file: Annotated[
        Path, typer.Argument(metavar="SCENE", help="A scene in YAML, such as configs/scenes/ten_veins.yaml.")
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
        with clock.phase("imports"):
            from retract_env.scene import load_scene
        scene = _checked(lambda: load_scene(scene_file))
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
        _report(best.certificate)
        written = _write_plan(best, folder, film if pictures else None, clock)
        typer.echo("written: " + ", ".join(str(path) for path in written))
        typer.echo(clock.summary(best.timings))


@app.command("certify")
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
        data = _read_json(plan_file)
        with clock.phase("imports"):
            import planners
            from retract_env.errors import MeshError
        scene, grasp, path = _read_plan(plan_file, data)
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
        _report(certificate)


@app.command("reproduce")
def reproduce_command(
    name: Annotated[str, typer.Argument(help="fig7, fig8, fig9, fig11, fig12, pruning, light_grip, or all.")],
    out: Annotated[Path, typer.Option(help="Folder for tables, pictures and texts.")] = Path("docs/results"),
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; as many as cores if not given.")
    ] = None,
    resolution: ResolutionOption = "fine",
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that does the work, or `auto`.")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Do again what an earlier run has done.")] = False,
) -> None:
    """Repeat a figure of the paper, or a study of our own. An interrupted run goes on where it stopped."""
    with exit_codes(), ExitStack() as stack:
        if cluster is not None and workers is not None:
            raise BadInput("--workers and --cluster: allowed one of them, the cluster has its own workers")
        from baselines.paper import reproduce
        from retract_env.errors import ConfigError

        try:
            asked = reproduce.names(name)
            folder = stack.enter_context(usable_folder(out))
            announce_compilation()
            written = reproduce.reproduce(asked, folder, resolution, workers, cluster, fresh)
        except (ConfigError, ConnectionError) as problem:
            raise BadInput(str(problem)) from None
        typer.echo("written: " + ", ".join(str(path) for path in written))


class Clock:
    """Seconds by phase, to say where the time goes."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def summary(self, work: Mapping[str, float] | None = None) -> str:
        """One line of wall-clock, and one of `work`: s by kind, summed over threads."""
        phases = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in self.seconds.items())
        line = f"time: {time.perf_counter() - self.start:.1f} s; {phases}"
        parts = {name: seconds for name, seconds in (work or {}).items() if name != "total"}
        if parts:
            largest_first = sorted(parts.items(), key=lambda item: -item[1])
            line += "\n  planning, summed over threads: " + ", ".join(
                f"{name} {s:.1f} s" for name, s in largest_first
            )
        return line


def describe(certificate: Certificate) -> str:
    """The verdict of a certificate and its margins, on one line."""
    c = certificate
    verdict = {
        "ok": "certified",
        "not_visible": "not certified: tissue stays below the line of sight",
        "strain": "not certified: too much strain",
        "slip": "not certified: a jaw slips",
        "release": "not certified: a jaw lets go",
        "diverged": "not certified: no equilibrium was found",
    }.get(c.reason, f"not certified: {c.reason}")
    facts = (
        f"grasp {c.grasp['x'] * MM:.2f} mm",
        f"compression {c.grasp['compression'] * MM:.2f} mm",
        f"strain {c.max_strain:.3f} of {c.strain_limit:g}",
        f"friction {c.required_friction:.2f} of {c.friction_limit:g}",
        f"clearance {c.clearance * MM:.2f} mm",
    )
    return f"{verdict}; {', '.join(facts)}"


def _report(certificate: Certificate) -> None:
    """Print the verdict, and the finer mesh's where there is one. Raises NotCertified."""
    if not certificate.certified:
        raise NotCertified(describe(certificate))
    typer.echo(describe(certificate))
    if certificate.verification is not None:
        _report_finer(certificate.verification)


def _report_finer(finer: Mapping[str, Any]) -> None:
    mesh = f"the {finer['resolution']} mesh of {finer['nodes']} nodes"
    if finer["reason"] != "ok":
        raise NotCertified(f"not certified on {mesh}: {finer['reason']}")
    typer.echo(
        f"verified on {mesh}: strain {finer['max_strain']:.3f} ({finer['max_strain_difference']:+.1%} here), "
        f"friction {finer['required_friction']:.2f} ({finer['required_friction_difference']:+.2f} here)"
    )


def _write_plan(plan: Plan, folder: Path, film: str | None, clock: Clock) -> list[Path]:
    """Write plan, certificate and pictures into the folder, all of them or none; returns their paths."""
    files: dict[str, Callable[[Path], None]] = {
        "plan.json": lambda path: write_json(path, plan.to_json()),
        "certificate.json": lambda path: write_json(path, plan.certificate.to_json()),
    }
    if film is not None:
        with clock.phase("imports"):
            from baselines.pictures.film import animate_retraction
            from baselines.pictures.still import draw_retraction
        files["retraction.png"] = lambda path: draw_retraction(plan, path)
        files[f"retraction.{film}"] = lambda path: animate_retraction(plan, path)
    with writing(folder), clock.phase("pictures and files"), ExitStack() as all_or_none:
        for name, write in files.items():
            write(all_or_none.enter_context(written_whole(folder / name)))
    return [folder / name for name in files]


def _read_json(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except OSError as problem:
        raise BadInput(f"{file}: {why(problem)}") from None
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"{file}: not readable as JSON: {problem}") from None


def _read_plan(file: Path, data: Any) -> tuple[Scene, Grasp, JawPath]:
    from planners.base import plan_from_json
    from planners.certify import Trial

    try:
        scene, grasp, path = plan_from_json(data)
        Trial(scene, grasp, path)  # whether they belong together
    except (ValueError, OverflowError) as problem:  # a whole number may be too long for a float
        raise BadInput(f"{file}: {problem}") from None
    return scene, grasp, path


def _checked(load: Callable[[], Scene]) -> Scene:
    from retract_env.errors import SceneError

    try:
        return load()
    except SceneError as problem:
        raise BadInput(str(problem)) from None


def _check_planner(name: str, known: Collection[str]) -> None:
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise BadInput(f"unknown planner {name!r}, allowed {', '.join(sorted(known))}{hint}")
