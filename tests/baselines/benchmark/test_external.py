"""Methods from elsewhere: judged like ours, and whatever they do costs them their own row alone."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baselines.benchmark import contest
from baselines.benchmark.contest import compete
from baselines.benchmark.external import Nonsense, settings_of
from baselines.benchmark.methods import Method, work_item
from baselines.benchmark.splits import BenchmarkError
from baselines.jobs.journal import run_tasks
from planners import certify
from planners.paths import ctc
from retract_env.grasp import Grasp
from retract_env.scene import Scene
from retract_env.task import default_scene

TOYS = """
import os, sys, time
from planners.paths import ctc
from planners import NoPlan
from retract_env.grasp import Grasp, JawPath

def good(scene):
    print("noise")
    grasp = Grasp(-0.03, 0.2 * scene.tissue.height)
    return grasp, ctc(scene, grasp)

def raises(scene):
    raise KeyError("so\\nmuch")

def hangs(scene):
    time.sleep(1000)

def leaves(scene):
    os._exit(3)

def crashes(scene):
    os.kill(os.getpid(), 11)

def finds_nothing(scene):
    raise NoPlan([])

def none(scene):
    return None

def half(scene):
    return good(scene)[0], "path"

def off(scene):
    grasp, path = good(scene)
    return Grasp(-10.0, grasp.compression), path

def endless(scene):
    grasp, path = good(scene)
    return grasp, JawPath.from_poses([*path.poses] + [path.poses[-1]] * 5000, "endless")

class Up:
    def __init__(self, scene):
        self.actions = iter([(0.0, 0.5, 0.0)])

    def __call__(self, observation):
        return next(self.actions, (0.0, 1.0, 0.0))

def wrong(scene):
    return lambda observation: [1.0, 2.0]

played = []

def once(scene):
    if played:
        raise KeyError("no more")
    played.append(scene)
    return Up(scene)

def blind(scene):
    return lambda observation: observation["image"]
