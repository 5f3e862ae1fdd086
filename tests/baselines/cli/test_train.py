"""`retract train` from the console: what it refuses, and how it stops and goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")
pytest.importorskip("tensorboard")

from baselines.cli import main
from baselines.cli.console import announce_compilation
from baselines.learning.train import CHECKPOINT
from retract_env.config import CONFIGS, read_yaml
from retract_env.fem import kernels, kernels_are_cached
from retract_env.physics.registry import PHYSICS
from tests.baselines.trained import recipe

ROOT = Path(__file__).resolve().parents[3]
SMALL = {"rollout": 16, "batch_size": 8, "epochs": 1}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "recipe.yaml"
    file.write_text(yaml.safe_dump(recipe("ppo", 10**6, 10**6, 32, **SMALL).dump()))
    return file


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["ppo", "--from", "nope"], "nope/policy.json: no such file"),
        (["ppo", "--from", "bc-0"], "network: layers, activation and output "),
        (["ppo", "--demos", "3"], "demos = 3, but ppo learns from no data set"),
        (["sac"], "algorithm = 'ppo', asked for 'sac'"),
        (["ddpg"], "algorithm = 'ddpg', allowed ppo, ppo_lagrangian, sac, tqc, bc"),
        (["ppo", "--physics", "jelly"], "task.physics = 'jelly', allowed bullet, fem, rod"),
        (["ppo", "--resume", "--benchmark", "b"], "--config, --envs, --benchmark: not with --resume"),
    ],
)
def test_what_cannot_be_trained_leaves_nothing(
    tmp_path: Path, config: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["train", *options, "--config", str(config), "--envs", "1", "--out", str(out)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert not out.exists()


def test_scenes_to_be_judged_on_that_there_are_not_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = read_yaml(CONFIGS / "benchmark.yaml")
    del data["splits"]["validation"]
    (tmp_path / "benchmark.yaml").write_text(yaml.safe_dump(data))
    greedy = recipe("ppo", 48, 16, **SMALL).dump()
    greedy["task"]["scene"] = "random"
    greedy["evaluation"]["scenes"] = 100
    (tmp_path / "greedy.yaml").write_text(yaml.safe_dump(greedy))
    for option, said in (
        (["--benchmark", str(tmp_path / "benchmark.yaml")], "splits shifted, test, allowed with validation"),
        (["--config", str(tmp_path / "greedy.yaml")], "evaluation.scenes = 100, allowed 32 at most"),
    ):
        assert main(["train", "ppo", *option, "--out", str(tmp_path / "run")]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "run").exists()


def test_a_scene_that_the_physics_refuses_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pybullet")
    data = recipe("ppo", 48, 16, **SMALL).dump()
    data["task"]["scene"]["tissue"]["density"] = 0.0
    (tmp_path / "recipe.yaml").write_text(yaml.safe_dump(data))
    options = ["--physics", "bullet", "--config", str(tmp_path / "recipe.yaml"), "--envs", "1"]
    assert main(["train", "ppo", *options, "--out", str(tmp_path / "run")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "error: task.scene: tissue.density = 0 kg/m^3, allowed in Bullet" in lines[0]
    assert not (tmp_path / "run").exists()


def test_interrupted_it_says_how_to_go_on(tmp_path: Path, config: Path) -> None:
    """Ctrl-C reaches the environments' processes as well; what is said is one line."""
    out = tmp_path / "run"
    console = "import sys; from baselines.cli.app import main; sys.exit(main())"
    command = [sys.executable, "-c", console, "train", "ppo", "--config", str(config), "--envs", "2"]
    process = subprocess.Popen(
        [*command, "--out", str(out)], cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 240
        while not (out / CHECKPOINT).exists():
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    finally:
        if process.poll() is None:  # else its environments would go on for ever
            os.killpg(process.pid, signal.SIGKILL)
    assert errors == f"interrupted; go on with `retract train ppo --resume --out {out}`\n"
    assert process.returncode == 130


def test_what_compiles_is_said_for_what_is_used(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bullet needs the residual alone; what is compiled for another processor does not count."""
    from numba.core.registry import cpu_target

    here = cpu_target.target_context.codegen().magic_tuple()

    def keep(kernel: object, *processors: object) -> None:
        index = {("signature", processor, "code"): "file" for processor in processors}
        monkeypatch.setattr(kernel._cache._cache_file, "_load_index", lambda: index)  # type: ignore[attr-defined]

    keep(kernels.residual, here)
    keep(kernels.tangent, ("x86_64", "another", ""))
    assert kernels_are_cached("bullet") and not kernels_are_cached("fem")
    announce_compilation("bullet")
    assert capsys.readouterr().out == ""
    announce_compilation("fem")
    assert "first run: compiling" in capsys.readouterr().out
    keep(kernels.tangent, here)
    assert kernels_are_cached("fem")


@pytest.mark.parametrize("name", [*PHYSICS, "planning"])
def test_kernels_of_every_kind_are_asked_for(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Those that were never compiled are, and only those."""
    from baselines.cli import console
    from retract_env import compilation, fem

    compiled: list[str] = []
    monkeypatch.setattr(console, "_compile", lambda kernels, _: compiled.append(kernels))
    for cached in (True, False):
        monkeypatch.setattr(fem, "kernels_are_cached", lambda _, cached=cached: cached)
        asked: list[Any] = []

        def is_cached(kernel: Any, asked: list[Any] = asked, cached: bool = cached) -> bool:
            asked.append(kernel._cache._cache_file)  # only what numba keeps has one
            return cached

        monkeypatch.setattr(compilation, "is_cached", is_cached)
        announce_compilation(name)
        assert len(compiled) == (not cached)
        assert len(asked) == (name in ("rod", "planning"))
