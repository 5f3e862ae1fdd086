"""A result of our own: what the lightest grip that holds saves, over grasps and lines of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment, measured, retraction
from baselines.paper.maps import draw_map
from baselines.paper.study import (
    EQUAL,
    Agreement,
    Claim,
    Report,
    Study,
    new_figure,
    paper_scene,
    percent,
    with_line,
)
from baselines.pictures.drawing import MM, strain_map
from planners.base import NoPlan
from planners.light_grip import MARGIN, LightGrip
from planners.paths import PATHS
from planners.proposals import stable_grasps
from planners.search import race
from retract_env.grasp import Grasp
from retract_env.scene import Scene

Array = NDArray[np.float64]

POSITIONS = (0.55, 0.45, 0.35, 0.25, 0.15)
"""of B, from the fixed end, as parts of the length"""
SLOPE = 45.0
"""degrees"""
SCENES = {"homogeneous": "homogeneous", "ten_veins": "ten veins"}
KINDS = {"ctc": "CTC", "circular": "circular"}
GRIPS = {"eq5": "Eq. 5", "light": "lightest that holds"}


def grip_experiments(scenes: Sequence[str], positions: Sequence[float]) -> list[Experiment]:
    """Every stable grasp, line and path, gripped by Eq. 5 and as lightly as holds."""
    experiments = []
    for name in scenes:
        scene = paper_scene(name)
        for position in positions:
            lined = with_line(scene, position, math.radians(SLOPE)).dump()
            for grasp in sorted(stable_grasps(scene), key=lambda grasp: grasp.x):
                for path in KINDS:
                    for grip, make in (("eq5", retraction), ("light", light_grip)):
                        label = {
                            "scene": name,
                            "position": position,
                            "x": grasp.x,
                            "path": path,
                            "grip": grip,
                        }
                        experiments.append(make(lined, grasp.x, grasp.compression, path, label))
    return experiments


def light_grip(scene: Mapping[str, Any], x: float, compression: float, path: str, label: Row) -> Experiment:
    """Certify the lightest grip that holds there; the compression is where its search begins."""
    arguments = {"scene": scene, "x": x, "compression": compression, "path": path}
    return Experiment(lightly_gripped, arguments, label)


def lightly_gripped(resolution: str, scene: Any, x: float, compression: float, path: str) -> Row:
    """What becomes of a grasp, m, with a path in PATHS, closed as lightly as holds."""
    flap, grasp = Scene.from_data(scene), Grasp(x, compression)
    contestant = LightGrip(flap, grasp, PATHS[path](flap, grasp))
    try:
        (best,) = race(flap, [contestant], "light_grip", resolution, 1).candidates
    except NoPlan as none:
        (best,) = none.candidates
    return {"compression": best.grasp.compression, **measured(best)}


def strain_table(rows: Sequence[Row], scene: str, path: str, grip: str) -> Array:
    """(positions, grasps) eps_max, nan where not certified; positions towards the fixed end, grasps from the
    free."""
    mine = [r for r in rows if (r["scene"], r["path"], r["grip"]) == (scene, path, grip)]
    places = sorted({r["x"] for r in mine})
    positions = sorted({r["position"] for r in mine}, reverse=True)
    found = {(r["position"], r["x"]): r["max_strain"] if r["reason"] == "ok" else np.nan for r in mine}
    return np.array([[found[p, x] for x in places] for p in positions], float)


def _experiments() -> list[Experiment]:
    return grip_experiments(list(SCENES), POSITIONS)


def _report(rows: Sequence[Row]) -> Report:
    scenes = [name for name in SCENES if any(row["scene"] == name for row in rows)]
    figure = new_figure(15.0, 2.9 * len(scenes) + 0.6)
    panels = figure.subplots(len(scenes), 4, squeeze=False, sharey=True)
    norm = Normalize(0.0, 0.5)
    claims = []
    for line, name in enumerate(scenes):
        places = sorted({row["x"] for row in rows if row["scene"] == name})
        positions = sorted({row["position"] for row in rows}, reverse=True)
        columns, lines = [f"{-x * MM:.0f}" for x in places], [percent(p) for p in positions]
        maps = {(p, g): strain_table(rows, name, p, g) for p in KINDS for g in GRIPS}
        for axes, ((path, grip), values) in zip(panels[line], maps.items(), strict=True):
            draw_map(axes, values, columns, lines, strain_map(), norm, ".2f", size=7.0)
            axes.set_title(f"{SCENES[name]}, {KINDS[path]}, {GRIPS[grip]}")
            axes.set_xlabel("grasp, mm from the fixed end")
        panels[line, 0].set_ylabel("line of sight, from the fixed end")
        claims += _claims(SCENES[name], positions, maps)
    figure.colorbar(ScalarMappable(norm, strain_map()), ax=panels, label="strain, up to its limit", pad=0.01)
    return Report(
        "The lightest grip that holds",
        "Eq. 5 closes the jaws by an energy balance in which friction has no part. Here every stable grasp "
        f"is closed only until the friction that the retraction needs is {percent(MARGIN)} below its limit "
        "of 0.5 (planner `light_grip`), and compared with Eq. 5 at equal limits, for lines of sight of "
        f"{SLOPE:.0f}° and for CTC and circular paths. Hatched: not certified. Where Eq. 5 slips, the "
        "lightest grip that holds is the firmer one. Strains that differ by less than "
        f"{percent(EQUAL)} count as equal.",
        rows,
        figure,
        claims,
        [
            "Both grips meet the same friction limit; the lightest one uses it up, so that there paths are "
            "compared at equal security."
        ],
    )


def _claims(scene: str, positions: Sequence[float], maps: dict[tuple[str, str], Array]) -> list[Claim]:
    def least(path: str, grip: str) -> Array:
        values = maps[path, grip]
        found: Array = np.min(np.where(np.isnan(values), np.inf, values), axis=1)
        return found

    after, before, circular = least("ctc", "light"), least("ctc", "eq5"), least("circular", "light")
    ours, theirs = maps["ctc", "light"], maps["circular", "light"]
    both = ~np.isnan(ours) & ~np.isnan(theirs)
    claims = []
    for said, others, words, more in (
        ("the least strain of CTC falls, with the line at ...", before, "{1} to {0}", ""),
        (
            "at equal security CTC strains less than circular (least strain of each)",
            circular,
            "{0} and {1}",
            f"; CTC lower for {lower(ours, theirs).sum()} of {both.sum()} grasps and lines that both certify",
        ),
    ):
        known = np.isfinite(after) | np.isfinite(others)
        if known.any():
            told = [
                f"{percent(position)}: {words.format(_strain(after[k]), _strain(others[k]))}"
                for k, position in enumerate(positions)
                if known[k]
            ]
            falls = lower(after, others)[known]
            agrees: Agreement = "yes" if falls.all() else "in part" if falls.any() else "no"
            claims.append(Claim(f"{scene}: {said}", ", ".join(told) + more, agrees))
    return claims


def lower(strains: Array, others: Array) -> NDArray[np.bool_]:
    """Where strains are lower by more than what they are known to; nan is no strain."""
    found: NDArray[np.bool_] = strains * (1 + EQUAL) < others
    return found


def _strain(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "none"


STUDY = Study("light_grip", "the lightest grip that holds", _experiments, _report)
