"""The picture of the four kinds of paths in docs/method.md: python docs/images/paths.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from planners.paths import PATHS
from retract_env.grasp import Grasp
from retract_env.scene import load_scene

HERE = Path(__file__).resolve().parent
KINDS = {"ctc": "#0072b2", "circular": "#d55e00", "linear75": "#e69f00", "linear60": "#cc79a7"}
MM = 1e3
TOP = 40.0
"""mm, of the picture"""


def main() -> None:
    scene = load_scene("homogeneous")
    tissue, line = scene.tissue, scene.line_of_sight
    length, height = tissue.length * MM, tissue.height * MM
    grasp = Grasp(x=-0.03, compression=tissue.height / 4)
    figure, axes = plt.subplots(figsize=(7.0, 5.2), layout="constrained")
    axes.fill([-length, 0, 0, -length], [0, 0, height, height], color="#f6e1d3", ec="#333333", lw=0.8)
    axes.fill([0, 5, 5, 0], [0, 0, height, height], color="#dddddd")
    axes.axhline(0, color="#777777", lw=1)
    b = np.array(line.target) * MM
    away = np.array(line.camera) * MM - b
    end = b + away * 42 / away[1]
    axes.plot(*zip(b, end, strict=True), color="#118855", lw=1.6)
    axes.annotate("line of sight AB", (-48, 37.5), color="#118855", fontsize=9)
    axes.annotate("B", b - np.array([0.6, 2.6]), color="#118855", fontsize=9)
    for kind, colour in KINDS.items():
        jaws = PATHS[kind](scene, grasp).waypoints.reshape(-1, 2, 2) * MM
        middle = jaws[1:].mean(axis=1)
        shown = np.argmax((middle[:, 1] > TOP) | (middle[:, 0] > 0)) or len(middle)  # on past what is needed
        jaws, middle = jaws[: shown + 1], middle[:shown]
        axes.plot(*middle.T, color=colour, lw=2, label={"ctc": "CTC"}.get(kind, kind))
        for lower, upper in jaws[1::8]:
            axes.plot(*zip(lower, upper, strict=True), color=colour, lw=1, alpha=0.6)
    axes.annotate("flap at rest", (-length + 1, height / 2), fontsize=9, va="center")
    axes.annotate("fixed\nend", (2.5, height / 2), fontsize=8, va="center", ha="center")
    axes.set(xlim=(-52, 6), ylim=(-4, 42), aspect="equal")
    axes.set(xlabel="mm from the fixed end", ylabel="mm above the bed")
    axes.legend(frameon=False, loc="upper right", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(HERE / "paths.png", dpi=130)


if __name__ == "__main__":
    main()
