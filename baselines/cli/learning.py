"""The console's commands about learning: demos, train, evaluate, benchmark."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from baselines.cli.console import RESULTS, BadInput, announce_compilation, exit_codes, usable_folder, writing

if TYPE_CHECKING:
    from baselines.learning.recipe import Recipe
    from baselines.learning.train import Progress, Run

commands = typer.Typer()

EXTRA = ("minari", "rliable", "sb3_contrib", "stable_baselines3", "tensorboard", "torch")
"""Packages of the extra `rl`."""

BENCHMARK = Path("benchmark")
"""The shipped one."""
RUNS = Path("runs")
Algorithm = Literal["ppo", "sac", "tqc", "bc"]
JobsOption = Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores if not given.")]
ClusterOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that does the work, or `auto`.")
]
BenchmarkOption = Annotated[Path, typer.Option("--benchmark", help="The frozen scenes, a YAML file.")]


@commands.command("demos")
def demos_command(
    dataset: Annotated[str, typer.Option(help="Name of the Minari data set to make.")] = "",
    planner: Annotated[str, typer.Option(help="Whose plans are demonstrated.")] = "ctc",
    count: Annotated[int, typer.Option(min=1, help="Scenes, seeds from --first on.")] = 300,
    first: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    resolution: Annotated[
        Literal["fine", "medium", "coarse"], typer.Option(help="Mesh of the certificates.")
    ] = "coarse",
    journal: Annotated[
        Path | None, typer.Option(help="File that keeps what is done; RUNS/demos-PLANNER.jsonl if not given.")
    ] = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
) -> None:
    """Play certified plans through the environment and keep them as a Minari data set."""
    with exit_codes(), _expected():
        from rich.console import Console

        from baselines.jobs.version import code_version
        from baselines.learning import demos
        from planners import PLANNERS

        if planner not in PLANNERS:
            raise BadInput(f"unknown planner {planner!r}, allowed {', '.join(PLANNERS)}")
        name = dataset or f"tissue-retract/{planner}-v0"
        demos.check_free(name)
        kept = journal or RUNS / f"demos-{planner}.jsonl"
        tasks = [
            {"planner": planner, "resolution": resolution, "seed": first + k, "code": code_version()}
            for k in range(count)
        ]
        announce_compilation()
        with usable_folder(kept.parent):
            rows = _run(tasks, demos.demonstrate, kept, jobs, cluster, name, Console())
        typer.echo(demos.summary(rows))
        written = demos.write_dataset(name, rows, tasks[0], _command())
        typer.echo(f"written: {written} episodes into {name}")


@commands.command("train")
def train_command(
    algorithm: Annotated[Algorithm, typer.Argument(help="Its recipe is the shipped one of that name.")],
    config: Annotated[Path | None, typer.Option(help="Another recipe, a YAML file or a shipped one.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="0 if not given.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Instead of the recipe's.")] = None,
    envs: Annotated[
        int | None, typer.Option(min=1, help="Environments side by side; one a core if not given.")
    ] = None,
    physics: Annotated[str | None, typer.Option(help="Name of another one than the recipe's.")] = None,
    start: Annotated[
        Path | None, typer.Option("--from", help="Folder of a policy to begin from, such as one of bc.")
    ] = None,
    demos: Annotated[
        int | None, typer.Option(min=1, help="Episodes that bc learns from, all by default.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; runs/ALGORITHM-SEED if not given.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
    benchmark: BenchmarkOption = BENCHMARK,
) -> None:
    """Train an agent. A run that was killed goes on with --resume and ends as it would have ended."""
    with exit_codes(), _expected():
        from baselines.learning import train

        folder = out or RUNS / f"{algorithm}-{seed or 0}"
        if resume:
            given: dict[str, Any] = {
                "--config": config,
                "--seed": seed if out else None,
                "--steps": steps,
                "--envs": envs,
            }
            given |= {"--physics": physics, "--from": start, "--demos": demos}
            if wrong := [name for name, value in given.items() if value is not None]:
                raise BadInput(f"{', '.join(wrong)}: not with --resume, the run has its own")
            run = train.open_run(folder)
            if run.recipe.algorithm != algorithm:
                raise BadInput(f"{folder}: a run of {run.recipe.algorithm}, not of {algorithm}")
        else:
            if (folder / train.RUN).exists():
                raise BadInput(f"{folder}: holds a run already; go on with --resume or choose another --out")
            recipe = _recipe(algorithm, config, steps, physics)
            run = _new_run(recipe, benchmark, seed or 0, envs, start, demos)
        announce_compilation()
        with usable_folder(folder), _bar() as told:
            policy = train.train(run, folder, told)
        score = policy.scores["validation"]
        typer.echo(
            f"best on validation: {score['success']:.0%} succeed, strain {score['strain']:.2f} of the limit, "
            f"after {score['steps']} steps"
        )
        typer.echo(f"written: {folder / train.POLICY}")


@commands.command("evaluate")
def evaluate_command(
    policy: Annotated[Path, typer.Option(help="Folder of a trained policy, or the name of a shipped one.")],
    split: Annotated[str, typer.Option(help="Which of the frozen scenes.")] = "validation",
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many.")] = None,
    transfer: Annotated[bool, typer.Option("--transfer", help="Play it on Bullet too.")] = False,
    jobs: JobsOption = None,
    benchmark: BenchmarkOption = BENCHMARK,
) -> None:
    """Certify what a trained policy does on frozen scenes."""
    with exit_codes(), _expected():
        from rich.console import Console

        from baselines.benchmark.methods import Method, compete
        from baselines.benchmark.report import in_text
        from baselines.benchmark.scores import summaries
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import tasks_of

        about = load_benchmark(benchmark)
        tasks = tasks_of(about, [Method.trained(policy)], [split], scenes, transfer)
        announce_compilation()
        rows = _run(tasks, compete, None, jobs, None, split, Console())
        for row in rows:
            strain = "" if row["max_strain"] is None else f", strain {row['max_strain']:.3f}"
            typer.echo(f"{split} {row['number']}: {row['reason']}{strain}")
        typer.echo(in_text(summaries(rows, about.seed, about.bootstrap)))


@commands.command("benchmark")
def benchmark_command(
    policies: Annotated[
        Path | None,
        typer.Option(help="Folder that holds trained policies, at any depth; else the shipped ones."),
    ] = None,
    split: Annotated[
        list[str] | None, typer.Option(help="Of the frozen scenes, or NAME:COUNT of them; again for another.")
    ] = None,
    scenes: Annotated[int | None, typer.Option(min=1, help="Only so many of each split.")] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer/--no-transfer", help="Whether policies are played on Bullet too.")
    ] = True,
    out: Annotated[Path, typer.Option(help="Folder for the report, and the journal.")] = RESULTS,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    benchmark: BenchmarkOption = BENCHMARK,
) -> None:
    """Compare planners, trained policies, a random one and doing nothing. A run that stopped goes on."""
    with exit_codes(), _expected():
        from rich.console import Console

        from baselines.benchmark.methods import compete
        from baselines.benchmark.report import write_report
        from baselines.benchmark.splits import load_benchmark
        from baselines.benchmark.tasks import methods_of, tasks_of
        from baselines.learning.policies import TRAINED, load_policy

        about = load_benchmark(benchmark)
        methods = methods_of(about, policies or TRAINED)
        tasks = tasks_of(about, methods, split or list(about.splits), scenes, transfer)
        announce_compilation()
        with usable_folder(out):
            rows = _run(tasks, compete, out / ".benchmark.jsonl", jobs, cluster, "benchmark", Console())
            curves: dict[str, list[Any]] = {}
            for method in methods:
                if method.kind == "policy":
                    curves.setdefault(method.name, []).append(load_policy(method.folder).training["curve"])
            written = write_report(
                rows, out, about.resolution, _command(), curves, about.seed, about.bootstrap
            )
        typer.echo("written: " + ", ".join(str(path) for path in written))


def _recipe(algorithm: str, config: Path | None, steps: int | None, physics: str | None) -> Recipe:
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
    from planners.search import cores

    scenes: list[Any] = [None]
    if recipe.task.scene == "random":
        split = load_benchmark(benchmark).splits["validation"]
        scenes = [scene.dump() for scene in split.scenes(recipe.evaluation.scenes)]
    return Run(recipe, seed, envs or cores(), scenes, str(start) if start else None, demos, _command())


@contextmanager
def _bar() -> Iterator[Any]:
    """A progress bar with the newest evaluation; in no terminal, a line for each evaluation."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console()
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}")
    with Bar(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None)
        said = None

        def told(progress: Progress) -> None:
            nonlocal said
            newest = progress.last
            text = (
                ""
                if newest is None
                else (f"{newest['success']:.0%} succeed, strain {newest['strain']:.2f} of the limit")
            )
            bar.update(task, completed=progress.steps, total=progress.total, description=text)
            if newest is not said and newest is not None and not console.is_terminal:
                typer.echo(f"{newest['steps']} of {progress.total} steps: {text}, {newest['seconds']:.0f} s")
            said = newest

        yield told


def _run(
    tasks: list[dict[str, Any]],
    work: Any,
    journal: Path | None,
    jobs: int | None,
    cluster: str | None,
    title: str,
    console: Any,
) -> list[dict[str, Any]]:
    """Rows of all tasks, with a bar."""
    from contextlib import nullcontext

    from baselines.paper.reproduce import connected, run_told
    from planners.search import cores

    if jobs is not None and cluster is not None:
        raise BadInput("--jobs and --cluster: allowed one of them, the cluster has its own workers")
    with nullcontext() if cluster is None else connected(cluster):
        return run_told(tasks, work, journal, jobs or cores(), cluster is not None, title, console)


def _command() -> str:
    return " ".join(["retract", *sys.argv[1:]])


@contextmanager
def _expected() -> Iterator[None]:
    """What may be wrong with what the user gave, or is not installed, as BadInput."""
    from retract_env.errors import ConfigError

    try:
        with writing(Path()):
            yield
    except ModuleNotFoundError as missing:
        if (missing.name or "").split(".")[0] not in EXTRA:
            raise
        raise BadInput(f"this needs {missing.name}: pip install 'retract[rl]'") from None
    except (ConfigError, ImportError, ConnectionError) as problem:
        raise BadInput(str(problem)) from None
