"""One page out of motions and words: everything is in the file, nothing is fetched."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from baselines.pictures.page.motion import SQUEEZE, Motion
from baselines.pictures.page.pack import motion_data, palette_data, scene_data
from retract_env import __version__
from retract_env.drawing.palette import METHODS

if TYPE_CHECKING:
    from retract_env.scene import Scene

SCRIPTS = ("data.js", "flap.js", "stage.js", "charts.js", "main.js")


@dataclass(frozen=True)
class Tried:
    """Something else than the plan: another candidate, or a flap as it may turn out to be."""

    title: str
    cells: tuple[str, ...]
    """of its row in the table"""
    told: tuple[str, ...]
    """sentences, for who opens it"""
    motion: Motion | None = None
    """by the rod"""
    scene: Scene | None = None
    """of the motion, where it is not the plan's"""
    chosen: bool = False


@dataclass(frozen=True)
class Table:
    """What was tried, under a heading."""

    heading: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[Tried, ...]
    words: int = 2
    """the first columns, which are in words"""


@dataclass(frozen=True)
class Shown:
    """A plan as the page shows it."""

    name: str
    scene: Scene
    motion: Motion
    good: bool
    """whether it is certified"""
    verdict: str
    """in one or two words"""
    told: tuple[str, ...]
    """verdict and margins, sentences"""
    robust: tuple[str, ...]
    """what is said of flaps that are not quite as the scene says; nothing where nothing is stated"""
    tables: tuple[Table, ...] = ()


def page(plans: Sequence[Shown], pair: Sequence[int] | None = None) -> str:
    """The page, HTML.

    pair: the one or two plans that are shown first, side by side; the first ones if not given.
    Raises ValueError where there is no plan, or more than have colours.
    """
    if not 1 <= len(plans) <= len(METHODS):
        raise ValueError(f"plans: {len(plans)}, allowed 1 to {len(METHODS)}")
    pair = list(range(len(plans)))[:2] if pair is None else list(pair)
    names = list(dict.fromkeys(plan.scene.name.replace("_", " ") for plan in plans))
    heading = " and ".join(names) + ", retracted"
    lead = (
        "A flap of tissue is grasped by two jaws and lifted until the area of interest on the bed (green) "
        "can be seen along the line AB from the camera. Darker tissue is strained more."
    )
    if len(pair) > 1:
        lead += " The motions run in step: each at the same share of its own path."
    data = {
        "palette": palette_data(),
        "squeeze": SQUEEZE,
        "plans": [_plan_data(k, plan) for k, plan in enumerate(plans)],
    }
    return _filled(
        part("page.html"),
        {
            "title": escape(heading),
            "heading": escape(heading),
            "lead": lead,
            "css": _filled(part("page.css"), palette_data()),
            "many": "two" if len(pair) > 1 else "one",
            "views": "\n".join(_view(k, plans) for k in pair),
            "plans": "\n".join(_card(k, plan) for k, plan in enumerate(plans)),
            "footer": escape(f"Made by retract {__version__}. What is shown is a simulation, not a patient."),
            "data": script_json(data),
            "three": in_script(part("three.min.js")),
            "script": in_script("\n".join(part(name) for name in SCRIPTS)),
        },
    )


def script_json(data: object) -> str:
    """JSON that may stand in a script element, whatever its texts are."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":  # nothing that ends the element, or begins a comment in it
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def in_script(code: str) -> str:
    """Code that may stand in a script element. Raises ValueError where it may not."""
    if re.search(r"</script|<!--", code, re.IGNORECASE):
        raise ValueError("a script of the page would end its own element")
    return code


@cache
def part(name: str) -> str:
    """The text of a file that lies beside this one."""
    return files(__package__).joinpath(name).read_text("utf-8")


def _filled(template: str, values: Mapping[str, str]) -> str:
    """The template with {{name}} replaced, once: what is put in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda found: values[found[1]], template)


