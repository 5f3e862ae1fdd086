"""The pages against the code: tables say what the task says, examples run, links lead somewhere."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
from itertools import dropwhile, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from retract_env.env import TissueRetractEnv
from retract_env.mesh import SLIVER
from retract_env.task import LAYOUT, SIZE, SLICES, TaskConfig, Weights

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "environment.md").read_text("utf-8")
WITH_EXAMPLES = (
    "../README",
    "index",
    "quick-start",
    "certificate",
    "environment",
    "learning",
    "benchmark",
    "reference/index",
)
"""Pages whose Python is executed here; how-to-add's is by test_how_to_add, notebooks by test_notebooks."""
TEXTS = "".join((ROOT / "docs" / f"{name}.md").read_text("utf-8") for name in WITH_EXAMPLES)
EXAMPLES = list(dict.fromkeys(re.findall(r"```python\n(.*?)```", TEXTS, re.DOTALL)))
PAGES = sorted([*ROOT.glob("[A-Z]*.md"), *(ROOT / "docs").rglob("*.md")])
NEEDS = {"stable_baselines3": "stable_baselines3", "RecordVideo": "moviepy"}


def rows(text: str, heading: str) -> list[list[str]]:
    """Cells of the tables' rows under a heading, without their heads."""
    section = text.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    lines = [line.strip() for line in section.splitlines() if line.strip().startswith("|")]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    heads = {k - 1 for k, row in enumerate(cells) if all(re.fullmatch(r"-+:?", cell) for cell in row)}
    return [row for k, row in enumerate(cells) if k not in heads and k - 1 not in heads]


def test_the_observations_are_the_layout() -> None:
    for row, part in zip(rows(PAGE, "Observation Space"), LAYOUT, strict=True):
        span = SLICES[part.name]
        numbers = str(span.start) if part.size == 1 else f"{span.start}-{span.stop - 1}"
        assert row == [numbers, f"`{part.name}`", part.meaning, f"{part.low:g}", f"{part.high:g}", part.unit]
    assert f"{SIZE} numbers with finite bounds" in PAGE


def test_the_reward_has_the_tasks_terms_and_weights() -> None:
    documented = {name: float(weight) for name, weight, _ in rows(PAGE, "Rewards")}
    assert documented == {f"`{name}`": weight for name, weight in Weights().model_dump().items()}
    assert f"**Truncated** after {TaskConfig().steps} steps" in PAGE


def test_the_actions_are_those_of_the_docstring_and_of_the_code() -> None:
    documented = rows(PAGE, "Action Space")
    assert documented == rows(inspect.cleandoc(TissueRetractEnv.__doc__ or ""), "Action Space")
    (x, compression, none), moves = documented[:3], documented[3:]
    assert x[3] == f"{0.5 + SLIVER:g} jaw widths before the fixed end" and none[1] == "none"
    light, firm = TaskConfig().compression
    assert compression[2:] == [f"{light:g} s height", f"{firm:g} height"]
    steps = np.array([float(row[3].split()[0]) for row in moves]) * [1e-3, 1e-3, np.radians(1)]
    assert steps == pytest.approx(TaskConfig().move)


def test_every_argument_is_listed_with_its_default() -> None:
    listed = {name.strip("`"): default.strip("`") for name, default, _ in rows(PAGE, "Arguments")}
    parameters = list(inspect.signature(TissueRetractEnv).parameters.values())[1:]  # the id is the physics
    assert listed == {p.name: f'"{p.default}"' if p.default else "None" for p in parameters}


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_examples_run(example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for word, module in NEEDS.items():
        if word in example:
            pytest.importorskip(module)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    shorter = example.replace("total_timesteps=100_000", "total_timesteps=8").replace(
        "n_steps=64", "n_steps=2"
    )
    exec(compile(shorter, "example", "exec"), {})


def test_the_planner_retracts_random_flaps() -> None:
    """The one in the rods' look-ahead, on flaps that the page does not show."""
    planner = next(example for example in EXAMPLES if "def play(" in example)
    space: dict[str, Any] = {}
    exec(compile(planner, "planner", "exec"), space)
    assert len(planner.splitlines()) <= 60
    for seed in (1, 2, 3):
        succeeded, steps = space["play"](seed)
        assert succeeded and steps < 40


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_links_lead_somewhere(page: Path) -> None:
    prose = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)", prose):
        assert target.startswith("https://") or (page.parent / target).exists(), target


