"""Starting the console: what is imported, what is compiled, what is found by its name."""

from __future__ import annotations

import builtins
import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

import planners
from baselines.cli import console, main
from baselines.cli.work import command_line
from planners.base import NoPlan

ROOT = Path(__file__).resolve().parents[3]


def test_a_shipped_scene_is_planned_by_its_name_in_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "homogeneous").mkdir()
    assert main(["plan", "homogeneous", "--resolution", "coarse", "--workers", "1", "--no-pictures"]) == 0
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["scene"]["name"] == "homogeneous"


def test_help_answers_without_the_numerics() -> None:
    code = """
import sys
from baselines.cli import main
assert main(["plan", "--help"]) == 0
assert not {"numba", "scipy", "matplotlib", "planners", "retract_env.scene"} & set(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for option in (
        "--planner",
        "--grip",
        "--time",
        "--robust",
        "--known",
        "--out",
        "--resolution",
        "--workers",
        "--verify",
        "--no-pictures",
        "--format",
    ):
        assert option in done.stdout


def test_ctrl_c_while_the_console_is_still_being_imported_is_one_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(name: str, *rest: object, **more: object) -> object:
        if name == "baselines.cli.app":
            raise KeyboardInterrupt
        return found(name, *rest, **more)  # type: ignore[arg-type]

    found = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", interrupted)
    assert main(["--version"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_the_command_that_a_file_names_can_be_given_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["benchmark", "--method", "mine:a b", "--out", "what's new"]
    monkeypatch.setattr(sys, "argv", ["/usr/bin/retract", *given])
    assert shlex.split(command_line()) == ["retract", *given]


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("retract ")


def test_garbage_is_looked_for_seldom_only_in_a_process_of_the_command() -> None:
    """Whoever calls `main` from a program of theirs keeps their own pace."""
    code = """
import gc, sys
from baselines.cli import main
before = gc.get_threshold()
main(["--version"])
assert gc.get_threshold() == before
sys.argv[1:] = ["--version"]
main()
assert gc.get_threshold() > before
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_first_run_shows_that_it_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line now and then, where there is no terminal; in later runs nothing."""
    command = ["plan", "homogeneous", "--out", str(tmp_path), "--no-pictures"]

    def fail(*_: object, **__: object) -> None:
        raise NoPlan([])

    monkeypatch.setattr(planners, "plan", fail)
    monkeypatch.setattr(console, "TOLD_EVERY", 0.02)
    monkeypatch.setattr(console, "_use_every_kernel", lambda: time.sleep(0.2))
    for cached in (False, True):
        monkeypatch.setattr("retract_env.fem.kernels_are_cached", lambda physics, cached=cached: cached)
        assert main(command) == 1
        text = capsys.readouterr().out
        assert ("first run: compiling the finite-element kernels, some 20 s" in text) is not cached
        assert ("0 s of some 20, now starting" in text) is not cached


@pytest.mark.slow
def test_the_first_run_compiles_all_that_a_plan_needs(tmp_path: Path) -> None:
    code = """
from numba.core.event import install_recorder
from baselines.cli import main
from baselines.cli.console import announce_compilation
import retract_env.fem
assert not retract_env.fem.kernels_are_cached()
announce_compilation("fem", "planning")
assert retract_env.fem.kernels_are_cached()
with install_recorder("numba:compile") as recorder:
    assert main(["plan", "ten_veins", "--no-pictures", "--resolution", "coarse"]) == 0
assert not recorder.buffer, {event.data["dispatcher"] for _, event in recorder.buffer}
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "numba"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"s of some \d+, now \w+", done.stdout)
