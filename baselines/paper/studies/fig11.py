"""Fig. 11: strain of four paths from the same grasps, on ten veins. Sec. V-B."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.studies.fig8 import (
    LOOKS,
    beaten,
    draw_strains,
    exceptions,
    failures,
    path_experiments,
    strain_curves,
)
from baselines.paper.study import EQUAL, Agreement, Claim, Report, Study, new_figure, paper_scene, percent
from baselines.pictures.drawing import MM


def _experiments() -> list[Experiment]:
    return path_experiments([paper_scene("ten_veins")])


def _report(rows: Sequence[Row]) -> Report:
    figure = new_figure(8.0, 4.2)
    axes = figure.subplots()
    places, curves = strain_curves(rows, "ten_veins")
    beyond = {row["x"]: row["veins_beyond"] for row in rows}
    draw_strains(axes, list(range(len(places))), curves)
    axes.set_xticks(
        range(len(places)), [f"{beyond[x]}\n{x * MM:.1f}".replace("-", "\N{MINUS SIGN}") for x in places]
    )
    axes.set_xlabel("veins between grasp and free end; grasp, mm from the fixed end")
    axes.set_title("ten veins, grasps between them")
    axes.text(axes.get_xlim()[0], 0.505, " not certified", fontsize=8.5, va="bottom")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)

    worse = beaten(places, curves)
    best = {p: places[int(np.nanargmin(v))] for p, v in curves.items() if not np.all(np.isnan(v))}
    usual: Agreement = "yes" if len(worse) < len(places) / 2 else "no"
    same = best.get("ctc") is not None and best.get("ctc") == best.get("circular")
    told = "; ".join(
        f"{LOOKS[p][0]} {np.nanmin(curves[p]):.3f} with {beyond[x]} veins beyond it" for p, x in best.items()
    )
    claims = [
        Claim("CTC usually strains least, with exceptions", exceptions(worse, len(places)), usual),
        Claim(
            "CTC and circular find the same best grasp, between veins 3 and 4",
            f"best: {told}",
            "yes" if same and beyond[best["ctc"]] == 3 else "in part" if same else "no",
        ),
    ]
    return Report(
        "Fig. 11: paths compared on ten veins",
        "Every stable grasp of the flap with ten veins (the paper's grasps between veins, and one at each "
        "end), compressed by Eq. 5, is retracted along four paths until the target is in view; line of "
        f"sight of 45° at 25 % of the length. Strains that differ by less than {percent(EQUAL)} count as "
        "equal. The veins are drawn after Fig. 10, whose coordinates are not published.",
        rows,
        figure,
        claims,
        [failures(rows)],
    )


STUDY = Study("fig11", "four paths on ten veins", _experiments, _report)