HOMES = ("retract_env", "planners", "baselines", "benchmarks", "configs", "docs", "tests")


def paths_named(text: str) -> set[str]:
    """Paths in a text: what begins with a folder of the tree, and every file of Python."""
    folders = rf"(?<![\w./-])(?:{'|'.join(HOMES)})/[\w./*-]*"
    named = re.findall(rf"{folders}|(?<![\w./-])[\w/-]+\.py\b", text)
    modules = re.findall(r"python -m (benchmarks(?:\.\w+)+)", text)
    return {name.rstrip(".") for name in named} | {f"{module.replace('.', '/')}.py" for module in modules}


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_paths_that_are_named_exist(page: Path) -> None:
    named = paths_named(re.sub(r"\]\(https://[^)]*\)", "]", page.read_text("utf-8")))
    assert [path for path in sorted(named) if not list(ROOT.glob(path.replace("NAME", "*")))] == []


@pytest.mark.parametrize("folder", ["retract_env", "planners", "baselines", "benchmarks"])
def test_the_commands_that_sources_name_exist(folder: str) -> None:
    for source in sorted((ROOT / folder).rglob("*.py")):
        for module in re.findall(r"python -m ((?:\w+\.)+\w+)", source.read_text("utf-8")):
            assert (ROOT / f"{module.replace('.', '/')}.py").exists(), f"{source}: {module}"


def made(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What make would do."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    return subprocess.run(["make", "-n", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


def test_what_measures_is_run_or_left_out_by_name() -> None:
    """As modules, for they import each other."""
    scripts = {p.stem for p in (ROOT / "benchmarks").glob("*.py") if "__main__" in p.read_text("utf-8")}
    said = made("bench").stdout
    run = re.findall(r"for name in (.*?);", said, re.DOTALL)[0].replace("\\", "").split()
    left_out = re.findall(r"left out: (.*?);", said)[0].split(", ")
    assert sorted([*run, *left_out]) == sorted(scripts)
    assert "python -m benchmarks.$name" in said


def test_results_go_where_make_is_told() -> None:
    assert ".venv/bin/retract compare ten_veins --out out/\n" in made("demo").stdout  # as README says
    for folder in ("elsewhere/x", "elsewhere/x/"):
        assert "-m soak --out elsewhere/x/soak" in made("soak", f"OUT={folder}").stdout
    for spaced in ("VENV=my env", "OUT=my results"):
        refused = made("clean", spaced)
        assert refused.returncode != 0 and "allowed are paths without spaces" in refused.stderr


def test_what_lives_where_names_every_folder() -> None:
    """The table in how-it-works has a row for each room, so that a newcomer finds it."""
    page = (ROOT / "docs" / "how-it-works.md").read_text("utf-8")
    rooms = {p.parent.relative_to(ROOT).as_posix() for p in ROOT.glob("[!.]*/*/__init__.py")}
    assert {room for room in rooms if f"`{room}/" not in page} == set()


TEMPLATE = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
)


def test_the_environments_page_follows_gymnasiums_template() -> None:
    headings = re.findall(r"^## (.*)$", PAGE, re.MULTILINE)
    assert [heading for heading in headings if heading in TEMPLATE] == list(TEMPLATE)
    low, high = TaskConfig().reward_range
    assert f"| reward | in [{low:g}, {high:g}]" in PAGE


def table(text: str, heading: str) -> dict[str, dict[str, str]]:
    """The rows of the first table under a heading, by their first cell, each by column."""
    section = text.partition(f"## {heading}")[2].partition("\n## ")[0].splitlines()
    begins = dropwhile(lambda line: not line.startswith("|"), section)
    lines = takewhile(lambda line: line.startswith("|"), begins)
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    head, _, *body = cells
    return {row[0]: dict(zip(head, row, strict=True)) for row in body}


@pytest.mark.parametrize("page", ["README.md", "docs/benchmark.md"])
def test_pages_tell_the_benchmarks_results(page: str) -> None:
    told = table((ROOT / page).read_text("utf-8"), "Planners and learners compared")
    found = table((ROOT / "docs" / "results" / "benchmark.md").read_text("utf-8"), "test")
    assert len(told) >= 5
    for method, row in told.items():
        assert row == {column: found[method][column] for column in row}
