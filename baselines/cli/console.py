"""What the commands of the console share: exit codes, errors of one line, folders to write into."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from baselines.jobs.files import output_folder

RESULTS = Path("results")
"""Where studies and comparisons go unless told otherwise; a checkout keeps what it shows in docs/results."""


class BadInput(Exception):
    """What the user gave cannot be used; the message is one line. Exit 2."""


class NotCertified(Exception):
    """The work was done and nothing is certified; the message says why. Exit 1."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during work that can be gone on with; the message says how, or is empty. Exit 130."""


def check_no_folder(file: Path) -> None:
    if file.is_dir():
        raise BadInput(f"{file}: is a folder")


@contextmanager
def usable_folder(path: Path) -> Iterator[Path]:
    """`output_folder`, its own errors as BadInput; those of the block pass."""
    with ExitStack() as stack:
        with writing(path):
            folder = stack.enter_context(output_folder(path))
        yield folder


@contextmanager
def writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as problem:
        raise BadInput(f"cannot write {problem.filename or path}: {why(problem)}") from None


COMPILATION = 20.0
"""s that the first run usually compiles for, on the two cores of a virtual machine."""
TOLD_EVERY = 5.0
"""s between two lines about it, where there is no terminal to draw a bar in."""


def announce_compilation(physics: str = "fem") -> None:
    """Have the kernels compiled if they never were, and show it: it takes long enough that a user wonders.

    physics: what the command computes with; it needs kernels of its own.
    """
    import retract_env.fem

    if retract_env.fem.kernels_are_cached(physics):
        return
    from numba.core.event import install_recorder
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console, start, over = Console(), time.monotonic(), threading.Event()
    typer.echo(
        f"first run: compiling the finite-element kernels, some {COMPILATION:.0f} s; they are then kept"
    )
    columns = BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=COMPILATION)

        def tell() -> None:
            while not over.wait(0.2 if console.is_terminal else TOLD_EVERY):
                seconds = time.monotonic() - start
                begun = [event.data["dispatcher"].py_func for _, event in recorder.buffer]
                ours = [function for function in begun if function.__module__.startswith("retract_env.")]
                kernel = ours[-1].__name__ if ours else "starting"
                bar.update(task, completed=seconds, description=kernel)
                if not console.is_terminal:
                    typer.echo(f"  {seconds:.0f} s of some {COMPILATION:.0f}, now {kernel}")

        with install_recorder("numba:compile") as recorder:
            teller = threading.Thread(target=tell, daemon=True)
            teller.start()
            try:
                _use_every_kernel()
            finally:
                over.set()
                teller.join()


def _use_every_kernel() -> None:
    """The beginning of a retraction, on the coarsest mesh: numba compiles what is called."""
    from planners import certify
    from planners.paths import ctc
    from retract_env.grasp import JawPath
    from retract_env.scene import load_scene
    from retract_env.spring import SpringModel

    scene = load_scene("ten_veins")
    grasp = SpringModel(scene.tissue).stable_grasps()[0]
    path = ctc(scene, grasp)
    certify(scene, grasp, JawPath(path.waypoints[:4], path.kind), "coarse")


def why(problem: OSError) -> str:
    return (problem.strerror or str(problem)).lower()


def tell_error(message: str) -> None:
    typer.echo("error: " + " ".join(message.split()), err=True)


@contextmanager
def exit_codes() -> Iterator[None]:
    """What may be expected to go wrong, as one line and an exit code."""
    try:
        yield
    except BadInput as problem:
        tell_error(str(problem))
        raise typer.Exit(2) from None
    except NotCertified as verdict:
        typer.echo(str(verdict))
        raise typer.Exit(1) from None
    except KeyboardInterrupt as stop:
        how = str(stop) if isinstance(stop, Interrupted) else ""
        typer.echo("interrupted" + (f"; {how}" if how else ""), err=True)
        raise typer.Exit(130) from None
