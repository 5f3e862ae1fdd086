"""Fig. 7: the spring model against brute-force finite elements, on the flaps with veins. Sec. V-A."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import spearmanr

from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.study import Agreement, Claim, Report, Study, new_figure, paper_scene
from baselines.pictures.drawing import HALO, KPA_PER_MM, MM, draw_flap_at_rest
from baselines.pictures.labels import Number, write_numbers
from planners.deform_closure import NODES, PAIRS, Closure, brute_force, closure_grasps
from planners.proposals import stable_grasps
from retract_env.drawing.palette import LIMIT, VALUE
from retract_env.grasp import Grasp
from retract_env.scene import Scene
from retract_env.spring import SpringModel

Array = NDArray[np.float64]

TOP = 15
"""Grasps of each method that are compared."""
FINE = 2001
"""Points of the spring model's curve in the picture."""
SCENES = ("ten_veins", "twenty_veins")
PAPER_AGREE = 8
"""Of those, how many the paper finds in both."""


class Rankings(NamedTuple):
    """Stable grasps of both methods, best first, `TOP` at most, and which of the first the second has too."""

    brute: list[Grasp]
    spring: list[Grasp]
    shared: list[bool]


def rankings(scene: Scene, found: Closure) -> Rankings:
    """The agreement: a brute-force grasp is shared where a spring grasp is within half a jaw's width of
    it."""
    brute, spring = closure_grasps(scene, found)[:TOP], stable_grasps(scene)[:TOP]
    near = scene.jaws.width / 2
    return Rankings(brute, spring, [any(abs(b.x - s.x) <= near for s in spring) for b in brute])


def closure_of(row: Row) -> Closure:
    """What brute force found, from a row."""
    x, k, strain = (np.array(row[name]) for name in ("x", "k_fem", "strain_fem"))
    return Closure(x, k, strain, row["nodes"])


def stiffness(resolution: str, scene: Any, pairs: int, nodes: int) -> Row:  # noqa: ARG001, `nodes` says it
    """Brute force and spring model, with times, s."""
    flap = Scene.from_data(scene)
    brute_force(flap, pairs=3, nodes=100)  # the kernels are loaded
    SpringModel(flap.tissue).stable_grasps()
    start, cpu = time.perf_counter(), time.process_time()
    found = brute_force(flap, pairs, nodes)
    fem, fem_cpu = time.perf_counter() - start, time.process_time() - cpu
    start, cpu = time.perf_counter(), time.process_time()
    spring = SpringModel(flap.tissue)
    stable_grasps(flap)
    spent, spent_cpu = time.perf_counter() - start, time.process_time() - cpu
    return {
        "x": found.x.tolist(),
        "k_fem": found.k.tolist(),
        "strain_fem": found.strain.tolist(),
        "k_spring": spring.k_eq(found.x).tolist(),
        "nodes": found.nodes,
        "fem_seconds": fem,
        "fem_cpu_seconds": fem_cpu,
        "spring_seconds": spent,
        "spring_cpu_seconds": spent_cpu,
    }


def _experiments() -> list[Experiment]:
    return [
        Experiment(
            stiffness,
            {"scene": paper_scene(name).dump(), "pairs": PAIRS, "nodes": NODES},
            {"scene": name},
        )
        for name in SCENES
    ]


def _report(rows: Sequence[Row]) -> Report:
    figure = new_figure(12.0, 6.2)
    panels = figure.subplots(3, len(rows), sharex="col", height_ratios=(0.55, 1.6, 1.6), squeeze=False)
    claims, notes, drawn = [], [], []
    for column, row in enumerate(rows):
        scene, found = paper_scene(row["scene"]), closure_of(row)
        both = rankings(scene, found)
        _draw_flap(panels[0, column], scene)
        panels[0, column].set_title(f"{len(scene.tissue.veins)} veins, seen from the side")
        k_spring = np.array(row["k_spring"])
        x = np.linspace(found.x[0], found.x[-1], FINE)
        exact = SpringModel(scene.tissue).k_eq(x)
        for panel, at, k, grasps, colour, title in (
            (panels[1, column], x, exact, both.spring, VALUE, "spring model"),
            (panels[2, column], found.x, found.k, both.brute, LIMIT, "brute-force finite elements"),
        ):
            drawn.append((panel, *_draw_curve(panel, at, k, grasps, colour, title)))
        panels[2, column].set_xlabel("mm from the fixed end")
        claims.append(_agreement(scene, both))
        claims.append(_cost(scene, row))
        notes.append(_ranks(scene, found, k_spring))
    for axes in panels[1:, 0]:
        axes.set_ylabel("stiffness, kPa/mm")
    figure.draw_without_rendering()  # where the panels are is known then
    figure.set_layout_engine("none")
    for axes, places, curve in drawn:
        numbers = [Number(place, str(rank), size=8.0) for rank, place in enumerate(places, 1)]
        write_numbers(axes, numbers, curve, path_effects=HALO)
    table = [
        {
            "scene": row["scene"],
            "x": x,
            "k_spring": spring,
            "k_fem": fem,
            "strain_fem": strain,
        }
        for row in rows
        for x, spring, fem, strain in zip(
            row["x"], row["k_spring"], row["k_fem"], row["strain_fem"], strict=True
        )
    ]
    return Report(
        "Fig. 7: where to grasp, spring model against brute force",
        f"Each of {PAIRS} opposite pairs of jaws presses the flap, evenly over its 1 mm and by the same "
        f"distance, in linear finite elements of about {NODES} nodes; its stiffness per area is compared "
        "with k_eq of Eq. 2. Ranked are the stable grasps: minima of the stiffness, the flap's ends left "
        "out, by U_n = k_n delta^2 / 2, where delta balances the energies of Sec. IV-C on each method's "
        "own stiffness (for brute force the strain limit is its own too: eps_1% per millimetre of "
        f"closing). The first {TOP} of each are compared; two are the same where they are within half a "
        "jaw's width.",
        table,
        figure,
        claims,
        notes,
    )


