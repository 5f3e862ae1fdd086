"""A folder that cannot be written to is refused at once, before kernels are compiled or anything computed."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from baselines.cli import main

COMMANDS = {
    "plan": ["plan", "ten_veins", "--out"],
    "compare": ["compare", "ten_veins", "--out"],
    "demos": ["demos", "--journal"],
    "train": ["train", "ppo", "--out"],
    "benchmark": ["benchmark", "--split", "test", "--method", "nothing", "--out"],
    "reproduce": ["reproduce", "fig9", "--out"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_made_is_refused_first(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if command in ("train", "benchmark"):
        pytest.importorskip("stable_baselines3")

    def too_late(*physics: str) -> None:
        raise AssertionError("kernels are compiled first")

    monkeypatch.setattr(import_module(f"baselines.cli.{command}"), "announce_compilation", too_late)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way", "utf-8")
    assert main([*COMMANDS[command], "file/inner"]) == 2
    said, where = capsys.readouterr(), "file" if command == "demos" else "file/inner"
    assert said.err.splitlines() == [f"error: cannot write {where}: not a directory"]
    assert said.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
