"""Verification of the certifier: code, solution, and the sizes of its assumptions. After ASME V&V 40."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.study import Claim, Report, Study, new_figure, number
from baselines.verification.assumptions import BASES, CHANGES, with_change
from baselines.verification.code import CHECKS
from baselines.verification.solution import CASES, MESHES, QUANTITIES, Converged, indices, on_mesh
from retract_env.drawing.palette import GREY, LIMIT, VALUE

WORDS = {"max_strain": "eps_max", "required_friction": "friction", "clearance": "clearance"}
ALLOWED = {"max_strain": 0.03, "required_friction": 0.06, "clearance": 0.005}
"""Of the grid convergence index of `fine`: relative, of clearance over the length."""


def _experiments() -> list[Experiment]:
    checks = [
        Experiment(f, kw, {"group": "code", "what": what, "unit": unit}) for what, f, kw, unit in CHECKS
    ]
    solution = [
        Experiment(on_mesh, {"case": case, "mesh": mesh}, {"group": "solution", "what": case, "mesh": mesh})
        for case in CASES
        for mesh in MESHES
    ]
    assumed = [
        Experiment(
            with_change, {"case": case, "change": change}, {"group": "model", "what": case, "change": change}
        )
        for case in BASES
        for change in CHANGES
    ]
    return [*checks, *solution, *assumed]


def _report(rows: Sequence[Row]) -> Report:
    checks = [row for row in rows if row["group"] == "code"]
    cases = {
        case: indices(
            {row["mesh"]: row for row in rows if row["group"] == "solution" and row["what"] == case}
        )
        for case in dict.fromkeys(row["what"] for row in rows if row["group"] == "solution")
    }
    model = [row for row in rows if row["group"] == "model"]
    table = [*map(_check_line, checks), *_solution_lines(cases), *_model_lines(model)]
    figure = new_figure(11.0, 3.8)
    panels = figure.subplots(1, 3)
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        _draw(axes, quantity, cases)
    panels[0].set_yticks(range(len(cases)), list(cases), fontsize=8.5)
    for axes in panels[1:]:
        axes.set_yticks(range(len(cases)), [])
    held = sum(line["holds"] == "yes" for line in table if line["group"] == "code")
    claims = [
        Claim(
            "Each of the closed forms, rates and laws is met within its tolerance",
            f"{held} of {len(checks)}",
            "yes" if held == len(checks) else "no",
        )
    ]
    for quantity in QUANTITIES:
        worst = max(cases, key=lambda case: cases[case][quantity].index)
        index = cases[worst][quantity].index
        of = " of the length" if quantity == "clearance" else ""
        claims.append(
            Claim(
                f"{WORDS[quantity]} of `fine`: convergence index at most {100 * ALLOWED[quantity]:g} %{of}",
                f"at most {100 * index:.2g} % ({worst})",
                "yes" if index <= ALLOWED[quantity] else "no",
            )
        )
    return Report(
        "Verification",
        "Are the equations solved right? *Code*: closed forms, rates of convergence and laws, each with a "
        "tolerance. *Solution*: eight retractions on three meshes, followed to the same place, with the grid "
        "convergence index of `fine`, the mesh of certificates. *Model*: the same motions of the jaws with "
        "one assumption changed.",
        table,
        figure,
        claims,
        [_told(checks, "code"), _solution_text(cases), _model_text(model)],
    )


def _holds(row: Row) -> bool:
    return number(row["least"]) <= number(row["value"]) <= number(row["most"])


def _check_line(row: Row) -> dict[str, object]:
    return {
        "group": "code",
        "what": row["what"],
        "found": number(row["value"]),
        "unit": row["unit"],
        "least": number(row["least"]),
        "most": number(row["most"]),
        "holds": "yes" if _holds(row) else "no",
    }


def _line(group: str, what: str, found: float, most: float = math.nan) -> dict[str, object]:
    holds = "" if math.isnan(most) else "yes" if found <= most else "no"
    return {
        "group": group,
        "what": what,
        "found": found,
        "unit": "",
        "least": "",
        "most": "" if math.isnan(most) else most,
        "holds": holds,
    }


def _solution_lines(cases: dict[str, dict[str, Converged]]) -> list[dict[str, object]]:
    return [
        _line("solution", f"{case}: index of {WORDS[name]}", found.index, ALLOWED[name])
        for case, by_name in cases.items()
        for name, found in by_name.items()
    ]


def _changes(rows: Sequence[Row]) -> list[tuple[Row, float, float]]:
    """Rows with changed assumptions: strain over that of the case as it is, less 1; change of friction."""
    base = {row["what"]: row for row in rows if row["change"] == "as it is"}
    out = []
    for row in rows:
        if row["change"] != "as it is":
            plain = base[row["what"]]
            strain = number(row["max_strain"]) / number(plain["max_strain"]) - 1
            out.append((row, strain, number(row["required_friction"]) - number(plain["required_friction"])))
    return out


def _model_lines(rows: Sequence[Row]) -> list[dict[str, object]]:
    return [
        line
        for row, strain, friction in _changes(rows)
        for line in (
            _line("model", f"{row['what']}, {row['change']}: eps_max, relative", strain),
            _line("model", f"{row['what']}, {row['change']}: friction", friction),
        )
    ]


def _told(checks: Sequence[Row], title: str) -> str:
    lines = [
        f"## {title.capitalize()}",
        "",
        "| what | found | allowed | holds |",
        "| --- | --- | --- | --- |",
    ]
    for row in checks:
        least, most = number(row["least"]), number(row["most"])
        allowed = f"at most {most:.3g}" if math.isinf(least) else f"{least:.4g} to {most:.4g}"
        value = f"{number(row['value']):.3g} {row['unit']}".rstrip()
        lines.append(f"| {row['what']} | {value} | {allowed} | {'yes' if _holds(row) else 'no'} |")
    return "\n".join(lines)


def _solution_text(cases: dict[str, dict[str, Converged]]) -> str:
    head = " | ".join(f"{WORDS[name]} on {', '.join(MESHES)} | order | index, %" for name in QUANTITIES)
    lines = ["## Solution", "", f"| case | {head} |", "| --- " * (1 + 3 * len(QUANTITIES)) + "|"]
    for case, by_name in cases.items():
        cells = [case]
        for name in QUANTITIES:
            found = by_name[name]
            scale, digits = (1e3, 3) if name == "clearance" else (1.0, 4)
            values = ", ".join(f"{scale * value:.{digits}f}" for value in found.values)
            order = "none" if math.isnan(found.order) else f"{found.order:.1f}"
            cells += [values + (" mm" if name == "clearance" else ""), order, f"{100 * found.index:.2g}"]
        lines.append("| " + " | ".join(cells) + " |")
    note = (
        "Order: as observed; none where the values do not tend to one side. The index is then computed with "
        "order 1, and with .5 or 3 where it is beyond these."
    )
    return "\n".join([*lines, "", note])


def _model_text(rows: Sequence[Row]) -> str:
    lines = ["## Model", "", "| retraction | assumption | eps_max | friction |", "| --- | --- | --- | --- |"]
    for row, strain, friction in _changes(rows):
        lines.append(f"| {row['what']} | {row['change']} | {100 * strain:+.1f} % | {friction:+.3f} |")
    return "\n".join(lines)


def _draw(axes: Axes, quantity: str, cases: dict[str, dict[str, Converged]]) -> None:
    """The index of each case, and what is allowed."""
    found = [100 * by_name[quantity].index for by_name in cases.values()]
    axes.barh(np.arange(len(found)), found, color=VALUE, height=0.6)
    axes.axvline(100 * ALLOWED[quantity], color=LIMIT, linestyle="--")
    axes.annotate(
        "allowed", (100 * ALLOWED[quantity], len(found) - 0.45), color=LIMIT, fontsize=8.5, ha="right",
        xytext=(-4, 0), textcoords="offset points",
    )  # fmt: skip
    axes.set_ylim(len(found) - 0.3, -0.7)
    axes.set_title(f"{WORDS[quantity]}: index of `fine`".replace("`", ""), color=GREY if not found else None)
    axes.set_xlabel("% of the length" if quantity == "clearance" else "%")


STUDY = Study("verification", "whether the equations are solved right", _experiments, _report)
