"""The soak, in short: what it tries is sound, and it tells what may happen from what may not."""

from __future__ import annotations

import json
import os
import signal
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks._report import ROOT
from retract_env.errors import SceneError
from retract_env.scene import Scene
from soak.__main__ import main
from soak.bugs import BUGS
from soak.caches import compiled
from soak.damaged import READERS, damage, read
from soak.episodes import played
from soak.guided import guided
from soak.interruptions import COMMANDS, _half_written, stopped
from soak.outcomes import WRONG, apart
from soak.plans import planned
from soak.scenes import wide_scene

# --- What is tried


def test_wide_scenes_are_wide_and_mostly_accepted() -> None:
    scenes, refused = [], 0
    for number in range(200):
        assert wide_scene(number) == wide_scene(number)
        try:
            scenes.append(Scene.from_data(wide_scene(number)))
        except SceneError:
            refused += 1  # veins that touch
    assert 0 < refused < 40
    heights = [scene.tissue.height for scene in scenes]
    assert min(heights) < 1e-3 and max(heights) > 1.5e-2
    moduli = [scene.tissue.modulus for scene in scenes]
    assert min(moduli) < 1e3 and max(moduli) > 5e6
    assert {scene.bed for scene in scenes} == {True, False}
    stiffest = max(v.modulus / s.tissue.modulus for s in scenes for v in s.tissue.veins)
    assert stiffest > 500 and max(len(s.tissue.veins) for s in scenes) > 20
    assert 15 <= sum(not scene.neo_hookean for scene in scenes) <= 20
    slopes = np.degrees([scene.line_of_sight.slope for scene in scenes])
    assert slopes.min() < 10 and slopes.max() > 85


def test_damage_is_the_same_for_a_number_and_changes_something() -> None:
    sound = b"name: it\nvalue: 3.5\n" * 20
    damaged = [damage(sound, np.random.default_rng([number, 3])) for number in range(100)]
    assert damaged == [damage(sound, np.random.default_rng([number, 3])) for number in range(100)]
    assert sum(content != sound for content in damaged) > 90


def test_a_fuzzer_that_learns_finds_nothing_in_short() -> None:
    pytest.importorskip("atheris")
    row = guided({"kind": "journal", "runs": 200, "limit": 300.0})
    assert row["outcome"] == "ended", row
    assert sum(row["tried"].values()) == 200


def test_every_planted_error_has_a_place() -> None:
    for bug in BUGS.values():
        assert (ROOT / bug.file).read_text("utf-8").count(bug.sound) == 1
        assert bug.wrong != bug.sound
        assert all((ROOT / test).exists() for test in bug.tests)


# --- What comes of it


@pytest.mark.parametrize("kind", READERS)
def test_damaged_files_are_read_or_refused_in_one_line(kind: str) -> None:
    found = read({"kind": kind, "first": 0, "count": 40, "limit": 120.0})
    assert found["outcome"] == "ended", found["detail"]
    assert found["tried"]["refused"] > 0


@pytest.mark.parametrize("number", [14, 19, 30])
def test_planners_answer_on_wide_scenes(number: int) -> None:
    """On these the flap's weight used to find no rest."""
    found = planned({"number": number, "planner": "circular", "limit": 120.0})
    assert found["outcome"] in ("certified", "no plan"), found
    assert found["tried"].get("diverged", 0) < sum(found["tried"].values())


@pytest.mark.parametrize("physics", ["rod", "fem"])
def test_episodes_end(physics: str) -> None:
    found = played({"part": physics, "first": 0, "count": 4, "limit": 300.0})
    assert found["outcome"] == "ended", found["detail"]
    assert sum(found["tried"].values()) == 4


@pytest.mark.parametrize("end", ["interrupt", "full disk"])
def test_a_plan_that_is_stopped_leaves_nothing_half_written(end: str) -> None:
    found = stopped({"command": "plan", "end": end, "number": 0})
    assert found["outcome"] == "went on", found["detail"]


# --- What it tells apart


def warned(_: Any) -> dict[str, Any]:
    warnings.warn("something is off", stacklevel=1)
    return {"outcome": "ended"}


def hung(_: Any) -> dict[str, Any]:
    time.sleep(60)
    return {"outcome": "ended"}


def died(_: Any) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGKILL)
    return {"outcome": "ended"}


@pytest.mark.parametrize(
    ("work", "limit", "outcome"), [(warned, 60.0, "raised"), (hung, 1.0, "time"), (died, 60.0, "died")]
)
def test_what_may_not_happen_is_told(work: Any, limit: float, outcome: str) -> None:
    found = apart(work, {}, limit)
    assert found["outcome"] == outcome in WRONG


def test_processes_that_compile_at_the_same_time_leave_whole_kernels() -> None:
    assert compiled({"processes": 3}) == {"outcome": "same"}


def test_half_a_file_is_found(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text('{"scene": ')
    assert "plan.json" in _half_written(tmp_path)
    (tmp_path / "plan.json").write_text("{}")
    (tmp_path / ".view-1a2b.html").write_text("<html>")  # a temporary name, left behind by a kill
    (tmp_path / "view.html").write_text("<html>")
    assert "view.html: it has no end" in _half_written(tmp_path)
    (tmp_path / "view.html").write_text("<html></html>")
    assert _half_written(tmp_path) == ""


def test_it_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["rod", "--share", "0.0003", "--jobs", "1", "--out", str(tmp_path)]
    assert main(command) == 0
    first = json.loads((tmp_path / "soak.json").read_text())
    assert first["rod"]["outcomes"] == {"ended": 1} and first["rod"]["wrong"] == []
    capsys.readouterr()
    assert main(command) == 0
    assert "1 of 1 were done before" in capsys.readouterr().out
    assert json.loads((tmp_path / "soak.json").read_text())["rod"] == first["rod"]


def test_unknown_parts_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["boats"])
    assert ended.value.code == 2 and "unknown boats" in capsys.readouterr().err
    assert COMMANDS.keys() >= {"plan", "train", "benchmark"}
