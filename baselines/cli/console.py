"""What the commands of the console share: exit codes, errors of one line, folders to write into."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from baselines.jobs.files import output_folder


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


def announce_compilation(physics: str = "fem") -> None:
    """Numba compiles the kernels on the first run, for long enough that a user wonders.

    physics: what the command computes with; it needs kernels of its own.
    """
    from retract_env.fem import kernels_are_cached

    if not kernels_are_cached(physics):
        typer.echo("first run: compiling the kernels, which are then kept")


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
