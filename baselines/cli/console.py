"""What the commands of the console share: exit codes, errors of one line, folders to write into."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
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
    """Raises BadInput for a folder in the place of a file."""
    if file.is_dir():
        raise BadInput(f"{file}: is a folder")


def check_not_read(file: Path, *read: Path) -> None:
    """Raises BadInput for a file to be written that is one of those that are read."""
    if any(file.resolve() == one.resolve() for one in read):
        raise BadInput(f"--out = {file}, allowed another file: this one is read, and would be lost")


@contextmanager
def usable_folder(path: Path) -> Iterator[Path]:
    """`output_folder`, its own errors as BadInput; those of the block pass."""
    with ExitStack() as stack:
        with writing(path):
            folder = stack.enter_context(output_folder(path))
        yield folder


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """What cannot be written in the block, as BadInput."""
    try:
        yield
    except ConnectionError:  # a kind of OSError that is no file's
        raise
    except OSError as problem:
        raise BadInput(f"cannot write {problem.filename or path}: {why(problem)}") from None


COMPILATION = {"finite-element": 20.0, "rod": 100.0, "planning": 90.0}
"""s that the first run usually compiles these kernels for, on the two cores of a virtual machine."""
TOLD_EVERY = 5.0
"""s between two lines about it, where there is no terminal to draw a bar in."""


def announce_compilation(*physics: str) -> None:
    """Have the kernels compiled if they never were, and show it: it takes long enough that a user wonders.

    physics: what the command computes with, the finite elements if not given; each needs kernels of its own,
    and so does "planning", retractions on rods.
    """
    import retract_env.fem
    from retract_env.compilation import is_cached

    for name in physics or ("fem",):
        if name == "planning":
            from retract_env.rod import follow

            if not is_cached(follow._follow):
                _compile("planning", _use_every_kernel_of_planning)
        elif name == "rod":
            from retract_env.rod.block import advance_blocks

            if not is_cached(advance_blocks):
                _compile("rod", _use_every_kernel_of_rods)
        elif not retract_env.fem.kernels_are_cached(name):
            _compile("finite-element", _use_every_kernel)


def _compile(kernels: str, use: Callable[[], None]) -> None:
    """Show a bar, or a line now and then, while what uses the kernels compiles them."""
    from numba.core.event import install_recorder
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console, start, over, usual = Console(), time.monotonic(), threading.Event(), COMPILATION[kernels]
    typer.echo(f"first run: compiling the {kernels} kernels, some {usual:.0f} s; they are then kept")
    columns = BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=usual)

        def tell() -> None:
            while not over.wait(0.2 if console.is_terminal else TOLD_EVERY):
                seconds = time.monotonic() - start
                begun = [event.data["dispatcher"].py_func for _, event in recorder.buffer]
                ours = [function for function in begun if function.__module__.startswith("retract_env.")]
                kernel = ours[-1].__name__ if ours else "starting"
                bar.update(task, completed=seconds, description=kernel)
                if not console.is_terminal:
                    typer.echo(f"  {seconds:.0f} s of some {usual:.0f}, now {kernel}")

        with install_recorder("numba:compile") as recorder:
            teller = threading.Thread(target=tell, daemon=True)
            teller.start()
            try:
                use()
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


def _use_every_kernel_of_rods() -> None:
    """An episode's beginning, in many environments as in one."""
    import gymnasium as gym
    import numpy as np

    import retract_env  # noqa: F401  (registers the environments)

    envs = gym.make_vec("TissueRetractRod-v0", 1, scene="random", autoreset_mode="SameStep")
    env = gym.make("TissueRetractRod-v0", scene="random", disable_env_checker=True)
    for reset, step, space in (
        (envs.reset, envs.step, envs.action_space),
        (env.reset, env.step, env.action_space),
    ):
        reset(seed=0)
        for _ in range(2):
            step(np.zeros(space.shape))
    envs.close()
    env.close()


def _use_every_kernel_of_planning() -> None:
    """One path on one flap."""
    from planners.paths import ctc
    from planners.whatif import Flaps
    from retract_env.scene import load_scene
    from retract_env.spring import SpringModel

    scene = load_scene("ten_veins")
    grasp = SpringModel(scene.tissue).stable_grasps()[0]
    Flaps(scene).follow([grasp.x], ctc(scene, grasp).poses[1:3][None])


def why(problem: OSError) -> str:
    """The system's reason, in a few words."""
    return (problem.strerror or str(problem)).lower()


def tell_error(message: str) -> None:
    """One line on standard error."""
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