def _agreement(scene: Scene, both: Rankings) -> Claim:
    shared, of = sum(both.shared), len(both.brute)
    agrees: Agreement = "yes" if shared >= PAPER_AGREE / TOP * of else "no"
    few = "" if of == TOP else f" (there are no more than {of})"
    return Claim(
        f"{PAPER_AGREE} of the top {TOP} grasps of brute force are among those of the spring model",
        f"{len(scene.tissue.veins)} veins: {shared} of the top {of} of brute force{few} are among the top "
        f"{len(both.spring)} of the spring model",
        agrees,
    )


def _cost(scene: Scene, row: Row) -> Claim:
    ratio = row["fem_cpu_seconds"] / max(row["spring_cpu_seconds"], 1e-9)
    return Claim(
        "the spring model is orders of magnitude cheaper: 0.1 s for 16 min 32 s",
        f"{len(scene.tissue.veins)} veins, {row['nodes']} nodes: {row['fem_cpu_seconds']:.1f} s and "
        f"{row['spring_cpu_seconds'] * 1e3:.2f} ms of processor time, {ratio:.0f} times less",
        "yes" if ratio > 100 else "no",
    )


def _ranks(scene: Scene, found: Closure, k_spring: Array) -> str:
    correlation = float(spearmanr(found.k, k_spring).statistic)
    softest = int(np.isclose(k_spring, k_spring.min(), rtol=1e-9).sum())
    return (
        f"{len(scene.tissue.veins)} veins: over all {len(found.x)} pairs the ranks of both stiffnesses "
        f"correlate with {correlation:.2f} (Spearman). In the spring model {softest} pairs are equally "
        f"soft, having no vein between them, so that the softest {TOP} pairs would be no ranking. Brute "
        f"force is {float(np.median(found.k / k_spring)):.1f} times as stiff (median), as the load spreads "
        "to the sides; towards the free end it is softer, towards the fixed end stiffer, which the spring "
        "model does not know."
    )


def _draw_flap(axes: Axes, scene: Scene) -> None:
    draw_flap_at_rest(axes, scene.tissue)
    axes.autoscale_view()
    axes.set_ylim(-0.3, scene.tissue.height * MM + 0.3)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_curve(
    axes: Axes, x: Array, k: Array, grasps: Sequence[Grasp], colour: str, title: str
) -> tuple[list[tuple[float, float]], Array]:
    """k: (p,) Pa/m at x (p,) m. Returns where the grasps are drawn, in their rank's order, and the curve
    (p, 2)."""
    axes.plot(x * MM, k * KPA_PER_MM, color=colour, linewidth=1.4)
    inner = k[np.abs(x - x.mean()) < 0.48 * np.ptp(x)] * KPA_PER_MM  # the very ends would flatten the rest
    axes.set_ylim(inner.min() - 0.2 * np.ptp(inner), inner.max() + 0.08 * np.ptp(inner))
    places = [(g.x * MM, float(np.interp(g.x, x, k)) * KPA_PER_MM) for g in grasps]
    axes.plot(*np.array(places).T, "o", color=colour, markersize=5, markerfacecolor="white")
    axes.set_title(f"{title}: the first {len(grasps)} stable grasps")
    return places, np.column_stack((x * MM, k * KPA_PER_MM))


STUDY = Study("fig7", "spring model against brute force", _experiments, _report)
