"""The game without its window: sessions, their certificates, what others do, what is said and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Protocol

from baselines.benchmark.references import load_references
from baselines.play import judging, words
from baselines.play.aside import Said, Work
from baselines.play.handing_in import handed_in
from baselines.play.keeping import AUTHOR, PlanFiles, Recorder
from baselines.play.scenes import Dealt
from baselines.play.session import FRAMES, SLOW, TASK, Phase, Session
from baselines.play.words import Known, Lines
from retract_env.env import TissueRetractEnv

OLD, NEW = "ctc", "swift"
"""The planner of 2009, and the one that is asked where no best strain is known."""

NAMED = 18
"""Characters of a scene's name for which there is room."""


class Command(Enum):
    """What a person may ask for once, by a key, a click or a button."""

    CONFIRM = "confirm"
    UNDO = "undo"
    RESTART = "restart"
    NEW = "new"
    QUIT = "quit"


@dataclass(frozen=True)
class Drive:
    """What a person asks for as long as a key is held, in one frame."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0
    """each in [-1, 1]"""
    slow: bool = False
    towards: tuple[float, float] | None = None
    """m, where the jaws' midpoint is dragged to, which counts instead of x and y"""
    place: float | None = None
    """m, along the flap, where the mouse points to while the grasp is chosen"""
    firmer: float = 0.0
    """by how much the grip is to be firmer, at once"""


class Worker(Protocol):
    """Who computes aside; see `Aside`."""

    busy: bool

    def start(self) -> None: ...
    def ask(self, work: Work, argument: Any) -> None: ...
    def poll(self) -> list[Said]: ...
    def close(self) -> None: ...


