"""What is said in the window, in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

ASKS = "Where should the jaws take hold of the flap?"
MOVES = "Lift the flap until the camera sees the bed as far as B."
HINT = "Friction rises where the jaws drag the flap along its length or bend it: turn with it, go slowly."
"""While nothing else is to be told of a move."""
GOES_BACK = "Going back: the moves before are made again ..."
IN_VIEW = "The camera sees the target."
ENDS = {
    "strain": "The tissue was strained too much.",
    "slip": "The tissue slipped in the jaws.",
    "release": "A jaw lost the tissue.",
    "contact": "The tissue ran into itself, or into the block that holds its fixed end.",
    "diverged": "No equilibrium of the tissue was found from here on.",
    "time": "A minute of motion is over, and the target is still hidden.",
}
"""Why an episode ended without success, by the environment's name for it."""
JUDGED = {
    "not_visible": "tissue still hides the target",
    "strain": "the tissue is strained too much",
    "slip": "the tissue slips in the jaws",
    "release": "a jaw loses the tissue",
    "contact": "the tissue runs into itself or the fixed block",
    "torn": "the tissue tears",
    "diverged": "no equilibrium was found",
}
"""Why a certificate says no, by its name for it."""

CALLED = {"ctc": "The planner of 2009", "swift": "The planner swift"}
"""Planners that are asked while a person plays."""

HELP = {
    "grasp": (
        "arrows or mouse: place and grip     wheel: grip     Enter or click: close the jaws",
        "Shift: slowly     R: restart     N: new flap     Esc: quit",
    ),
    "move": (
        "arrows, WASD or dragging: move     Q, E or wheel: turn     Shift: slowly",
        "U: take back     R: restart     N: new flap     Esc: quit",
    ),
    "back": ("", "R: restart     N: new flap     Esc: quit"),
    "ended": ("R: try this flap again     N: new flap     Esc: quit", ""),
    "broken": ("U: take the last move back     R: try this flap again     N: new flap     Esc: quit", ""),
}
"""The two lines of keys, by what the person is at."""
PAD_HELP = {
    "grasp": "gamepad: left stick, place and grip; A, close; X, restart; Y, new flap",
    "move": "gamepad: left stick moves, right one or shoulders turn; B, take back; X, restart; Y, new flap",
    "back": "gamepad: X, restart; Y, new flap",
    "ended": "gamepad: X, restart; Y, new flap",
    "broken": "gamepad: B, take back; X, restart; Y, new flap",
}
"""The second line where there is a gamepad, likewise."""


@dataclass(frozen=True)
class Lines:
    """All text of the window but for the picture's own."""

    scene: str
    headline: str
    detail: str
    comparison: str
    keys: tuple[str, ...]
    pad: str
    """the second line of keys where there is a gamepad"""
    good: bool | None = None
    """whether the headline is good news; None: neither"""


@dataclass
class Known:
    """What others strain a scene's tissue by, as far as it is known by now."""

    old: float | None = None
    """the planner of 2009"""
    old_none: bool = False
    """it was asked and found nothing"""
    best: float | None = None
    best_by: str = ""
    """who found the best"""
    planned: bool = False
    """the best is what `swift` found in this session; else it is the benchmark's"""
    best_none: bool = False
    failed: list[str] = field(default_factory=list)
    """planners that could not be asked"""


def number(strain: float) -> str:
    """A strain as papers write it: .257"""
    return f"{strain:.3f}".removeprefix("0")


def told(known: Known) -> list[str]:
    """What others strain the flap by, a clause each; nothing that was not computed."""
    said = []
    if known.old is not None:
        said.append(f"the 2009 planner by {number(known.old)}")
    elif known.old_none:
        said.append("the 2009 planner finds nothing certified")
    if known.best is not None and known.planned:
        said.append(f"{known.best_by}, which planned just now, by {number(known.best)}")
    elif known.best is not None:
        said.append(f"the best known is {number(known.best)} ({known.best_by})")
    elif known.best_none:
        said.append("swift finds nothing certified")
    said += [f"{name} could not be asked" for name in known.failed]
    return said


def compared(strain: float | None, known: Known, waiting: str) -> str:
    """The line that compares; strain: the person's by a certificate, None before there is one; waiting: whom
    an answer is awaited from, ""."""
    others = "; ".join(told(known))
    if strain is not None:
        others = f"You strained the tissue by {number(strain)}" + (f"; {others}" if others else "")
    elif others:
        others = f"Others strain it: {others}"
    busy = f"{CALLED[waiting]} is at work ..." if waiting else ""
    return " ".join(part for part in (others and f"{others}.", busy) if part)


def judged(certificate: Mapping[str, Any]) -> str:
    """A certificate in one line."""
    friction = certificate["required_friction"]
    needed = (
        "" if isinstance(friction, str) else f", friction {friction:.2f} of {certificate['friction_limit']:g}"
    )
    if certificate["certified"]:
        strain, limit = number(certificate["max_strain"]), f"{certificate['strain_limit']:g}"
        return f"Certified by finite elements: strain {strain} of {limit.removeprefix('0')}{needed}."
    reason = JUDGED.get(certificate["reason"], certificate["reason"])
    return f"Not certified: on the finite elements {reason}."
