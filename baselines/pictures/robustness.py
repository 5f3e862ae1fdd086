"""The picture of the study `robustness`: strain against what fails, and the frontier that `swift` draws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from baselines.pictures.drawing import HALO
from baselines.pictures.robustness_said import ENOUGH, Row, of_method, planned
from retract_env.drawing.palette import GREY, GROUND, INK, LIMIT, SIGHT, VALUE

Array = NDArray[np.float64]

PURPLE = "#aa4499"
LOOKS: dict[str, tuple[str, str, str, bool]] = {
    "ctc": ("CTC, Eq. 5", "s", LIMIT, True),
    "ctc_lightest": ("CTC, as lightly as survives", "s", LIMIT, False),
    "circular": ("circular, Eq. 5", "o", SIGHT, True),
    "circular_lightest": ("circular, as lightly as survives", "o", SIGHT, False),
    "swift": ("swift, by position", "D", VALUE, True),
    "swift_force": ("swift, by force", "P", VALUE, True),
    "swift_exact": ("swift, as if all were known", "D", VALUE, False),
    "eased": ("eased", "^", GREY, True),
    "fem_gradient": ("fem_gradient", "v", GREY, True),
    "light_grip": ("light_grip", "<", PURPLE, True),
    "elastica": ("elastica", ">", PURPLE, True),
}
"""Name, marker, colour, and whether it is filled."""
LINES = {"swift": VALUE, "ctc_lightest": LIMIT, "circular_lightest": SIGHT}
LOWEST, NONE = 1e-3, 5e-4
"""Least part that fails which is told apart, and where none is drawn."""
RESAMPLES = 1000


def draw(rows: Sequence[Row], standard: Sequence[str]) -> Figure:
    """All methods over the test flaps, and on each standard scene; without test flaps over these."""
    figure = Figure(figsize=(13.0, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(max(1, len(standard)), 2, width_ratios=(2.3, 1))
    flaps = {row["scene"] for row in rows if row["scene"].startswith("test")}
    main = figure.add_subplot(grid[:, 0])
    several = sorted(flaps) if flaps else list(standard)
    _panel(main, [row for row in rows if row["scene"] in several], several=True)
    main.set_xlim(0.0, 1.1 * max((r["max_strain"] for r in rows if r["reason"] == "ok"), default=0.5))
    where = "random test flaps" if flaps else "the standard scenes"
    main.set_title(f"{where}: median strain, and part of all draws that fail", fontsize=11)
    shown = {row["method"] for row in rows}
    there = [row for row in rows if row["scene"] in several]
    handles = [
        _handle(f"{name}: {len(_judged(there, method))}", marker, colour, filled)
        for method, (name, marker, colour, filled) in LOOKS.items()
        if method in shown
    ]
    closed = [len(_ladders(there, f"{path}_lightest")) for path in ("ctc", "circular")]
    for words, colour, width in (
        (f"frontier: swift, planned for\n0 to 1.25 times the prior: {len(_asked(there))}", VALUE, 2.0),
        (f"CTC (circular: green), closed by\n0.2 to 1.6 times Eq. 5: {closed[0]} ({closed[1]})", LIMIT, 1.2),
    ):
        handles.append(Line2D([], [], color=colour, linewidth=width, label=words))
    main.legend(
        handles=handles, title=f"rests on so many {'flaps' if flaps else 'scenes'}", frameon=False,
        loc="upper right", fontsize=8.5, title_fontsize=8.5,
    )  # fmt: skip
    main.text(
        0.015, 0.06, "better: less strain,\nfewer failures", transform=main.transAxes, color=GREY, fontsize=9,
        path_effects=HALO,
    )  # fmt: skip
    for k, name in enumerate(standard):
        axes = figure.add_subplot(grid[k, 1], sharex=main)
        _panel(axes, [row for row in rows if row["scene"] == name], several=False)
        axes.set_title(name.replace("_", " "))
        axes.set_ylabel("part that fails")
        if k == len(standard) - 1:
            axes.set_xlabel("certified strain of the worst 1 %")
        else:
            axes.tick_params(labelbottom=False)
    main.set_xlabel(
        "certified strain of the worst 1 % (bars: quartiles over flaps; markers: coarse finite elements, "
        "lines: the rod)"
    )
    main.set_ylabel("part of draws from the prior that fails (bars: 95 %, flaps resampled)")
    return figure


def _handle(name: str, marker: str, colour: str, filled: bool) -> Line2D:
    return Line2D([], [], linestyle="", label=name, **_look(marker, colour, filled), markersize=8)


def _look(marker: str, colour: str, filled: bool) -> dict[str, Any]:
    face = colour if filled else "white"
    return {
        "marker": marker,
        "color": colour,
        "markerfacecolor": face,
        "markeredgecolor": colour if not filled else "white",
        "markeredgewidth": 1.6 if not filled else 0.8,
    }


def _panel(axes: Axes, rows: Sequence[Row], several: bool) -> None:
    axes.set_yscale("log")
    axes.set_ylim(0.75 * NONE, 1.3)
    axes.set_yticks([NONE, 1e-3, 1e-2, 1e-1, 1.0])
    axes.yaxis.set_major_formatter(FuncFormatter(_part))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.axhspan(0.75 * NONE, 1 - ENOUGH, facecolor=GROUND, zorder=0)
    if several:
        axes.text(
            0.99, (1 - ENOUGH) * 0.93, "99 % survive", transform=axes.get_yaxis_transform(), ha="right",
            va="top", color=INK, fontsize=8.5,
        )  # fmt: skip
    for method, colour in LINES.items():
        line = _frontier(rows) if method == "swift" else _ladder(rows, method)
        if len(line) > 1:
            axes.plot(
                line[:, 0], np.maximum(line[:, 1], NONE), color=colour, zorder=2, alpha=0.75,
                linewidth=2.0 if method == "swift" else 1.2, marker=".", markersize=4,
            )  # fmt: skip
    for method, (_, *look) in LOOKS.items():
        mine = _judged(rows, method)
        if mine:
            _point(axes, mine, look, several)


def _judged(rows: Sequence[Row], method: str) -> list[Row]:
    """The rows that a method's point rests on."""
    return [row for row in planned(of_method(rows, method)).values() if row["draws"]]


