"""Verification of the certifier: code, solution, and the sizes of its assumptions. After ASME V&V 40."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.study import Claim, Report, Study, new_figure, number
from baselines.verification.assumptions import (
    BASES,
    CHANGES,
    MOTIONS,
    SLIDING,
    in_time,
    node_by_node,
    with_change,
)
from baselines.verification.code import CHECKS
from baselines.verification.solution import (
    CASES,
    CERTIFIED,
    QUANTITIES,
    SPLITS,
    Converged,
    converged,
    on_mesh,
)
from planners.certify.certificate import PATCH_SLIP
from retract_env.drawing.palette import GREY, VALUE

WORDS = {"max_strain": "eps_max", "required_friction": "needed friction", "clearance": "clearance"}
ALLOWED = {"max_strain": 0.03, "required_friction": 0.03, "clearance": 0.005}
"""By how much the mesh of certificates may be off: of strain relative, of friction as it is, of clearance
over the length."""
BOUNDS: dict[str, object] = {"least": "", "most": "", "holds": ""}
UNITS = {"max_strain": "% of it", "required_friction": "hundredths", "clearance": "% of the length"}


def _experiments() -> list[Experiment]:
    checks = [
        Experiment(f, kw, {"group": "code", "what": what, "unit": unit}) for what, f, kw, unit in CHECKS
    ]
    solution = [
        Experiment(on_mesh, {"case": case, "splits": k}, {"group": "solution", "what": case, "splits": k})
        for case in CASES
        for k in (*SPLITS, CERTIFIED)
    ]
    assumed = [
        Experiment(
            with_change, {"case": case, "change": change}, {"group": "model", "what": case, "change": change}
        )
        for case in BASES
        for change in CHANGES
    ]
    timed = [
        Experiment(
            in_time,
            {"case": case, "seconds": seconds, "start": start},
            {"group": "time", "what": case, "seconds": seconds, "start": start},
        )
        for case in BASES
        for seconds, start in MOTIONS
    ]
    slipping = [Experiment(node_by_node, {"case": case}, {"group": "slip", "what": case}) for case in SLIDING]
    return [*checks, *solution, *assumed, *timed, *slipping]


def _report(rows: Sequence[Row]) -> Report:
    checks = [row for row in rows if row["group"] == "code"]
    cases = {
        case: converged(
            {row["splits"]: row for row in rows if row["group"] == "solution" and row["what"] == case}
        )
        for case in dict.fromkeys(row["what"] for row in rows if row["group"] == "solution")
    }
    model = [row for row in rows if row["group"] == "model"]
    times = [row for row in rows if row["group"] == "time"]
    slips = [row for row in rows if row["group"] == "slip"]
    table = [
        *map(_check_line, checks),
        *_solution_lines(cases),
        *_model_lines(model),
        *[line for row in times for line in _time_lines(row)],
        *[line for row in slips for line in _slip_lines(row)],
    ]
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
        worst = max(cases, key=lambda case: abs(cases[case][quantity].off))
        off = abs(cases[worst][quantity].off)
        claims.append(
            Claim(
                f"{WORDS[quantity]} of `fine`: off its limit by at most {_off(ALLOWED[quantity], quantity)}",
                f"at most {_off(off, quantity)} ({worst})",
                "yes" if off <= ALLOWED[quantity] else "no",
            )
        )
    most = max(_against(row, "rigid")[1] / number(row["friction_rigid"]) for row in slips)
    claims.append(
        Claim(
            f"Patches that slip node by node need at most {100 * PATCH_SLIP:.2g} % more friction than whole",
            f"at most {100 * most:.2g} %",
            "yes" if most <= PATCH_SLIP else "no",
        )
    )
    return Report(
        "Verification",
        "Are the equations solved right? *Code*: closed forms, rates of convergence and laws, each with a "
        "tolerance. *Solution*: eight certified retractions, followed to the same place on three meshes, "
        "each with triangles half as large as the one before, and how far `fine`, the mesh of certificates, "
        "is off the limit of these. *Model*: the same motions of the jaws with one assumption changed, in "
        "time, with inertia, and with patches that slip node by node.",
        table,
        figure,
        claims,
        [_code_text(checks), _solution_text(cases), _model_text(model), _time_text(times), _slip_text(slips)],
    )


def _holds(row: Row) -> bool:
    return number(row["least"]) <= number(row["value"]) <= number(row["most"])


def _line(group: str, what: str, found: float, unit: str = "", **more: object) -> dict[str, object]:
    """A row of the table; what nothing is asked of has no bounds."""
    return {"group": group, "what": what, "found": found, "unit": unit, **BOUNDS, **more}


def _check_line(row: Row) -> dict[str, object]:
    least, most, holds = number(row["least"]), number(row["most"]), "yes" if _holds(row) else "no"
    return _line("code", row["what"], number(row["value"]), row["unit"], least=least, most=most, holds=holds)


def _solution_lines(cases: dict[str, dict[str, Converged]]) -> list[dict[str, object]]:
    lines = []
    for case, by_name in cases.items():
        for name, found in by_name.items():
            off, most = abs(found.off), ALLOWED[name]
            what, holds = f"{case}: {WORDS[name]} of fine off its limit", "yes" if off <= most else "no"
            lines.append(_line("solution", what, off, most=most, holds=holds))
    return lines


def _changes(rows: Sequence[Row]) -> list[tuple[Row, float, float, float]]:
    """Rows with another assumption, against the case as it is: more strain, relative; friction; m higher."""
    base = {row["what"]: row for row in rows if row["change"] == "as it is"}
    out = []
    for row in rows:
        if row["change"] != "as it is":
            plain = base[row["what"]]
            strain = number(row["max_strain"]) / number(plain["max_strain"]) - 1
            friction, higher = (
                number(row[name]) - number(plain[name]) for name in ("required_friction", "clearance")
            )
            out.append((row, strain, friction, higher))
    return out


def _model_lines(rows: Sequence[Row]) -> list[dict[str, object]]:
    return [
        line
        for row, strain, friction, higher in _changes(rows)
        for line in (
            _line("model", f"{row['what']}, {row['change']}: eps_max, relative", strain),
            _line("model", f"{row['what']}, {row['change']}: friction", friction),
            _line("model", f"{row['what']}, {row['change']}: clearance", higher, "m"),
        )
    ]


def _against(row: Row, plain: str) -> tuple[float, float]:
    """Strain over that of the certificate, "slow" or "rigid", less 1; change of friction."""
    strain = number(row["max_strain"]) / number(row[f"strain_{plain}"]) - 1
    return strain, number(row["required_friction"]) - number(row[f"friction_{plain}"])


def _time_lines(row: Row) -> list[dict[str, object]]:
    what, (strain, friction) = (
        f"{row['what']}, {row['start']}, in {number(row['seconds']):g} s",
        _against(row, "slow"),
    )
    return [
        _line("model", f"{what}: eps_max, relative", strain),
        _line("model", f"{what}: friction", friction),
        _line("model", f"{what}: clearance once the jaws stand still", number(row["clearance"]), "m"),
    ]


def _slip_lines(row: Row) -> list[dict[str, object]]:
    what, (strain, friction) = f"{row['what']}, node by node", _against(row, "rigid")
    return [
        _line("model", f"{what}: eps_max, relative", strain),
        _line("model", f"{what}: friction", friction),
        _line("model", f"{what}: creep", number(row["creep"]), "m"),
    ]


def _code_text(checks: Sequence[Row]) -> str:
    lines = ["## Code", "", "| what | found | allowed | holds |", "| --- | --- | --- | --- |"]
    for row in checks:
        least, most = number(row["least"]), number(row["most"])
        allowed = f"at most {most:.3g}" if math.isinf(least) else f"{least:.4g} to {most:.4g}"
        value = f"{number(row['value']):.3g} {row['unit']}".rstrip()
        lines.append(f"| {row['what']} | {value} | {allowed} | {'yes' if _holds(row) else 'no'} |")
    return "\n".join(lines)


def _off(off: float, quantity: str) -> str:
    """An error in words."""
    if quantity == "required_friction":
        return f"{off:.3f}"
    return f"{100 * off:.2g} %" + (" of the length" if quantity == "clearance" else "")


def _solution_text(cases: dict[str, dict[str, Converged]]) -> str:
    lines = ["## Solution"]
    for quantity in QUANTITIES:
        scale, unit = (1e3, ", mm") if quantity == "clearance" else (1.0, "")
        lines += [
            "",
            f"| {WORDS[quantity]}{unit} | three meshes | order | limit | index | `fine` | off |",
            "| --- | --- | --- | --- | --- | --- | --- |",
        ]
        for case, by_name in cases.items():
            found = by_name[quantity]
            values = ", ".join(f"{scale * value:.4f}" for value in found.values)
            order = "none" if math.isnan(found.order) else f"{found.order:.1f}"
            lines.append(
                f"| {case} | {values} | {order} | {scale * found.limit:.4f} | "
                f"{_off(found.index, quantity)} | {scale * found.certified:.4f} | "
                f"{_off(found.off, quantity)} |"
            )
    note = (
        "Order: as observed, none where the values do not tend to one side. Where it is below .5 they have "
        "no limit that could be told: the finest value stands for it, and the range of all three for its "
        "error. Index: the grid convergence index of the finest mesh, whose elements at a jaw's edges are "
        "1/17 of the jaw. Finer ones, from about 1/30 on, let the surface under a firm grip fold at those "
        "edges, which are sharp here: several equilibria then exist."
    )
    return "\n".join([*lines, "", note])


def _model_text(rows: Sequence[Row]) -> str:
    lines = [
        "## Model",
        "",
        "Clearance: how much more or less.",
        "",
        "| retraction | assumption | eps_max | friction | clearance, mm |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row, strain, friction, higher in _changes(rows):
        lines.append(
            f"| {row['what']} | {row['change']} | {100 * strain:+.1f} % | {friction:+.3f} | "
            f"{1e3 * higher:+.2f} |"
        )
    return "\n".join(lines)


def _time_text(rows: Sequence[Row]) -> str:
    lines = [
        "### In time",
        "",
        "With inertia, the slowest vibration damped by a twentieth of the critical: smoothly from rest to "
        "rest, or at the mean speed from the first moment. Clearance: least once the jaws stand still.",
        "",
        "| retraction | start | s | mean speed, mm/s | eps_max | friction | clearance, mm |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        strain, friction = _against(row, "slow")
        lines.append(
            f"| {row['what']} | {row['start']} | {number(row['seconds']):g} | "
            f"{1e3 * number(row['speed']):.0f} | {100 * strain:+.1f} % | {friction:+.3f} | "
            f"{1e3 * number(row['clearance']):+.2f} |"
        )
    return "\n".join(lines)


def _slip_text(rows: Sequence[Row]) -> str:
    lines = [
        "### Node by node",
        "",
        "Patches that hold by Coulomb's law at every node, with the scene's friction, instead of as a whole. "
        "Creep: the farthest that a node slips along its pad once the jaws have closed. Sliding, lifted: "
        "parts of the worse patch at the end. Clearance: how much more or less.",
        "",
        "| retraction | eps_max | friction | creep, um | sliding | lifted | clearance, mm |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        strain, friction = _against(row, "rigid")
        lower = number(row["clearance"]) - number(row["clearance_rigid"])
        lines.append(
            f"| {row['what']} | {100 * strain:+.1f} % | {friction:+.3f} | "
            f"{1e6 * number(row['creep']):.0f} | {100 * number(row['sliding']):.0f} % | "
            f"{100 * number(row['lifted']):.0f} % | {1e3 * lower:+.2f} |"
        )
    return "\n".join(lines)


def _draw(axes: Axes, quantity: str, cases: dict[str, dict[str, Converged]]) -> None:
    """How far the mesh of certificates is off in each case, how sure that is, and what is allowed."""
    found = [by_name[quantity] for by_name in cases.values()]
    at, most = np.arange(len(found)), 100 * ALLOWED[quantity]
    off, sure = [100 * f.off for f in found], [100 * f.index for f in found]
    axes.axvspan(-most, most, color=VALUE, alpha=0.12, linewidth=0)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.errorbar(off, at, xerr=sure, fmt="o", color=VALUE, capsize=3)
    axes.set_ylim(len(found) - 0.5, -0.5)
    axes.set_title(WORDS[quantity])
    axes.set_xlabel(f"off its limit, {UNITS[quantity]}")


STUDY = Study("verification", "whether the equations are solved right", _experiments, _report)