"""


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with a module of methods, which the console is called from."""
    (tmp_path / "toys.py").write_text(TOYS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def task(name: str, **changes: Any) -> dict[str, Any]:
    asked: dict[str, Any] = {"scene": default_scene().dump(), "resolution": "coarse", "limit": 60.0}
    return work_item(**({"method": Method.external(name)} | asked | changes))


def test_a_plan_is_judged_like_ours(toys: Path) -> None:
    row = compete(task("toys:good"))
    scene = Scene.from_data(default_scene().dump())
    grasp = Grasp(-0.03, 0.2 * scene.tissue.height)
    alone = certify(scene, grasp, ctc(scene, grasp), "coarse")
    assert (row["method"], row["certified"], row["max_strain"]) == ("toys:good", True, alone.max_strain)
    assert row["timing"]["seconds"] > 0


FATES = [
    ("raises", "raised", "KeyError: 'so\\nmuch' (toys.py, line "),
    ("leaves", "died", "exit code 3"),
    ("none", "returned", "None, allowed (Grasp, JawPath), a Plan, or a function from an observation"),
    ("half", "returned", "(Grasp, str), allowed (Grasp, JawPath), "),
    ("off", "returned", "grasp.x = -10 m, allowed "),
    ("endless", "returned", "a path of "),
    ("wrong", "returned", "action has shape (2,), allowed (3,)"),
    ("blind", "raised", "IndexError: "),
    ("finds_nothing", "not_visible", ""),
    *([("crashes", "died", "signal 11, SIGSEGV")] if os.name == "posix" else []),
]


@pytest.mark.parametrize(("name", "reason", "detail"), FATES, ids=[fate[0] for fate in FATES])
def test_whatever_it_does_costs_its_own_row(toys: Path, name: str, reason: str, detail: str) -> None:
    row = compete(task(f"toys:{name}"))
    assert (row["certified"], row["reason"], row["max_strain"]) == (False, reason, None)
    assert row["detail"].startswith(detail) and "\n" not in row["detail"]


def test_one_that_hangs_is_ended(toys: Path) -> None:
    survival = {"draws": 40, "seed": 53_000_001, "judged": 1}
    row = compete(task("toys:hangs", limit=2.0, survival=survival))
    assert row["survival"] == 0
    assert (row["certified"], row["reason"], row["detail"]) == (False, "time", "nothing within 2 s")


def test_what_the_certifier_cannot_judge_is_not_certified(
    toys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has a limit, as what comes from elsewhere may take it for ever."""
    monkeypatch.setattr(contest, "JUDGING", 0.01)
    row = compete(task("toys:good"))
    said = "the certifier: time nothing within 0.01 s"
    assert (row["certified"], row["reason"], row["detail"]) == (False, "returned", said)


def test_what_goes_wrong_in_play_is_told(toys: Path) -> None:
    """A policy that acts for as long as it hands in, and never again."""
    survival = {"draws": 1, "seed": 53_000_001, "judged": 0}
    row = compete(task("toys:once", played=1, survival=survival))
    assert row["decisions"] > 0 and row["closed_loop"] == 0
    assert row["detail"].startswith("closed loop: raised KeyError: 'no more' (toys.py, line ")


def test_a_module_that_another_stands_in_for_is_refused(toys: Path) -> None:
    (toys / "yaml.py").write_text(TOYS)
    with pytest.raises(BenchmarkError, match=r"method = 'yaml:good': this program has another module 'yaml'"):
        compete(task("yaml:good"))


@pytest.mark.parametrize(
    "env", ["rod", {"kwargs": [1]}, {"kwargs": {"task": {1, 2}}}, {"kwargs": np.zeros(3)}]
)
def test_settings_of_a_policy_are_plain_data(env: Any) -> None:
    with pytest.raises(Nonsense, match=r"^its attribute env = .*, allowed \{\"kwargs\": \{\.\.\.\}\}"):
        settings_of(SimpleNamespace(env=env))
    assert settings_of(SimpleNamespace()) == settings_of(SimpleNamespace(env=None)) == {}


def test_a_policy_plays(toys: Path, capfd: pytest.CaptureFixture[str]) -> None:
    row = compete(task("toys:Up"))
    assert row["decisions"] == row["evaluations"] > 1 and row["max_strain"] > 0
    assert capfd.readouterr().out == ""


def test_rows_do_not_depend_on_workers(toys: Path) -> None:
    tasks = [task(f"toys:{name}") for name in ("good", "raises", "leaves")]
    alone, together = (run_tasks(tasks, compete, None, jobs) for jobs in (1, 2))
    for row in (*alone, *together):
        row.pop("timing")
    assert alone == together


def test_rows_are_kept_by_its_sources(toys: Path) -> None:
    before = Method.external("toys:good")
    assert before == Method.external("toys:good")
    assert before.folder == str(toys.resolve())
    (toys / "toys.py").write_text(TOYS + "# another line\n")
    assert Method.external("toys:good").content != before.content
    package = toys / "pack" / "inner"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").write_text("")
    (package / "mine.py").write_text("def f(scene): ...\n")
    with pytest.raises(BenchmarkError, match=r"^toys:good: its files have changed since the run began"):
        compete(task("toys:good", method=before))
    contents = [Method.external("pack.inner.mine:f").content]
    for other in ("weights.bin", "other.py"):
        (package.parent / other).write_text("1")
        contents.append(Method.external("pack.inner.mine:f").content)
    (package.parent / "__pycache__").mkdir()
    (package.parent / "__pycache__" / "other.pyc").write_text("1")
    assert Method.external("pack.inner.mine:f").content == contents[-1]
    assert len(set(contents)) == 3


def test_its_module_is_not_run_to_find_it(toys: Path) -> None:
    (toys / "bomb.py").write_text("raise SystemExit\n\ndef f(scene): ...\n")
    assert Method.external("bomb:f").kind == "external"
    row = compete(task("bomb:f"))
    assert (row["reason"], row["detail"]) == ("raised", "SystemExit (bomb.py, line 1)")


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("toys:god", r"^method = 'toys:god': .*toys\.py has no 'god'$"),
        (
            "tois:good",
            r"^method = 'tois:good': no module 'tois', allowed one of this folder, or an installed",
        ),
        ("toys.inner:good", r"^method = 'toys\.inner:good': there is no module 'toys\.inner'$"),
        ("toys:", r"^method = 'toys:', allowed the name of a method, or module:function$"),
        ("toys.py:good", r"^method = 'toys\.py:good': there is no module 'toys\.py'$"),
        ("a b:c", r"^method = 'a b:c', allowed the name of a method, or module:function$"),
    ],
)
def test_what_does_not_exist_is_refused_in_one_line(toys: Path, named: str, message: str) -> None:
    with pytest.raises(BenchmarkError, match=message):
        Method.external(named)
