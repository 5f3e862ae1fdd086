"""A folder that cannot be written to is refused at once, before kernels are compiled or anything computed."""

from __future__ import annotations

import errno
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


def test_a_study_whose_journal_cannot_grow_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path / ".fig7.jsonl"))

    monkeypatch.setattr("baselines.paper.reproduce.reproduce", full)
    assert main(["reproduce", "fig7", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: cannot write {tmp_path}/.fig7.jsonl: ") and said.count("\n") == 1


def test_a_cluster_that_is_not_there_is_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nowhere(*_: object) -> None:
        raise ConnectionError("no cluster at nowhere:1")

    monkeypatch.setattr("baselines.paper.reproduce.reproduce", nowhere)
    assert main(["reproduce", "fig7", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "error: no cluster at nowhere:1\n"
