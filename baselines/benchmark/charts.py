"""The benchmark's charts, each as the bytes of a PNG."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from baselines.benchmark.contest import REASONS
from baselines.benchmark.scores import Summary
from baselines.pictures.drawing import STYLE
from retract_env.drawing.palette import GREY, INK, SIGHT

Array = NDArray[np.float64]

DPI = 160
WIDTH = 8.0
"""inches"""
FAILED = {
    "not_visible": "#c9ced3",
    "strain": "#d55e00",
    "slip": "#e69f00",
    "release": "#cc79a7",
    "contact": "#56b4e9",
    "torn": "#a33b20",
    "diverged": "#6d757d",
    "unsure": "#b9a7dd",
    "unsolved": "#7f9fb0",
    "time": "#0072b2",
    "raised": "#7b3294",
    "returned": "#8c6d31",
    "died": "#22282e",
}
ENTRY = 0.2
"""inches of a legend's height that a curve's name takes"""
LINES = ("#0072b2", "#d55e00", "#00805f", "#cc79a7", "#e69f00", "#56b4e9", "#22282e", "#999999")
"""Okabe and Ito's colours, but the yellow, which is too pale for a line."""
DASHES = ("-", "--", ":")


def share_chart(found: Sequence[Summary]) -> bytes:
    """What becomes of each method's retractions: certified, or why not."""

    def draw(axes: Axes) -> None:
        at = np.arange(len(found))[::-1]
        certified = np.array([s.certified.value for s in found])
        axes.barh(at, certified, color=SIGHT, label="certified")
        ends = np.array(
            [[s.certified.value - s.certified.low, s.certified.high - s.certified.value] for s in found]
        )
        axes.errorbar(certified, at, xerr=np.maximum(ends.T, 0), fmt="none", ecolor=INK, capsize=2.5, lw=1)
        left = certified.copy()
        for failure in REASONS:
            part = np.array([s.failures[failure] for s in found])
            if part.any():
                axes.barh(at, part, left=left, color=FAILED[failure], label=failure.replace("_", " "))
            left += part
        most = max(s.scenes for s in found)
        some = ["" if s.scenes == most else f" ({s.scenes} scenes)" for s in found]
        axes.set_yticks(at, [s.method + part for s, part in zip(found, some, strict=True)])
        axes.set_ylim(-0.6, len(found) - 0.4)
        axes.set_xlim(0, 1)
        axes.xaxis.set_major_formatter(PercentFormatter(1))
        axes.set_xlabel("scenes")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1 - 0.4 / len(found)), ncols=6, frameon=False)

    return _png(draw, 1.3 + 0.32 * len(found))


def profile_chart(scores: Mapping[str, Array]) -> bytes:
    """Share of scenes where a method comes within a factor of the best known strain.

    scores: (runs, scenes) of each method, 1 for the best known, 0 where not certified. Curves of different
    scenes are no comparison, so only methods judged on all of them are drawn; a note names the others, and
    those that nothing was certified of.
    """
    shown, partial, never = compared(scores)

    def draw(axes: Axes) -> None:
        excess = np.linspace(1, 4, 601)
        for k, name in enumerate(shown):
            shares = (scores[name].ravel()[:, None] >= 1 / excess - 1e-12).mean(axis=0)
            axes.plot(excess, shares, label=name, **_style(k))
        axes.set_xlim(1, 4)
        axes.set_ylim(0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1))
        axes.set_xlabel("strain over the least that any method reached in the scene, at most")
        axes.set_ylabel("scenes")
        if shown:
            axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)

    said = [
        f"{what}: {', '.join(names)}."
        for what, names in (
            ("Not drawn, as judged on some of the scenes alone", partial),
            ("Never certified", never),
        )
        if names
    ]
    return _png(draw, max(3.6, ENTRY * len(shown)) + 0.2 * len(said), note="\n".join(said))


def compared(scores: Mapping[str, Array]) -> tuple[list[str], list[str], list[str]]:
    """Methods judged on as many scenes as any and certified somewhere, best first; those judged on fewer; and
    those never certified. scores: as for `profile_chart`."""
    most = max((values.shape[-1] for values in scores.values()), default=0)
    partial = [name for name, values in scores.items() if values.shape[-1] < most]
    never = [name for name, values in scores.items() if name not in partial and not values.any()]
    shown = [name for name in scores if name not in (*partial, *never)]
    return sorted(shown, key=lambda name: -float(scores[name].mean())), partial, never


def curve_chart(curves: Mapping[str, Sequence[Sequence[Mapping[str, Any]]]]) -> bytes:
    """Success and strain on the validation split over the part of training: the mean of a method's seeds, and
    from the least to the greatest of them."""
    wanted = {"success": "episodes that succeed", "strain": "strain over its limit, where they do"}

    def draw(*panels: Axes) -> None:
        for axes, (column, label) in zip(panels, wanted.items(), strict=True):
            for k, (name, runs) in enumerate(curves.items()):
                parts = [np.array([line["steps"] for line in run], np.float64) for run in runs]
                at = np.unique(np.concatenate([steps / steps[-1] for steps in parts]))
                at = at[at >= max(steps[0] / steps[-1] for steps in parts)]
                values = np.ma.masked_invalid(
                    [
                        np.interp(at, steps / steps[-1], _column(run, column))
                        for steps, run in zip(parts, runs, strict=True)
                    ]
                )
                style = _style(k)
                seeds = f" ({len(runs)} seeds)" if len(runs) > 1 else ""
                axes.plot(
                    at,
                    values.mean(axis=0).filled(np.nan),
                    lw=1.4,
                    marker=".",
                    label=f"{name}{seeds}",
                    **style,
                )
                ends = [end.filled(np.nan) for end in (values.min(axis=0), values.max(axis=0))]
                axes.fill_between(at, *ends, alpha=0.2, lw=0, fc=style["color"])
            axes.set_xlim(0, 1.01)
            axes.set_ylim(bottom=0)
            axes.xaxis.set_major_formatter(PercentFormatter(1))
            axes.set_xlabel("of the training's steps")
            axes.set_ylabel(label)
        panels[0].set_ylim(-0.02, 1.02)
        panels[0].yaxis.set_major_formatter(PercentFormatter(1))
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)

    return _png(draw, max(3.2, ENTRY * len(curves)), panels=len(wanted))


def _style(k: int) -> dict[str, Any]:
    """Of the k-th curve; they repeat when all colours have been drawn with all dashes."""
    return {"color": LINES[k % len(LINES)], "ls": DASHES[k // len(LINES) % len(DASHES)]}


def _column(curve: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    """Of a curve; nan where there is no such number, and strain where no episode succeeded."""
    return [line.get(name, np.nan) if name == "success" or line["success"] > 0 else np.nan for line in curve]


def _png(draw: Callable[..., None], height: float, panels: int = 1, note: str = "") -> bytes:
    """draw: is given the panels, side by side; note: below the chart."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        FigureCanvasAgg(figure)
        beside = [figure.add_subplot(1, panels, k + 1) for k in range(panels)]
        for axes in beside:
            axes.spines[["top", "right"]].set_visible(False)
            axes.tick_params(color=GREY)
        draw(*beside)
        if note:
            wrapped = "\n".join(textwrap.fill(line, 120) for line in note.splitlines())
            figure.supxlabel(wrapped, x=0.01, ha="left", fontsize=8.5, color=GREY)
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    return content.getvalue()