def _plan_data(k: int, plan: Shown) -> dict[str, object]:
    tried = {_key(t, r): row for t, table in enumerate(plan.tables) for r, row in enumerate(table.rows)}
    return {
        "name": plan.name,
        "colour": METHODS[k],
        "good": plan.good,
        "verdict": plan.verdict,
        "scene": scene_data(plan.scene),
        "motion": motion_data(plan.motion),
        "tried": {
            key: {
                "title": row.title,
                "motion": motion_data(row.motion),
                **({} if row.scene is None else {"scene": scene_data(row.scene)}),
            }
            for key, row in tried.items()
            if row.motion is not None
        },
    }


def _key(table: int, row: int) -> str:
    return f"{table}-{row}"


def _view(k: int, plans: Sequence[Shown]) -> str:
    name = f"<h2>{escape(plans[k].name)}</h2>"
    if len(plans) > 1:
        options = "".join(
            f'<option value="{i}"{" selected" if i == k else ""}>{escape(plan.name)}</option>'
            for i, plan in enumerate(plans)
        )
        name = f'<select aria-label="Plan shown here">{options}</select>'
    return (
        f'<section class="view" data-plan="{k}" style="--plan: {METHODS[k]}" aria-label="Picture">'
        f'<div class="head">{name}{_badge(plans[k])}</div>'
        '<div class="frame"><canvas tabindex="0" role="img" aria-label="The flap"></canvas>'
        '<p class="nothing">This browser draws nothing in three dimensions (WebGL 2); curves and numbers are '
        "below.</p>"
        '<div class="note" hidden><span></span><button type="button">back to the plan</button></div>'
        "</div></section>"
    )


def _badge(plan: Shown) -> str:
    return f'<span class="badge{"" if plan.good else " bad"}">{escape(plan.verdict)}</span>'


def _card(k: int, plan: Shown) -> str:
    parts = [f'<div class="key"><h2>{escape(plan.name)}</h2>{_badge(plan)}</div>', _list(plan.told)]
    if plan.robust:
        parts += ["<h3>Flaps that are not quite as the scene says</h3>", _list(plan.robust)]
    parts += [_table(k, t, table) for t, table in enumerate(plan.tables) if table.rows]
    return f'<section class="plan" style="--plan: {METHODS[k]}">{"".join(parts)}</section>'


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _table(k: int, t: int, table: Table) -> str:
    heads = "".join(
        f'<th scope="col"{_word(i < table.words)}>{escape(column)}</th>'
        for i, column in enumerate(table.columns)
    )
    rows = "".join(_row(k, t, r, row, table.words) for r, row in enumerate(table.rows))
    head = f'<thead><tr><th scope="col"><span aria-label="More"></span></th>{heads}</tr></thead>'
    return (
        f'<details><summary>{escape(table.heading)}</summary><p class="soft">{escape(table.note)}</p>'
        f'<div class="wide"><table>{head}'
        f"<tbody>{rows}</tbody></table></div></details>"
    )


def _row(k: int, t: int, r: int, row: Tried, words: int) -> str:
    name = f"told-{k}-{_key(t, r)}"
    cells = "".join(f"<td{_word(i < words)}>{escape(cell)}</td>" for i, cell in enumerate(row.cells))
    chosen = ' class="chosen"' if row.chosen else ""
    told = " ".join(escape(line) for line in row.told)
    if row.motion is not None:
        told += (
            f' <button type="button" data-plan="{k}" data-tried="{_key(t, r)}">show its motion, by the rod'
            "</button>"
        )
    return (
        f"<tr{chosen}>"
        f'<td><button type="button" aria-expanded="false" aria-controls="{name}" '
        f'aria-label="Open {escape(row.title)}">open</button></td>{cells}</tr>'
        f'<tr class="told" id="{name}" hidden><td colspan="{len(row.cells) + 1}">{told}</td></tr>'
    )


def _word(in_words: bool) -> str:
    return ' class="word"' if in_words else ""
