"""How trainings went, as a table and a picture."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from baselines.benchmark import curves
from baselines.learning.policies import save_policy
from tests.baselines.trained import policy


def test_every_evaluation_of_every_seed_is_a_line(tmp_path: Path) -> None:
    policies, out = tmp_path / "policies", tmp_path / "out"
    for seed, ends in enumerate([(0.5, 1.0), (0.0, 0.75)]):
        curve = [{"steps": 10 * (k + 1), "success": end, "strain": 1 - end / 2} for k, end in enumerate(ends)]
        trained = policy(name="mine", training={"seed": seed, "curve": curve})
        save_policy(trained, policies / f"mine-{seed}")
    curves.main([str(policies), str(out)])
    with (out / "training.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [(line["policy"], line["seed"], line["steps"], line["success"]) for line in lines] == [
        ("mine", "0", "10", "0.5"),
        ("mine", "0", "20", "1.0"),
        ("mine", "1", "10", "0.0"),
        ("mine", "1", "20", "0.75"),
    ]
    assert (out / "training.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_without_policies_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="holds no policy"):
        curves.main([str(tmp_path), str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
