"""`retract benchmark` from end to end, on two flaps and the coarse mesh."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from baselines.benchmark.splits import hash_of
from baselines.cli import main
from baselines.jobs.version import code_version
from retract_env.config import CONFIGS, read_yaml
from retract_env.scene import sample_scene

MINE = """
import os
from planners.paths import ctc
from retract_env.grasp import Grasp

def good(scene):
    grasp = Grasp(-0.6 * scene.tissue.length, 0.25 * scene.tissue.height)
    return grasp, ctc(scene, grasp)

def dies(scene):
    os._exit(3)
"""
METHODS = ("--method", "mine:good", "--method", "mine:dies", "--method", "nothing")


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The command, in a folder with two methods and a benchmark of two flaps."""
    scenes = [sample_scene(np.random.default_rng([5, k])) for k in range(2)]
    data = read_yaml(CONFIGS / "benchmark.yaml") | {"resolution": "coarse", "bootstrap": 50, "limit": 60}
    data["splits"] = {"toy": {"version": 2, "seed": 5, "count": 2, "hash": hash_of(scenes)}}
    data["survival"] |= {"draws": 20, "judged": 0}
    (tmp_path / "toy.yaml").write_text(yaml.safe_dump(data))
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return ["benchmark", "--benchmark", "toy.yaml", "--no-transfer", *METHODS]


def lines(file: Path) -> list[dict[str, Any]]:
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def test_a_run_goes_on_and_its_numbers_do_not_depend_on_workers(
    toy: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rliable")
    assert main([*toy, "--out", "first", "--jobs", "1", "--scenes", "1"]) == 0
    first = (tmp_path / "first" / "benchmark.md").read_text()
    assert "## toy: 1 scenes" in first and "A try on the first 1 of its 2 scenes" in first
    assert main([*toy, "--out", "first", "--jobs", "1"]) == 0
    assert "3 of 6 were done before" in capsys.readouterr().out
    assert main([*toy, "--out", "second", "--jobs", "2"]) == 0
    assert (tmp_path / "first" / "benchmark.csv").read_bytes() == (
        tmp_path / "second" / "benchmark.csv"
    ).read_bytes()
    text = (tmp_path / "second" / "benchmark.md").read_text()
    assert (
        "A try" not in text
        and f"version 2, {lines(tmp_path / 'first' / 'benchmark.csv')[0]['split_hash']}" in text
    )
    assert "* mine:dies: died exit code 3, 2 times" in text
    rows = lines(tmp_path / "second" / "benchmark.csv")
    assert [(row["number"], row["method"]) for row in rows] == [
        (k, name) for k in "01" for name in ("nothing", "mine:good", "mine:dies")
    ]
    assert {(row["split_version"], row["code"]) for row in rows} == {("2", code_version())}
    for row in rows:
        assert 0 <= float(row["survival"]) <= float(row["certified"] == "True")
    kept = [
        json.loads(line)["row"] for line in (tmp_path / "first" / ".benchmark.jsonl").read_text().splitlines()
    ]
    assert {row["split_hash"] for row in kept} == {rows[0]["split_hash"]}


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["--method", "luck"], "error: method = 'luck', allowed ctc, "),
        (["--method", "mine:best"], "error: method = 'mine:best': "),
        (["--split", "exam"], "error: split = 'exam', allowed toy, each with :COUNT or without"),
        (["--limit", "0"], "error: limit = 0.0 s, allowed [1, 86400] s"),
    ],
)
def test_what_is_wrong_is_one_line(
    toy: list[str], asked: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rliable")
    assert main([*toy, *asked]) == 2
    said = capsys.readouterr().err
    assert said.startswith(message) and said.count("\n") == 1
