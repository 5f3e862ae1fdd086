"""Fig. 8: strain of four paths from the same grasps, on homogeneous tissue. Sec. V-B."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment, retraction
from baselines.paper.study import (
    EQUAL,
    Claim,
    Report,
    Study,
    new_figure,
    number,
    paper_scene,
    percent,
)
from baselines.pictures.drawing import MM
from planners.paths import PAPER_PATHS
from planners.proposals import stable_grasps
from retract_env.drawing.palette import GREY, INK, LIMIT, SIGHT, VALUE
from retract_env.scene import Scene

FAILED = 0.5
"""Strain at which retractions that fail are drawn, as in the paper."""
LOOKS = {
    "ctc": ("CTC", VALUE, "o"),
    "circular": ("circular", LIMIT, "s"),
    "linear60": ("linear, 60°", GREY, "v"),
    "linear75": ("linear, 75°", SIGHT, "^"),
}


def path_experiments(scenes: Sequence[Scene]) -> list[Experiment]:
    """Every stable grasp of every scene, free end first, with every path."""
    experiments = []
    for scene in scenes:
        veins = [np.mean(vein.outline, axis=0)[0] for vein in scene.tissue.veins]
        for grasp in sorted(stable_grasps(scene), key=lambda grasp: grasp.x):
            for path in PAPER_PATHS:
                label = {
                    "scene": scene.name,
                    "target": scene.line_of_sight.target[0],
                    "x": grasp.x,
                    "veins_beyond": sum(x < grasp.x for x in veins),
                    "path": path,
                }
                experiments.append(retraction(scene.dump(), grasp.x, grasp.compression, path, label))
    return experiments


def strain_curves(rows: Sequence[Row], scene: str) -> tuple[list[float], dict[str, list[float]]]:
    """Grasps, m, and for each path the strain of each grasp; nan where the retraction is not certified."""
    places = sorted({row["x"] for row in rows if row["scene"] == scene})
    found = {
        (row["path"], row["x"]): number(row["max_strain"]) if row["reason"] == "ok" else np.nan
        for row in rows
        if row["scene"] == scene
    }
    return places, {path: [found[path, x] for x in places] for path in PAPER_PATHS}


def better(a: float, b: float) -> bool:
    """Whether strain a is lower than b by more than what they are known to; what fails is worst."""
    return bool(np.nan_to_num(a, nan=np.inf) * (1 + EQUAL) < np.nan_to_num(b, nan=np.inf))


def draw_strains(axes: Axes, at: Sequence[float], curves: dict[str, list[float]]) -> None:
    """Strain of each path over the grasps; failures hollow, at the top."""
    axes.axhline(FAILED, color=INK, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    for (path, values), shift in zip(curves.items(), np.linspace(-0.15, 0.15, len(curves)), strict=True):
        name, colour, marker = LOOKS[path]
        known = np.array(values)
        step = float(np.min(np.diff(at))) if len(at) > 1 else 1.0
        x = np.array(at) + shift * step
        look: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 5.5, "linewidth": 1.4}
        axes.plot(x, known, label=name, zorder=3, **look)
        failed = np.isnan(known)
        axes.plot(
            x[failed], np.full(failed.sum(), FAILED), linestyle="none", marker=marker, markersize=5.5,
            markerfacecolor="white", markeredgecolor=colour, zorder=3,
        )  # fmt: skip
    axes.set_ylim(0.2, 0.53)
    axes.set_ylabel("strain eps_max")


def _experiments() -> list[Experiment]:
    return path_experiments([paper_scene("homogeneous"), paper_scene("homogeneous_near")])


def _report(rows: Sequence[Row]) -> Report:
    figure = new_figure(10.0, 4.0)
    panels = figure.subplots(1, 2, sharey=True)
    titles = {"homogeneous": "(a) line of sight at 25 %", "homogeneous_near": "(b) line of sight at 15 %"}
    for axes, (name, title) in zip(panels, titles.items(), strict=True):
        places, curves = strain_curves(rows, name)
        draw_strains(axes, [x * MM for x in places], curves)
        axes.set_title(f"{title} of the length from the fixed end, 45°")
        axes.set_xlabel("grasp, mm from the fixed end")
    panels[1].set_ylabel("")
    panels[0].text(panels[0].get_xlim()[0], 0.505, " not certified", fontsize=8.5, va="bottom")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)

    claims = []
    places, curves = strain_curves(rows, "homogeneous")
    worse = beaten(places, curves)
    certified = sum(not np.isnan(v) for v in curves["ctc"])
    claims.append(
        Claim(
            "(a) CTC strains less than circular and linear paths from every grasp",
            f"of {len(places)} grasps CTC is certified from {certified}; {exceptions(worse, len(places))}",
            "yes" if not worse else "in part" if len(worse) <= len(places) / 3 else "no",
        )
    )
    claims.append(_near_claim(rows))
    notes = [_least(rows, list(titles)), failures(rows)]
    return Report(
        "Fig. 8: paths compared on homogeneous tissue",
        "Ten grasps along a homogeneous flap, compressed by Eq. 5, are retracted along four paths until "
        "the target is in view, for lines of sight of 45° that meet the bed at 25 % and 15 % of the length "
        f"from the fixed end. Strains that differ by less than {percent(EQUAL)} count as equal, as the "
        "finite elements know them no better. What is not certified is drawn hollow at 0.5.",
        rows,
        figure,
        claims,
        notes,
    )


def _near_claim(rows: Sequence[Row]) -> Claim:
    places, curves = strain_curves(rows, "homogeneous_near")
    free = [i for i, x in enumerate(places) if x < np.mean(places)]
    winners = [i for i in free if better(curves["circular"][i], curves["ctc"][i])]
    listed = ", ".join(
        f"{places[i] * MM:.1f} mm ({curves['circular'][i]:.3f}, CTC {_text(curves['ctc'][i])})"
        for i in winners
    )
    return Claim(
        "(b) near the fixed end, circular is slightly better from some grasps near the free end",
        f"circular is better from {len(winners)} of the {len(free)} grasps on the free half: "
        f"{listed or 'none'}",
        "yes" if winners else "no",
    )


def beaten(places: Sequence[float], curves: dict[str, list[float]]) -> list[str]:
    """Grasps from which another path is better than CTC."""
    found = []
    for i, x in enumerate(places):
        rivals = [LOOKS[p][0] for p in curves if p != "ctc" and better(curves[p][i], curves["ctc"][i])]
        if rivals:
            found.append(f"{x * MM:.1f} mm ({' and '.join(rivals)})")
    return found


def exceptions(worse: Sequence[str], of: int) -> str:
    """From which grasps another path is better, in words."""
    return f"another path is better from {len(worse)} of {of}" + (f": {', '.join(worse)}" if worse else "")


def _text(strain: float) -> str:
    return "not certified" if np.isnan(strain) else f"{strain:.3f}"


def _least(rows: Sequence[Row], scenes: Sequence[str]) -> str:
    """A table of the least strain of each path."""
    lines = ["| least strain of | (a) | (b) |", "| --- | --- | --- |"]
    for path, (name, *_) in LOOKS.items():
        cells = []
        for scene in scenes:
            places, curves = strain_curves(rows, scene)
            values = curves[path]
            known = not np.all(np.isnan(values))
            cells.append(
                f"{np.nanmin(values):.3f} at {places[int(np.nanargmin(values))] * MM:.1f} mm"
                if known
                else "-"
            )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def failures(rows: Sequence[Row]) -> str:
    """How often each path fails and why, in words."""
    words = {"slip": "needs too much friction", "strain": "too much strain", "not_visible": "stays hidden"}
    parts = []
    for path, reason in product(PAPER_PATHS, sorted({row["reason"] for row in rows} - {"ok"})):
        count = sum(row["path"] == path and row["reason"] == reason for row in rows)
        if count:
            parts.append(f"{LOOKS[path][0]}: {count} {words.get(reason, reason)}")
    return "Not certified: " + ("; ".join(parts) or "none") + "."


STUDY = Study("fig8", "four paths on homogeneous tissue", _experiments, _report)