def _point(axes: Axes, rows: Sequence[Row], look: Sequence[Any], several: bool) -> None:
    strain = np.array([row["max_strain"] for row in rows])
    failed = np.array([row["draws"] - row["survived"] for row in rows])
    draws = np.array([row["draws"] for row in rows])
    x, y = float(np.median(strain)), float(failed.sum() / draws.sum())
    if several and len(rows) > 1:
        chosen = np.random.default_rng(0).integers(len(rows), size=(RESAMPLES, len(rows)))
        shares = failed[chosen].sum(1) / draws[chosen].sum(1)
        low, high = np.maximum(np.quantile(shares, (0.025, 0.975)), NONE)
        bars = {"color": look[1], "linewidth": 1.2, "alpha": 0.6, "zorder": 3}
        axes.plot(np.quantile(strain, (0.25, 0.75)), [max(y, NONE)] * 2, **bars)
        axes.plot([x, x], [low, high], **bars)
    size = 9 if several else 6.5
    axes.plot([x], [max(y, NONE)], linestyle="", markersize=size, zorder=4, **_look(*look))


def _part(value: float, _: int) -> str:
    return "none" if value < LOWEST else f"{100 * value:g} %"


def _asked(rows: Sequence[Row]) -> dict[str, dict[float, Row]]:
    """What `swift` plans for each demand, by the scenes that have all of them."""
    mine = [r for r in rows if r["method"] in ("swift", "swift_exact")]
    demands = {r["demand"] for r in mine}
    found: dict[str, dict[float, Row]] = {}
    for row in mine:
        if row["reason"] == "ok":
            found.setdefault(row["scene"], {})[row["demand"]] = row
    return {scene: plans for scene, plans in found.items() if plans.keys() == demands}


def _frontier(rows: Sequence[Row]) -> Array:
    """(n, 2) strain and part that fails of `swift` at each demand, over the scenes that have all of them."""
    asked = _asked(rows)
    demands = sorted({demand for plans in asked.values() for demand in plans})
    return _curve(demands, lambda d: [plans[d] for plans in asked.values()], "by_rod")


def _ladders(rows: Sequence[Row], method: str) -> list[Any]:
    """What was tried with a path on each scene."""
    return [row["ladder"] for row in rows if row["method"] == method and row.get("ladder")]


def _ladder(rows: Sequence[Row], method: str) -> Array:
    """(n, 2) the same of a path at each part of Eq. 5's compression that most scenes hold with."""
    ladders = _ladders(rows, method)
    parts = sorted({rung["part"] for ladder in ladders for rung in ladder})
    rungs = {
        part: [r for ladder in ladders for r in ladder if r["part"] == part and r["reason"] == "ok"]
        for part in parts
    }
    return _curve([p for p in parts if len(rungs[p]) >= 0.8 * len(ladders)], rungs.__getitem__, "survival")


def _curve(steps: Sequence[float], of: Callable[[float], list[Any]], survival: str) -> Array:
    at = [of(step) for step in steps]
    points = [
        (float(np.median([r["max_strain"] for r in found])), 1 - float(np.mean([r[survival] for r in found])))
        for found in at
        if found
    ]
    return np.array(points).reshape(-1, 2)
