"""The console command `retract`.

Exit 0: certified, or done. 1: nothing certified, with the reasons, or not robust where that was asked.
2: bad input, one line on standard error. 130: interrupted. What is heavy is imported inside the commands, so
that `retract --help` answers at once.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Sequence
from typing import Annotated

import typer

from baselines.cli.benchmark import benchmark_command
from baselines.cli.certify import certify_command
from baselines.cli.compare import compare_command
from baselines.cli.console import tell_error
from baselines.cli.demos import demos_command
from baselines.cli.evaluate import evaluate_command
from baselines.cli.plan import plan_command
from baselines.cli.play import play_command
from baselines.cli.reproduce import reproduce_command
from baselines.cli.train import train_command
from baselines.cli.view import view_command

ALLOCATIONS = 50_000
"""of containers between two searches for garbage; beside them an array of a fine mesh is large"""

app = typer.Typer(
    help="Plan surgical tissue retractions and certify them with finite elements.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command("plan")(plan_command)
app.command("compare")(compare_command)
app.command("certify")(certify_command)
app.command("play")(play_command)
app.command("view")(view_command)
app.command("reproduce")(reproduce_command)
app.command("demos")(demos_command)
app.command("train")(train_command)
app.command("evaluate")(evaluate_command)
app.command("benchmark")(benchmark_command)


def main(args: Sequence[str] | None = None) -> int:
    """Run the command with these arguments (default: the process's) and return its exit code."""
    if args is None:
        _collect_seldom()
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


def _collect_seldom() -> None:
    """Look for garbage in circles seldom in this process, and not at all as it ends.

    Imports make objects by the hundred thousand, which all stay: Python's own pace searches them time and
    again (0.3 s of a plan), and once more, all of them, when the interpreter ends (0.6 s).
    """
    gc.set_threshold(ALLOCATIONS, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)


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
