"""Pruning: what it saves, on ten and on twenty veins. Sec. V-D."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.study import Agreement, Claim, Report, Study, new_figure, number, paper_scene
from planners import NoPlan
from planners.certify import Trial
from planners.proposals import along, stable_grasps
from planners.search import generate_and_test
from retract_env.drawing.palette import GREY, LIMIT, VALUE
from retract_env.scene import Scene

PAPER = {"ten_veins": (286.0, 76.0), "twenty_veins": (819.0, 95.0)}
"""s, without and with pruning"""
# the ways that need no other model than the judge's
LOOKS = {"none": ("none", GREY), "bound": ("the paper's", VALUE), "squeeze": ("ours", LIMIT)}


def pruning_experiments(scenes: Sequence[str]) -> list[Experiment]:
    """Every way of pruning on every scene."""
    return [
        Experiment(
            search,
            {"scene": paper_scene(name).dump(), "pruning": pruning},
            {"scene": name, "pruning": pruning},
        )
        for name in scenes
        for pruning in LOOKS
    ]


def search(resolution: str, scene: Any, pruning: str) -> Row:
    """The paper's planner on one thread, with times, s, of this process."""
    flap = Scene.from_data(scene)
    proposals = along(flap, stable_grasps(flap), ["ctc"])
    Trial(flap, *proposals[0], "coarse").squeeze()  # the kernels are loaded
    start, cpu = time.perf_counter(), time.process_time()
    try:
        plan = generate_and_test(flap, proposals, "ctc", resolution, 1, pruning=pruning)
        candidates, best = plan.candidates, {"x": plan.grasp.x, "max_strain": plan.certificate.max_strain}
    except NoPlan as none:
        candidates, best = none.candidates, {"x": math.nan, "max_strain": math.nan}
    return {
        **best,
        "candidates": len(candidates),
        "pruned": sum(c.reason == "pruned" for c in candidates),
        "increments": sum(c.increments for c in candidates),
        "cpu_seconds": time.process_time() - cpu,
        "wall_seconds": time.perf_counter() - start,
    }


def _experiments() -> list[Experiment]:
    return pruning_experiments(list(PAPER))


def _report(rows: Sequence[Row]) -> Report:
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    found = {(row["scene"], row["pruning"]): row for row in rows}
    figure = new_figure(8.0, 3.6)
    panels = figure.subplots(1, 2)
    for axes, value, title in (
        (panels[0], "cpu_seconds", "processor time, s"),
        (panels[1], "increments", "increments simulated"),
    ):
        for shift, (pruning, (name, colour)) in enumerate(LOOKS.items()):
            at = np.arange(len(scenes)) + 0.27 * (shift - 1)
            heights = [number(found[scene, pruning][value]) for scene in scenes]
            bars = axes.bar(at, heights, width=0.25, color=colour, label=name)
            axes.bar_label(bars, fmt="%.3g", fontsize=8.5)
        axes.set_xticks(range(len(scenes)), [scene.replace("_", " ") for scene in scenes])
        axes.set_title(title)
        axes.margins(y=0.12)
    panels[0].legend(title="pruning", frameon=False)
    claims = []
    for scene in scenes:
        before, after = PAPER[scene]
        none = found[scene, "none"]
        saved = {p: none["cpu_seconds"] / found[scene, p]["cpu_seconds"] for p in ("bound", "squeeze")}
        fewer = {p: none["increments"] / found[scene, p]["increments"] for p in ("bound", "squeeze")}
        same = len({(found[scene, p]["x"], found[scene, p]["max_strain"]) for p in LOOKS}) == 1
        agrees: Agreement = "no" if saved["bound"] <= 1 or not same else "in part"
        if same and saved["bound"] >= before / after / 2:
            agrees = "yes"
        claims.append(
            Claim(
                f"{scene.replace('_', ' ')}: {before:.0f} s become {after:.0f} s, {before / after:.1f} "
                "times less",
                f"the paper's pruning: {none['cpu_seconds']:.1f} s become "
                f"{found[scene, 'bound']['cpu_seconds']:.1f} s, {saved['bound']:.1f} times less "
                f"({fewer['bound']:.1f} times fewer increments); squeezing first: {saved['squeeze']:.1f} "
                f"times less ({fewer['squeeze']:.1f} times fewer increments); "
                f"{'the same' if same else 'not the same'} retraction is found",
                agrees,
            )
        )
    return Report(
        "Pruning",
        "The paper's planner on one thread, three ways: every retraction to its end; by the stability "
        "score, each stopped once its strain exceeds the best certified one (the paper's pruning); all "
        "squeezed first, then moved in the order of that strain under the same bound (ours). Agreement: at "
        "least half the paper's saving.",
        rows,
        figure,
        claims,
        [],
    )


STUDY = Study("pruning", "what pruning saves", _experiments, _report)