class Game:
    """What a person does, scene after scene."""

    def __init__(
        self,
        dealt: Dealt,
        deal: Callable[[], Dealt] | None,
        physics: str,
        judge: Worker,
        rival: Worker,
        files: PlanFiles,
        recorder: Recorder | None = None,
        resolution: str = "fine",
    ):
        """dealt: the scene to begin with; deal: deals a new one, None where there is none to come; judge,
        rival: compute certificates, and what planners do; resolution: of both."""
        self.physics, self.resolution = physics, resolution
        self._deal, self._judge, self._rival = deal, judge, rival
        self._files, self._recorder = files, recorder
        self._references = load_references(resolution)
        self._known: dict[str, Known] = {}
        self.over = False
        self.written: list[str] = []
        """files of plans, in the order of their making"""
        self._env: TissueRetractEnv | None = None
        self._source: Any = None
        judge.start()
        self._begin(dealt)

    # --- Scenes

    def _begin(self, dealt: Dealt) -> None:
        if self._env is None or self._source != dealt.source:
            if self._env is not None:
                self._env.close()
            self._env = TissueRetractEnv(self.physics, scene=dealt.source, task=TASK)
            self._source = dealt.source
        self.dealt, self.session = dealt, Session(self._env, dealt)
        self._forget_end()
        self._waiting = ""
        if self._rival.busy:
            self._rival.close()  # it is at another scene
        self._ask_rivals()

    def _forget_end(self) -> None:
        self._plan: dict[str, Any] | None = None
        self._certificate: dict[str, Any] | None = None
        self._key: str | None = None
        self._ended = False
        self._note = self._trouble = ""
        if self._judge.busy:
            self._judge.close()
            self._judge.start()

    @property
    def known(self) -> Known:
        """What others do with the scene."""
        return self._known.setdefault(self.dealt.scene.hash, Known())

    def _ask_rivals(self) -> None:
        """Have the next thing computed that is not known of the scene."""
        known, reference = self.known, self._references.get(self.dealt.scene.hash)
        if reference is not None:
            known.best, known.best_by = reference.strain, reference.method
        self._waiting = ""
        if known.old is None and not known.old_none and OLD not in known.failed:
            self._waiting = OLD
        elif known.best is None and not known.best_none and NEW not in known.failed:
            self._waiting = NEW
        if self._waiting:
            task = {
                "scene": self.dealt.scene.dump(),
                "planner": self._waiting,
                "resolution": self.resolution,
            }
            self._rival.ask(judging.rival, task)

    # --- What a person does

    def command(self, command: Command) -> None:
        """Do what was asked for once."""
        if command is Command.QUIT:
            self.over = True
        elif command is Command.CONFIRM:
            self.session.confirm()
        elif command is Command.UNDO:
            if self.session.undo():
                self._forget_end()
                self._note = "Taken back."
        elif command is Command.RESTART:
            self._leave()
            self.session.restart()
            self._forget_end()
        elif self._deal is None:
            self._note = "One scene is recorded here; without SCENE, --record takes random flaps."
        else:
            self._leave()
            self._begin(self._deal())

    def drive(self, drive: Drive, seconds: float = 1 / FRAMES) -> None:
        """One frame of what is held; seconds: since the last."""
        session = self.session
        if session.phase is Phase.GRASP:
            if drive.place is not None:
                session.propose_at(drive.place)
            pace = seconds * (SLOW if drive.slow else 1.0)  # half the flap a second
            session.propose(session.along + pace * drive.x, session.firmness + pace * drive.y + drive.firmer)
        elif session.phase is Phase.BACK:
            session.go_on()
        elif drive.towards is not None:
            session.move_towards(*drive.towards, drive.turn, seconds, drive.slow)
        else:
            session.move((drive.x, drive.y, drive.turn), seconds, drive.slow)
        if len(session) > 1 and session.phase is Phase.MOVE and (drive.x or drive.y or drive.turn):
            self._note = ""

    # --- What comes of it

    def tick(self) -> None:
        """See what has ended, and what was computed aside. Raises OSError where a file cannot be written."""
        if self.session.phase is Phase.ENDED and not self._ended:
            self._end()
        for said in self._judge.poll():
            if said.kind == "progress":
                self._note = f"The finite elements follow what you did: {said.value} increments ..."
            elif said.kind == "done":
                self._certified(said.value)
            else:
                self._trouble = f"No certificate: {said.value}."
        for said in self._rival.poll():
            if said.kind != "progress":
                self._learn(said)
                self._ask_rivals()

    def _end(self) -> None:
        self._ended, session = True, self.session
        if session.success and self._recorder is not None:
            self._key = self._recorder.keep(self.dealt, session.played)
        found = handed_in(session.env.episode, session.success)
        if found is None:
            self._note = "The jaws never closed, so that there is nothing to certify."
            return
        from planners.base import plan_to_json  # which the window need not wait for as it opens

        self._plan = plan_to_json(self.dealt.scene, AUTHOR, *found, self.resolution)
        self._note = "The finite elements follow what you did ..."
        self._judge.ask(judging.certificate, self._plan)

    def _certified(self, certificate: dict[str, Any]) -> None:
        self._certificate = certificate
        if self._key is not None and self._recorder is not None:
            self._recorder.certify(self._key, certificate)
        self._write()

    def _write(self) -> None:
        """Write the plan, with its certificate where there is one."""
        if self._plan is not None:
            self.written.append(str(self._files.write(self._plan, self._certificate)))
            self._plan = None

    def _leave(self) -> None:
        """Before the scene is left: what succeeded is kept, also without its certificate."""
        if self._ended and self.session.success:
            self._write()

    def _learn(self, said: Said) -> None:
        known, who = self.known, self._waiting
        if said.kind == "failed":
            known.failed.append(who)
        elif who == OLD:
            known.old, known.old_none = said.value.get("strain"), "none" in said.value
        else:
            known.best, known.best_by = said.value.get("strain"), NEW
            known.planned, known.best_none = True, "none" in said.value

    def close(self) -> None:
        """Keep what succeeded, and end all that goes on aside. Raises OSError."""
        try:
            self._leave()
        finally:
            self._judge.close()
            self._rival.close()
            if self._env is not None:
                self._env.close()

    # --- What is said

    @property
    def lines(self) -> Lines:
        """All text of the window now."""
        session, phase = self.session, self.session.phase
        at = "broken" if session.failure else phase.value
        strain = None
        if self._certificate is not None and self._certificate["certified"]:
            strain = self._certificate["max_strain"]
        compared = words.compared(strain, self.known, self._waiting)
        keys: tuple[str, ...] = words.HELP[at]
        pad = words.PAD_HELP[at]
        if self._deal is None:
            keys = tuple(line.replace("     N: new flap", "") for line in keys)
            pad = pad.replace("; Y, new flap", "")
        if phase is Phase.ENDED:
            good = session.success
            headline = words.IN_VIEW if good else words.ENDS[session.failure]
            if self._certificate is not None:
                detail = words.judged(self._certificate)
                if self.written:
                    detail += f" Written: {Path(self.written[-1]).name}"
                good = good and self._certificate["certified"]
            else:
                detail = self._trouble or self._note
            return Lines(self._scene, headline, detail, compared, keys, pad, good)
        headline = {Phase.GRASP: words.ASKS, Phase.MOVE: words.MOVES, Phase.BACK: words.GOES_BACK}[phase]
        detail = self._note or (words.HINT if phase is Phase.MOVE else "")
        if phase is Phase.GRASP and not detail:
            grasp, height = session.proposed, self.dealt.scene.tissue.height
            detail = (
                f"{-1e3 * grasp.x:.1f} mm from the fixed end; the jaws close by "
                f"{1e3 * grasp.compression:.2f} of {1e3 * height:.1f} mm. Too light a grip slips, too firm "
                "a one strains."
            )
        return Lines(self._scene, headline, detail, compared, keys, pad)

    @property
    def _scene(self) -> str:
        name = self.dealt.name if len(self.dealt.name) <= NAMED else f"{self.dealt.name[:NAMED]}\u2026"
        return name if self._recorder is None else f"{name}, {len(self._recorder)} recorded"
