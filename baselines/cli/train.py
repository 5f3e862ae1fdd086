"""`retract train`: an agent learns by a recipe, in a folder from which a run that was stopped goes on."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from baselines.cli.console import BadInput, announce_compilation, exit_codes, usable_folder
from baselines.cli.work import RUNS, BenchmarkOption, command_line, expected, frozen_scenes, going_on

if TYPE_CHECKING:
    from baselines.learning.recipe import Recipe
    from baselines.learning.train import Progress, Run


def train_command(
    algorithm: Annotated[
        str, typer.Argument(help="By this name; its recipe is the shipped configs/train/ALGORITHM.yaml.")
    ],
    config: Annotated[
        str | None, typer.Option(help="Another recipe: a file, or the name of a shipped one.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="0 if not given.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Instead of the recipe's.")] = None,
    envs: Annotated[
        int | None,
        typer.Option(min=1, help="Environments side by side; if not given the recipe's, or one a core."),
    ] = None,
    physics: Annotated[
        str | None, typer.Option(help="Instead of the recipe's: fem, rod, bullet, or one that was added.")
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option("--from", help="Policy to begin from: a folder, or the name of a shipped one."),
    ] = None,
    demos: Annotated[
        int | None, typer.Option(min=1, help="Episodes that bc learns from, all by default.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; runs/ALGORITHM-SEED if not given.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
    benchmark: BenchmarkOption = None,
) -> None:
    """Train an agent. A run that was stopped goes on with --resume and ends as it would have ended."""
    with exit_codes(), expected():
        from baselines.learning.recipe import learner_of

        learner_of(algorithm)
        from baselines.learning import train

        folder = out or RUNS / f"{algorithm}-{seed or 0}"
        if resume:
            given: dict[str, Any] = {
                "--config": config,
                "--seed": seed if out else None,
                "--steps": steps,
                "--envs": envs,
            }
            given |= {"--physics": physics, "--from": start, "--demos": demos, "--benchmark": benchmark}
            if wrong := [name for name, value in given.items() if value is not None]:
                raise BadInput(f"{', '.join(wrong)}: not with --resume, the run has its own")
            run = train.open_run(folder)
            if run.recipe.algorithm != algorithm:
                raise BadInput(f"{folder}: a run of {run.recipe.algorithm}, not of {algorithm}")
        else:
            if (folder / train.RUN).exists():
                raise BadInput(f"{folder}: holds a run already; go on with --resume or choose another --out")
            recipe = _recipe(algorithm, config, steps, physics)
            run = _new_run(recipe, frozen_scenes(benchmark), seed or 0, envs, start, demos)

        def how() -> str:
            command = shlex.join(["retract", "train", algorithm, "--resume", "--out", str(folder)])
            return f"go on with `{command}`" if (folder / train.RUN).exists() else ""

        with usable_folder(folder):
            announce_compilation(run.recipe.task.physics, *(["fem"] if run.recipe.evaluation.fem else []))
            with going_on(how), _told(algorithm, run) as told:
                policy = train.train(run, folder, told)
        score = policy.scores["validation"]
        typer.echo(
            f"best on validation: {score['success']:.0%} succeed, strain {score['strain']:.2f} of the limit, "
            f"after {score['steps']} steps"
        )
        typer.echo(f"written: {folder / train.POLICY}")


def _recipe(algorithm: str, config: str | None, steps: int | None, physics: str | None) -> Recipe:
    from baselines.learning.recipe import Recipe, load_recipe

    recipe = load_recipe(config or algorithm)
    if recipe.algorithm != algorithm:
        raise BadInput(f"{config}: algorithm = {recipe.algorithm!r}, asked for {algorithm!r}")
    data = recipe.dump()
    data["steps"] = steps or data["steps"]
    data["task"]["physics"] = physics or data["task"]["physics"]
    return Recipe.from_data(data)


def _new_run(
    recipe: Recipe, benchmark: Path, seed: int, envs: int | None, start: Path | None, demos: int | None
) -> Run:
    from baselines.benchmark.splits import load_benchmark
    from baselines.learning.train import Run
    from retract_env.threads import cores

    scenes: list[Any] = [None]
    if recipe.task.scene == "random":
        splits, asked = load_benchmark(benchmark).splits, recipe.evaluation.scenes
        if (split := splits.get("validation")) is None:
            raise BadInput(
                f"{benchmark}: splits {', '.join(splits)}, allowed with validation, to be judged on"
            )
        if asked > split.count:
            raise BadInput(f"evaluation.scenes = {asked}, allowed {split.count} at most, as in {benchmark}")
        scenes = [scene.dump() for scene in split.scenes(asked)]
    count = envs or recipe.envs or cores()
    return Run(recipe, seed, count, scenes, str(start) if start else None, demos, command_line())


@contextmanager
def _told(title: str, run: Run) -> Iterator[Any]:
    """A bar with the newest evaluation; in no terminal, `Told` and a line for each evaluation."""
    from rich.console import Console

    from baselines.jobs.told import Told

    with Told(title, run.recipe.steps, Console(), unit="steps") as told:
        newest, begun = None, False

        def on_progress(progress: Progress) -> None:
            nonlocal newest, begun
            if not begun:
                begun = True
                told.begin(progress.steps)
            if progress.last is None or progress.last is newest:
                told.update(progress.steps)
                return
            newest = progress.last
            text = f"{newest['success']:.0%} succeed, strain {newest['strain']:.2f} of the limit"
            if "fem_success" in newest:
                text += f" (finite elements: {newest['fem_success']:.0%}, strain {newest['fem_gap']:+.0%})"
            told.update(progress.steps, text)
            if not told.console.is_terminal:
                told.say(f"{newest['steps']} of {progress.total} steps: {text}, {newest['seconds']:.0f} s")

        yield on_progress
