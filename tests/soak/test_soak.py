"""The soak, in short: what it tries is sound, and it tells what may happen from what may not."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks._report import ROOT
from retract_env.errors import SceneError
from retract_env.scene import Scene
from soak import bugs, interruptions
from soak.__main__ import main, summary
from soak.bugs import BUGS, Bug, planted
from soak.caches import compiled
from soak.damaged import READERS, damage, read
from soak.episodes import grown, played
from soak.guided import guided, guided_tasks
from soak.interruptions import COMMANDS, Command, _half_written, stopped
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


def ended(_: Any) -> dict[str, Any]:
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


@pytest.mark.parametrize("name", ["table.csv", "scene.yaml", "picture.png", "film.gif"])
def test_a_file_that_was_cut_is_found(name: str, tmp_path: Path) -> None:
    file, size = tmp_path / name, (40, 30)
    if name == "table.csv":
        file.write_text("a,b\n" + "1,2\n" * 50)
    elif name == "scene.yaml":
        file.write_text("veins: [" + "1, " * 50 + "2]\n")
    else:
        frames = [Image.effect_noise(size, 50 + k) for k in range(3)]
        frames[0].save(file, save_all=name.endswith("gif"), append_images=frames[1:])
    whole = file.read_bytes()
    assert _half_written(tmp_path) == ""
    for part in (0.3, 0.5, 0.8, 0.99):
        file.write_bytes(whole[: int(part * len(whole))])
        assert name in _half_written(tmp_path)


@pytest.mark.parametrize("ends", [True, False])
def test_a_command_that_goes_on_after_an_interrupt_is_told(
    ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = "import signal, sys, time; signal.signal(signal.SIGINT, lambda *_: {}); time.sleep(3)"
    heard = heard.format("sys.exit(130)" if ends else "None")
    monkeypatch.setattr(interruptions, "RETRACT", [sys.executable, "-c", heard])
    monkeypatch.setattr(interruptions, "PATIENCE", 0.05 if not ends else 60.0)
    monkeypatch.setattr(interruptions, "COMMANDS", {"plan": Command(("plan",))})
    found = stopped({"command": "plan", "end": "interrupt", "number": 4})
    assert found["outcome"] == ("went on" if ends else "unsound"), found
    assert ends or "still at work" in found["detail"]


def test_what_a_process_holds_may_not_grow_for_ever() -> None:
    before = {"memory": 2**29, "files": 10}
    assert grown(before, {"memory": 2**29 + 2**27, "files": 10}) == ""
    assert grown(before, {"memory": 2**29, "files": 11}) == "11 open files, before 10"
    assert grown(before, {"memory": 2**31, "files": 10}) == "2048 MB of memory, before 512"
    blocks = [
        {"outcome": "ended", "steps": 1, "slowest": 0.1, "after": before | {"memory": 2**29 * k}}
        for k in (1, 2, 3)
    ]
    (wrong,) = summary([{"part": "rod", "first": k} for k in range(3)], blocks)["wrong"]
    assert "from the first block to the last: 1536 MB of memory, before 512" in wrong["detail"]


@pytest.mark.parametrize(
    ("tests", "wrong", "outcome"),
    [
        ("def test_it(): assert two() == 2", "3", "caught"),
        ("def test_it(): assert two() > 1", "3", "unsound"),
        ("def test_it(missing): assert two() == 2", "3", "unsound"),  # an error, which says nothing
        ("def test_it(): assert two() == 2", "", "passed"),
        ("def test_it(): assert two() == 4", "", "unsound"),
    ],
)
def test_a_planted_error_is_caught_by_a_test_that_fails_for_it_alone(
    tests: str, wrong: str, outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sums.py").write_text("def two():\n    return 2\n")
    (tmp_path / "test_sums.py").write_text(f"from sums import two\n\n\n{tests}\n")
    monkeypatch.setattr(bugs, "ROOT", tmp_path)
    monkeypatch.setattr(bugs, "COPIED", ("sums.py", "test_sums.py"))
    monkeypatch.setattr(
        bugs, "BUGS", {"three": Bug("sums.py", "return 2", f"return {wrong}", ("test_sums.py",))}
    )
    none, three = bugs.bug_tasks(1, "code")
    assert none["tests"] == ["test_sums.py"]
    assert planted(three if wrong else none)["outcome"] == outcome


def test_it_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["rod", "--share", "0.0003", "--jobs", "1", "--out", str(tmp_path)]
    assert main(command) == 0
    first = json.loads((tmp_path / "soak.json").read_text())
    assert first["rod"]["outcomes"] == {"ended": 1} and first["rod"]["wrong"] == []
    capsys.readouterr()
    assert main(command) == 0
    assert "1 of 1 were done before" in capsys.readouterr().out
    assert json.loads((tmp_path / "soak.json").read_text())["rod"] == first["rod"]


def test_a_part_that_is_tried_again_leaves_what_others_came_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def tasks(count: int, code: str) -> list[dict[str, Any]]:
        return [{"part": "one", "number": number, "code": code} for number in range(count)]

    parts = {"one": (2, tasks, ended), "two": (4, tasks, ended), "none": (1, lambda *_: [], ended)}
    monkeypatch.setattr("soak.__main__.PARTS", parts)
    where = ["--jobs", "1", "--out", str(tmp_path)]
    assert main(where) == 0
    assert "none: skipped, what it needs is not installed" in capsys.readouterr().out
    assert not (tmp_path / "none.jsonl").exists()
    assert main(["two", "--share", "0.5", *where]) == 0
    found = json.loads((tmp_path / "soak.json").read_text())
    assert {part: of["tried"] for part, of in found.items()} == {"one": 2, "two": 2}
    assert all(of["code"] and of["machine"] for of in found.values())


def test_without_atheris_no_fuzzer_is_journaled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("soak.guided.importlib.util.find_spec", lambda _: None)
    assert guided_tasks(10, "code") == []


def test_unknown_parts_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["boats"])
    assert ended.value.code == 2 and "unknown boats" in capsys.readouterr().err
    assert COMMANDS.keys() >= {"plan", "train", "benchmark"}
