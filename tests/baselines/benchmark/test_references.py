"""What scores compare with: the least certified strain of each frozen scene, and who reached it."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from baselines.benchmark.references import Reference, better, load_references, read_rows
from baselines.benchmark.splits import load_benchmark
from baselines.cli import main

ROOT = Path(__file__).resolve().parents[3]
RESULTS = ROOT / "docs" / "results" / "benchmark.csv"


def row(strain: float, **changes: Any) -> dict[str, Any]:
    return {
        "method": "mine",
        "run": 0,
        "split": "test",
        "number": 0,
        "scene_hash": "a",
        "certified": True,
        "max_strain": strain,
    } | changes


def test_only_what_is_certified_and_better_is_kept() -> None:
    first = better([row(0.3), row(0.2, run=1), row(0.1, certified=False)], "fine", "command", {})
    assert first == {"a": Reference(0.2, "mine", 1, "test", 0, "fine", "command")}
    assert better([row(0.25)], "fine", "again", first) == first
    assert better([row(0.1)], "fine", "again", first)["a"].command == "again"


def test_the_shipped_ones_are_no_worse_than_the_published_rows() -> None:
    known = load_references("fine")
    with RESULTS.open(newline="") as file:
        certified = [line for line in csv.DictReader(file) if line["certified"] == "True"]
    best: dict[str, float] = {}
    for line in certified:
        scene, strain = line["scene_hash"], float(line["max_strain"])
        best[scene] = min(best.get(scene, strain), strain)
    assert len(best) >= 100
    assert all(known[scene].strain <= strain for scene, strain in best.items())
    assert better(read_rows(RESULTS), "fine", "", known) == known
    assert load_references("coarse") == {}


def test_they_are_of_the_scenes_that_are_frozen() -> None:
    splits = load_benchmark(ROOT / "configs" / "benchmark.yaml").splits
    scenes = {name: split.scenes() for name, split in splits.items()}
    for scene, reference in load_references("fine").items():
        assert scenes[reference.split][reference.number].hash == scene
        assert 0 < reference.strain <= scenes[reference.split][reference.number].limits.strain
        assert reference.command.startswith("retract benchmark ")
    for name in ("validation", "test"):
        assert {scene.hash for scene in scenes[name]} <= set(load_references("fine"))


def test_a_lone_policy_is_compared_with_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that strains twice as much as the best known retraction is not the best for being alone."""
    pytest.importorskip("rliable")
    halved = {k: replace(known, strain=known.strain / 2) for k, known in load_references("fine").items()}
    monkeypatch.setattr("baselines.benchmark.references.load_references", lambda resolution: halved)
    assert main(["evaluate", "--policy", "ppo-0", "--split", "test", "--scenes", "1", "--jobs", "1"]) == 0
    text = capsys.readouterr().out
    assert "best known 0.090 by fem_gradient" in text
    head, _, line = (part.split("|") for part in text.splitlines()[-3:])
    table = {name.strip(): cell.strip() for name, cell in zip(head, line, strict=True)}
    assert float(table["score"].split()[0]) < 0.7
    assert float(table["excess"].split()[0]) > 50


def test_where_nothing_is_known_nothing_is_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rliable")
    monkeypatch.setattr("baselines.benchmark.references.load_references", lambda resolution: {})
    assert main(["evaluate", "--policy", "bc-0", "--split", "test", "--scenes", "1", "--jobs", "1"]) == 0
    text = capsys.readouterr().out
    assert "no score and no excess: 1 of 1 scenes have no reference" in text
    assert "score |" not in text and "best known" not in text
