"""What a study is, and the three files that it ends in: a table, a picture, a page of text."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from baselines.jobs.files import csv_text, written_whole
from baselines.jobs.journal import Row
from baselines.jobs.version import code_version
from baselines.paper.experiments import Experiment
from baselines.pictures.drawing import STYLE
from retract_env.scene import LineOfSight, Scene, load_scene

DPI = 160
EQUAL = 0.02
"""Strains that differ by less than this part count as equal: the finite elements know them no better."""

Agreement = Literal["yes", "in part", "no"]


@dataclass(frozen=True)
class Claim:
    """One thing that is said, and what the data say to it."""

    said: str
    found: str
    agrees: Agreement


@dataclass(frozen=True)
class Report:
    """What a study found."""

    title: str
    question: str
    """what was done, in a few sentences"""
    table: Sequence[Mapping[str, Any]]
    figure: Figure
    claims: Sequence[Claim]
    notes: Sequence[str] = field(default=())


@dataclass(frozen=True)
class Study:
    """Experiments to be done, and what is made of their rows."""

    name: str
    about: str
    """one line"""
    experiments: Callable[[], list[Experiment]]
    report: Callable[[Sequence[Row]], Report]


def paper_scene(name: str) -> Scene:
    """A shipped scene, by its name. Raises SceneError for an unknown one."""
    return load_scene(name)


def with_line(scene: Scene, position: float, slope: float) -> Scene:
    """The scene with another line of sight: position of B as a part of the length from the fixed end, slope,
    rad."""
    line = LineOfSight.at(-position * scene.tissue.length, slope)
    return scene.model_copy(update={"line_of_sight": line})


def new_figure(width: float, height: float) -> Figure:
    """A figure of that size, inches, to be drawn in the STYLE context."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def write(study: Study, rows: Sequence[Row], folder: Path, resolution: str, of: int = 0) -> list[Path]:
    """Write NAME.csv, NAME.png and NAME.md, all or none; returns their paths. Raises OSError.

    of: how many rows the study has, where these may not be all; the page says so then.
    """
    unfinished = ""
    if len(rows) < of:
        unfinished = f"Unfinished: {len(rows):,} of {of:,} rows are there, and what is said is of these."
    with matplotlib.rc_context(STYLE):
        report = study.report(rows)
        picture = io.BytesIO()
        report.figure.savefig(picture, format="png", dpi=DPI, metadata={"Software": None})
    contents = {
        "csv": table_text(report.table).encode(),
        "png": picture.getvalue(),
        "md": page(study, report, resolution, unfinished).encode(),
    }
    paths = {ending: folder / f"{study.name}.{ending}" for ending in contents}
    with ExitStack() as all_or_none:
        for ending, content in contents.items():
            all_or_none.enter_context(written_whole(paths[ending])).write_bytes(content)
    return list(paths.values())


def table_text(table: Sequence[Mapping[str, Any]]) -> str:
    """CSV; numbers with six digits."""
    return csv_text([{k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in table])


def page(study: Study, report: Report, resolution: str, unfinished: str = "") -> str:
    """The text, in Markdown; unfinished: how many rows there are, where these are not all."""
    claims = [f"| {c.said} | {c.found} | {c.agrees} |" for c in report.claims]
    parts = [
        f"# {report.title}",
        report.question,
        *([unfinished] if unfinished else []),
        f"![{report.title}]({study.name}.png)",
        "\n".join(["| said | found | agrees |", "| --- | --- | --- |", *claims]),
        *report.notes,
        f"Data: [{study.name}.csv]({study.name}.csv). Made {'of what there is of' if unfinished else 'by'} "
        f"`retract reproduce {study.name} --resolution {resolution}`, retract {code_version()}.",
    ]
    return "\n\n".join(parts) + "\n"


def percent(part: float) -> str:
    """25 % for 0.25."""
    return f"{100 * part:.0f} %"


def number(value: Any) -> float:
    """A row's number; infinities are texts there."""
    return float(value)
