"""The picture of docs/rod.md: errors of the rod, and its outline over fine finite elements. Drawn in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from baselines.pictures.drawing import MM, STYLE
from benchmarks._report import ROOT, progress
from benchmarks.rod_distance import GROUPS, Pair, pairs
from benchmarks.rod_motions import SQUEEZES
from retract_env.drawing.palette import GREY, GROUND, INK, LIMIT, SIGHT, TISSUE, VALUE, VEIN
from retract_env.physics.base import TissueState
from retract_env.physics.registry import physics_kind

Array = NDArray[np.float64]

FILE = ROOT / "docs" / "images" / "rod_distance.png"
SHOWN = {
    "clearance": ("Lowest clearance, % of the length", 100.0, 1.0),
    "strain": ("Greatest strain so far, %", 100.0, 6.0),
    "friction": ("Greatest required friction so far", 1.0, 0.05),
}
"""Title, factor, and what was asked for of 95 % of states."""
WIDEST = 2.6
"""Of what was asked for: where the axes end. Worse cases are told at the edge."""


def draw(test: Sequence[Pair]) -> None:
    """Write the picture."""
    coarse = pairs("test", "coarse")
    worst = max((p for p in test if len(p.errors()["clearance"])), key=_worst_clearance)
    seen = [p for p in test if p.kind == "ctc" and p.fine_end == p.other_end == "ok"]
    seen = [p for p in seen if len(p.scene.tissue.veins) >= 5]
    typical = sorted(seen, key=_worst_clearance)[len(seen) // 2]
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(10, 7.2), layout="constrained")
        parts: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1))
        above, below = parts
        for axes, name in zip(above.subplots(1, 3, sharey=True), SHOWN, strict=True):
            _quantiles(axes, name, test, coarse)
        left, right = below.subplots(1, 2, width_ratios=(1.6, 1))
        for axes, pair, label in ((left, typical, "Typical"), (right, worst, "The worst")):
            _flaps(axes, pair, label)
        figure.savefig(FILE, dpi=110)
        plt.close(figure)


def _worst_clearance(pair: Pair) -> float:
    return float(np.abs(pair.errors()["clearance"]).max())


def _quantiles(axes: Any, name: str, rod: Sequence[Pair], coarse: Sequence[Pair]) -> None:
    title, factor, asked = SHOWN[name]
    edge = WIDEST * asked
    axes.axvspan(-asked, asked, color=GROUND, lw=0)
    axes.axvline(0, color=GREY, lw=0.8)
    for row, chosen in enumerate(GROUPS.values()):
        for found, colour, shift in ((rod, VALUE, -0.16), (coarse, LIMIT, 0.16)):
            of = [p.errors()[name] for p in found if chosen(p)]
            if not of:
                continue
            values = factor * np.concatenate(of)
            low, middle, high = np.percentile(values, [5, 50, 95])
            ends = values.min(), values.max()
            y = row + shift
            axes.plot(np.clip(ends, -edge, edge), [y, y], color=colour, lw=0.8)
            axes.plot([low, high], [y, y], color=colour, lw=5, solid_capstyle="butt")
            axes.plot(middle, y, "o", color="white", ms=3)
            for end, side in zip(ends, ("left", "right"), strict=True):
                if abs(end) > edge:
                    sign = 1 if end > 0 else -1
                    axes.annotate(
                        f"{end:+.3g}", (sign * edge, y), ha=side, va="center", fontsize=6.5, color=colour,
                        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
                    )  # fmt: skip
    axes.set(xlim=(-edge, edge), ylim=(len(GROUPS) + 0.3, -0.6), yticks=range(len(GROUPS)))
    axes.set_yticklabels(list(GROUPS))
    axes.set_title(title)
    if name == "clearance":
        axes.plot([], [], color=VALUE, lw=5, label="rod")
        axes.plot([], [], color=LIMIT, lw=5, label="coarse elements")
        axes.legend(frameon=False, fontsize=8, loc="lower left", handlelength=1, ncols=2)


def _solved(pair: Pair, count: int) -> tuple[TissueState, Any]:
    """The state after `count` moves on fine finite elements, and its section."""
    physics = physics_kind("fem").make(pair.scene, pair.grasp[0], "fine")
    physics.reset()
    for k, state in enumerate(pair.fine[:count]):
        moved = state[0] if k < len(SQUEEZES) or pair.kind != "random" else None
        found = physics.move_to(state[1:5], moved)
    section = physics.section
    physics.close()
    return found, section


def _flaps(axes: Any, pair: Pair, label: str) -> None:
    errors = pair.errors()["clearance"]
    at = int(np.abs(errors).argmax()) + pair.common.start
    progress(f"fine finite elements of flap {pair.seed}, {pair.kind}")
    state, section = _solved(pair, at + 1)
    corners = MM * state.points[section.triangles[:, :3]]
    colours = np.where(section.vein >= 0, VEIN, TISSUE)
    axes.axhspan(-100, 0, color=GROUND, lw=0)
    axes.add_collection(PolyCollection(corners, facecolors=colours, edgecolors="face", linewidths=0.2))
    lower, upper = MM * pair.points[at][:, :2], MM * pair.points[at][:, 2:]
    outline = np.concatenate([lower, upper[::-1], lower[:1]])
    axes.plot(*outline.T, color=LIMIT, lw=1.2)
    jaws = MM * state.jaws.reshape(2, 2)
    axes.plot(*jaws.T, "s", color=INK, ms=4)
    line = pair.scene.line_of_sight
    axes.plot(*(MM * np.array([line.camera, line.target])).T, color=SIGHT, lw=1, ls=(0, (4, 2)))
    points = np.concatenate([outline, corners.reshape(-1, 2)])
    low, high = points.min(0), points.max(0)
    axes.set(aspect="equal", xlim=(low[0] - 4, max(high[0], 0) + 4), ylim=(min(low[1], 0) - 3, high[1] + 4))
    axes.set(xlabel="x, mm", ylabel="y, mm")
    veins = len(pair.scene.tissue.veins)
    squeezed = 100 * pair.grasp[1] / pair.scene.tissue.height
    axes.set_title(
        f"{label}: {pair.kind}, {veins} vein{'s' * (veins != 1)},\nsqueezed by {squeezed:.0f} %, "
        f"clearance\noff by {100 * errors[at - pair.common.start]:+.2f} % of the length"
    )
