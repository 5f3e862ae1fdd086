"""Fig. 12: the best grasp of CTC for many lines of sight, on homogeneous tissue. Sec. V-C."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment, retraction
from baselines.paper.maps import draw_map
from baselines.paper.study import (
    EQUAL,
    Agreement,
    Claim,
    Report,
    Study,
    new_figure,
    number,
    paper_scene,
    percent,
    with_line,
)
from baselines.pictures.drawing import strain_map
from planners.proposals import uniform_grasps
from retract_env.scene import Limits

Array = NDArray[np.float64]

POSITIONS = (0.55, 0.45, 0.35, 0.25, 0.15)
"""of B, from the fixed end, as parts of the length"""
SLOPES = (30, 45, 60, 75, 90)
"""degrees"""
GRASPS = 50
UNLIMITED = 5.0
"""Friction limit of the retractions, the highest that a scene may have: which of them a lower limit allows is
read off the rows."""
RANGE = (0.15, 0.45)
"""Where the paper finds the best grasps, from the open end, as parts of the length."""


def line_experiments(positions: Sequence[float], slopes: Sequence[float], grasps: int) -> list[Experiment]:
    """Grasps along the flap for every line, CTC, and with friction to spare."""
    scene = paper_scene("homogeneous")
    limits = Limits(strain=scene.limits.strain, friction=UNLIMITED)
    experiments = []
    for slope in slopes:
        for position in positions:
            lined = with_line(scene, position, math.radians(slope)).model_copy(update={"limits": limits})
            for grasp in uniform_grasps(scene, grasps):
                label = {"position": position, "slope": slope, "x": grasp.x}
                experiments.append(retraction(lined.dump(), grasp.x, grasp.compression, "ctc", label))
    return experiments


def best_of(rows: Sequence[Row], friction: float) -> dict[tuple[float, float], Row]:
    """For each line the certified row of least strain, where there is one."""
    best: dict[tuple[float, float], Row] = {}
    for row in rows:
        line = row["slope"], row["position"]
        held = row["reason"] == "ok" and number(row["required_friction"]) <= friction
        if held and (line not in best or row["max_strain"] < best[line]["max_strain"]):
            best[line] = row
    return best


def _experiments() -> list[Experiment]:
    return line_experiments(POSITIONS, SLOPES, GRASPS)


def _report(rows: Sequence[Row]) -> Report:
    scene = paper_scene("homogeneous")
    length, friction = scene.tissue.length, scene.limits.friction
    best = best_of(rows, friction)
    positions = sorted({row["position"] for row in rows}, reverse=True)
    slopes = sorted({row["slope"] for row in rows})

    def grid(value: str) -> Array:
        values = [
            [number(best[s, p][value]) if (s, p) in best else np.nan for p in positions] for s in slopes
        ]
        return np.array(values)

    place = 1 + grid("x") / length  # from the open end, as the paper counts
    strain, needed = grid("max_strain"), grid("required_friction")
    figure = new_figure(12.0, 4.2)
    panels = figure.subplots(1, 3)
    names = [percent(1 - p) for p in positions], [f"{s:g}°" for s in slopes]
    blues = colormaps["Blues"]
    draw_map(panels[0], 100 * place, *names, blues, Normalize(0, 100), ".0f")
    draw_map(panels[1], strain, *names, strain_map(), Normalize(0, scene.limits.strain), ".3f")
    draw_map(panels[2], needed, *names, blues, Normalize(0, friction), ".2f")
    titles = ("best grasp, % from the open end", "its strain", "friction that it needs")
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title)
        axes.set_xlabel("line of sight meets the bed, from the open end")
    panels[0].set_ylabel("slope of the line")

    table = []
    for slope in slopes:
        for position in positions:
            row = best.get((slope, position))
            near = _as_good(rows, slope, position, friction, row)
            table.append(
                {
                    "slope": slope,
                    "position": position,
                    "x": row["x"] if row else "",
                    "from_open_end": 1 + row["x"] / length if row else "",
                    "max_strain": row["max_strain"] if row else "",
                    "required_friction": row["required_friction"] if row else "",
                    "as_good_from": 1 + near[0] / length if near else "",
                    "as_good_to": 1 + near[1] / length if near else "",
                }
            )
    wide = [entry for entry in table if entry["as_good_from"] != ""]
    flat = np.median([entry["as_good_to"] - entry["as_good_from"] for entry in wide])
    return Report(
        "Fig. 12: the best grasp for many lines of sight",
        f"{len({row['x'] for row in rows})} grasps along the homogeneous flap, compressed by Eq. 5, are "
        f"retracted by CTC for {len(positions)} positions and {len(slopes)} slopes of the line of sight; of "
        f"those certified with friction {friction:g} the one of least strain is shown. Hatched: none.",
        table,
        figure,
        [_range(place), _shift(place), _security(rows, needed, best)],
        [
            f"The optimum is flat: the grasps within {percent(EQUAL)} of the least strain, about as near as "
            f"the finite elements know it, span {percent(flat)} of the length (median over the lines). Eq. "
            "5 closes the jaws by a quarter of the height everywhere, and that alone strains the tissue "
            "as much as most of these retractions ever do."
        ],
    )


def _as_good(
    rows: Sequence[Row], slope: float, position: float, friction: float, best: Row | None
) -> tuple[float, float] | None:
    """m, the first and the last grasp that is as good as the best."""
    if best is None:
        return None
    places = [
        row["x"]
        for row in rows
        if (row["slope"], row["position"]) == (slope, position)
        and row["reason"] == "ok"
        and number(row["required_friction"]) <= friction
        and row["max_strain"] <= (1 + EQUAL) * best["max_strain"]
    ]
    return min(places), max(places)


def _range(place: Array) -> Claim:
    known = place[~np.isnan(place)]
    inside = int(((known >= RANGE[0]) & (known <= RANGE[1])).sum())
    agrees: Agreement = "yes" if inside == known.size else "in part" if inside >= known.size / 2 else "no"
    return Claim(
        f"the best grasp lies between {percent(RANGE[0])} and {percent(RANGE[1])} from the open end",
        f"for {inside} of {known.size} lines; all lie between {percent(known.min())} and "
        f"{percent(known.max())}",
        agrees,
    )


def _shift(place: Array) -> Claim:
    """place: (slopes, positions), steeper further on, nearer to the fixed end further on."""
    steeper, nearer = np.diff(place, axis=0), np.diff(place, axis=1)

    def told(steps: Array) -> str:
        known = steps[~np.isnan(steps)]
        return f"{int((known < 0).sum())} steps go towards the open end, {int((known > 0).sum())} away"

    steps = np.concatenate([steeper.ravel(), nearer.ravel()])
    share = float(np.nanmean(np.sign(steps)))
    return Claim(
        "it moves towards the open end as the line steepens or nears the fixed end",
        f"steeper by one step: {told(steeper)}; nearer by one step: {told(nearer)}",
        "yes" if share < -0.5 else "in part" if share < 0 else "no",
    )


def _security(rows: Sequence[Row], needed: Array, best: dict[tuple[float, float], Row]) -> Claim:
    freely = best_of(rows, math.inf)
    same = sum(freely[line]["x"] == row["x"] for line, row in best.items())
    insensitive = same == len(freely)
    frictionless = bool(np.nanmax(needed) < 0.01)
    return Claim(
        "the best grasp does not depend on the friction limit, and needs no friction",
        f"without any limit the best grasp is the same for {same} of {len(freely)} lines; it needs friction "
        f"of {np.nanmin(needed):.2f} to {np.nanmax(needed):.2f}",
        "yes" if insensitive and frictionless else "in part" if insensitive or frictionless else "no",
    )


STUDY = Study("fig12", "the best grasp for many lines of sight", _experiments, _report)
