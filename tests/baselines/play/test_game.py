"""The game without a window: certificates, comparisons, what is said and what is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from baselines.benchmark.references import Reference
from baselines.play import game as games
from baselines.play.aside import Said
from baselines.play.game import Command, Drive, Game
from baselines.play.scenes import named_scene, random_scene
from baselines.play.session import Phase
from planners.base import plan_from_json
from planners.certify import Certificate, certify
from retract_env.errors import ConfigError
from tests.baselines.play.person import (
    FIRM,
    GRASP,
    RIVALS,
    SILENT,
    Answering,
    directions,
    game,
)

GOOD = {
    "certified": True,
    "reason": "ok",
    "max_strain": 0.1642,
    "strain_limit": 0.5,
    "required_friction": 0.42,
    "friction_limit": 0.5,
}


class Judge(Answering):
    """Answers with the same certificate whenever it is asked."""

    def __init__(self, answer: Said) -> None:
        super().__init__(SILENT)
        self.answer = answer

    def ask(self, work: Any, argument: Any) -> None:
        self.asked.append(work.__name__)
        self._said, self.busy = [self.answer], True


def take_hold(played: Game) -> None:
    played.drive(Drive(place=GRASP, firmer=FIRM))
    played.command(Command.CONFIRM)


def retract(played: Game) -> None:
    take_hold(played)
    for x, y, turn in directions():
        if played.session.phase is not Phase.MOVE:
            break
        played.drive(Drive(x, y, turn))
        played.tick()
    assert played.session.success


def slip(played: Game) -> None:
    take_hold(played)
    while played.session.phase is Phase.MOVE:
        played.drive(Drive(0, 1, 1))
        played.tick()


def test_what_was_played_is_certified_compared_and_written(tmp_path: Path) -> None:
    played = game(tmp_path, Answering(), Answering(RIVALS))
    for _ in range(2):
        played.tick()
    assert played.lines.comparison == (
        "Others strain it: the 2009 planner by .257; swift, which planned just now, by .110."
    )
    retract(played)
    played.tick()
    scene, grasp, path = plan_from_json(json.loads((tmp_path / "play.json").read_text()))
    written = Certificate.from_json(json.loads((tmp_path / "play.certificate.json").read_text()))
    assert scene == played.dealt.scene and written.certified
    assert written == certify(scene, grasp, path, "coarse")
    lines = played.lines
    strain = f"{written.max_strain:.3f}".removeprefix("0")
    assert lines.good and lines.headline == "The camera sees the target."
    assert lines.detail.startswith(f"Certified by finite elements: strain {strain} of .5")
    assert lines.comparison == (
        f"You strained the tissue by {strain}; the 2009 planner by .257; swift, which planned just now, "
        "by .110."
    )
    played.close()
    assert len(list(tmp_path.iterdir())) == 2


def test_nothing_is_said_of_others_that_was_not_computed(tmp_path: Path) -> None:
    played = game(tmp_path)
    assert played.lines.comparison == "The planner of 2009 is at work ..."
    failing = {"ctc": Said("done", {"none": "9 candidates: 9 slip"}), "swift": Said("failed", "it has died")}
    played = game(tmp_path, rival=Answering(failing))
    for _ in range(3):
        played.tick()
    assert played.lines.comparison == (
        "Others strain it: the 2009 planner finds nothing certified; swift could not be asked."
    )


def test_a_best_strain_that_is_known_is_not_planned_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = named_scene("ten_veins").scene
    known = Reference(0.0831, "fem_gradient", 0, "test", 0, "coarse", "")
    monkeypatch.setattr(games, "load_references", lambda resolution: {scene.hash: known})
    rival = Answering(RIVALS)
    played = game(tmp_path, rival=rival)
    for _ in range(3):
        played.tick()
    assert len(rival.asked) == 1
    assert played.lines.comparison == (
        "Others strain it: the 2009 planner by .257; the best known is .083 (fem_gradient)."
    )


def test_the_shipped_references_are_those_of_the_frozen_scenes(tmp_path: Path) -> None:
    played = game(tmp_path, dealt=named_scene("test:3"), resolution="fine")
    assert "the best known is ." in played.lines.comparison


def test_a_broken_limit_is_said_and_taken_back_with_its_certificate(tmp_path: Path) -> None:
    judge = Answering(SILENT)
    played = game(tmp_path, judge)
    slip(played)
    assert played.lines.headline == "The tissue slipped in the jaws." and played.lines.good is False
    assert judge.asked == ["certificate"] and "U: take" in played.lines.keys[0]
    played.command(Command.UNDO)
    assert not judge.busy and played.session.phase is Phase.MOVE
    played.tick()
    assert played.lines.headline != "The tissue slipped in the jaws."
    played.close()
    assert list(tmp_path.iterdir()) == []


def test_a_certificate_that_says_no_is_told_and_written(tmp_path: Path) -> None:
    bad = GOOD | {"certified": False, "reason": "not_visible"}
    played = game(tmp_path, Judge(Said("done", bad)))
    retract(played)
    played.tick()
    assert played.lines.good is False
    assert played.lines.detail.startswith("Not certified: on the finite elements tissue still hides the")
    assert "You strained" not in played.lines.comparison
    assert (tmp_path / "play.json").exists() and (tmp_path / "play.certificate.json").exists()


def test_a_certificate_that_could_not_be_made_is_told(tmp_path: Path) -> None:
    played = game(tmp_path, Judge(Said("failed", "MeshError: too thin")))
    retract(played)
    played.tick()
    assert played.lines.detail == "No certificate: MeshError: too thin."


@pytest.mark.parametrize("how", [Command.QUIT, Command.RESTART, Command.NEW])
def test_what_succeeded_is_kept_though_its_certificate_is_not_there_yet(tmp_path: Path, how: Command) -> None:
    numbers = iter(range(5))
    played = game(tmp_path, Answering(SILENT), deal=lambda: random_scene(next(numbers)))
    retract(played)
    assert list(tmp_path.iterdir()) == []
    played.command(how)
    played.close()
    assert played.over is (how is Command.QUIT)
    assert [file.name for file in tmp_path.iterdir()] == ["play.json"]
    plan_from_json(json.loads((tmp_path / "play.json").read_text()))


def test_plans_get_names_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "play.json").write_text("mine")
    played = game(tmp_path, Judge(Said("done", GOOD)))
    for _ in range(2):
        retract(played)
        played.tick()
        played.command(Command.RESTART)
    assert (tmp_path / "play.json").read_text() == "mine"
    assert [Path(file).name for file in played.written] == ["play-2.json", "play-3.json"]


def test_a_new_flap_is_compared_anew_and_an_old_one_not_again(tmp_path: Path) -> None:
    rival = Answering(RIVALS)
    scenes = iter([random_scene(4), named_scene("ten_veins")])
    played = game(tmp_path, rival=rival, deal=lambda: next(scenes))
    for _ in range(3):
        played.tick()
    played.command(Command.NEW)
    assert played.dealt.name == "random flap 4" and played.lines.comparison.startswith("The planner of 2009")
    assert len(rival.asked) == 3
    played.command(Command.NEW)
    assert "swift" in played.lines.comparison and len(rival.asked) == 3


@pytest.mark.parametrize("deal", [None, lambda: random_scene(4)])
def test_a_new_flap_is_offered_where_there_is_one(tmp_path: Path, deal: Any) -> None:
    lines = game(tmp_path, deal=deal).lines
    offered = ["new flap" in said for said in (" ".join(lines.keys), lines.pad)]
    assert offered == [deal is not None] * 2


def test_a_random_flap_is_the_one_that_the_environment_draws(tmp_path: Path) -> None:
    dealt = random_scene(12)
    played = game(tmp_path, dealt=dealt)
    assert played.session.env.episode.task.scene == dealt.scene


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nothing", "no such file"),
        ("best:1", "no split 'best', allowed validation, test, shifted"),
        ("validation:32", "allowed validation:0 to validation:31"),
    ],
)
def test_a_scene_that_is_none_is_refused_in_one_line(name: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        named_scene(name)
