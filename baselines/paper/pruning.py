"""Pruning: what it saves, on ten and on twenty veins. Sec. V-D."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baselines.paper.report import Agreement, Claim, Report, Study, new_figure, number, paper_scene
from baselines.paper.tasks import Row, Task
from planners.search import PRUNING
from retract_env.drawing.palette import GREY, LIMIT, VALUE

PAPER = {"ten_veins": (286.0, 76.0), "twenty_veins": (819.0, 95.0)}
"""s, without and with pruning"""
LOOKS = {"none": ("none", GREY), "bound": ("the paper's", VALUE), "squeeze": ("ours", LIMIT)}


def pruning_tasks(scenes: Sequence[str]) -> list[Task]:
    """Every way of pruning on every scene."""
    return [
        Task(
            "search",
            {"scene": paper_scene(name).dump(), "pruning": pruning},
            {"scene": name, "pruning": pruning},
        )
        for name in scenes
        for pruning in reversed(PRUNING)
    ]


def _tasks() -> list[Task]:
    return pruning_tasks(list(PAPER))


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


STUDY = Study("pruning", "what pruning saves", _tasks, _report)
