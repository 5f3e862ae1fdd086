"""The picture of one scene's retractions by several methods, each at its end, and what they cost."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image

from baselines.pictures.drawing import (
    HALO,
    MM,
    MN,
    STYLE,
    FlapArtist,
    JawArtist,
    draw_flap_at_rest,
    draw_surroundings,
    drawn_frames,
    strain_map,
    view_limits,
)
from baselines.pictures.words import percent
from retract_env.drawing.palette import GREY, INK, LIMIT, METHODS
from retract_env.drawing.shapes import SectionTopology

if TYPE_CHECKING:
    from planners.base import Plan
    from retract_env.scene import Scene

DPI = 110
PAGE, EDGE, GAP = 16.0, 0.45, 0.5  # inches: width, margins, between panels
BARS = 1.25  # inches, height
EXPLAINED = (
    "Each flap at the end of its retraction, when the bed left of B can be seen from A along the green line; "
    "pale, at rest. The darker, the more the tissue is strained.",
    "Below: what that costs, and in how many of 100 flaps that are not quite as the scene says the same "
    "motion may fail, at most",
)
LONGEST = 60  # characters over a panel


@dataclass(frozen=True)
class Compared:
    """What one method came to."""

    name: str
    plan: Plan | None
    """with its certificate's frames; None where nothing was certified"""
    why: str = ""
    """nothing was certified"""

    @property
    def held(self) -> str:
        """By what the jaws close."""
        if self.plan is None:
            return ""
        grasp = self.plan.grasp
        return f"{grasp.compression * MM:.2f} mm" if grasp.force is None else f"{grasp.force * MN:.1f} mN"

    @property
    def bound(self) -> float:
        """Probability of failing, at most; nan where nothing is stated."""
        robust = None if self.plan is None else self.plan.certificate.robust
        return math.nan if robust is None else float(robust["bound"])


def comparison(scene: Scene, compared: Sequence[Compared]) -> bytes:
    """A PNG, 1760 pixels wide. Raises ValueError where no method has a plan, or a certificate no frames."""
    with matplotlib.rc_context(STYLE):
        canvas: Any = FigureCanvasAgg(comparison_figure(scene, compared))
        canvas.draw()
    data = io.BytesIO()
    drawn = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
    drawn.convert("RGB").save(data, format="png", compress_level=3, dpi=(DPI, DPI))
    return data.getvalue()


def comparison_figure(scene: Scene, compared: Sequence[Compared]) -> Figure:
    """What `comparison` draws. Its axes' labels: retraction 0 and on, strain, bars 0 to 2."""
    plans = [c.plan for c in compared if c.plan is not None]
    if not plans:
        raise ValueError("nothing to draw: no method has a plan")
    views = np.array([view_limits(scene, drawn_frames(plan.certificate)[0]) for plan in plans])
    limits = (*views[:, 0:1].min(0), *views[:, 1:2].max(0), *views[:, 2:3].min(0), *views[:, 3:4].max(0))
    n, bar_room = len(compared), 0.9
    wide = (PAGE - 2 * EDGE - bar_room - (n - 1) * GAP) / n
    tall = wide * (limits[3] - limits[2]) / (limits[1] - limits[0])
    below = 0.4 + BARS + 0.75
    height = below + tall + 1.75
    figure = Figure(figsize=(PAGE, round(height * DPI) / DPI), dpi=DPI)

    def panel(label: str, left: float, bottom: float, w: float, h: float) -> Axes:
        return figure.add_axes((left / PAGE, bottom / height, w / PAGE, h / height), label=label)

    left = EDGE / PAGE
    title = f"{scene.name.replace('_', ' ')}, retracted by each method"
    figure.text(left, 1 - 0.42 / height, title, fontsize=17, weight="bold")
    robust = [plan.certificate.robust for plan in plans if plan.certificate.robust is not None]
    asked = 100 * robust[0]["eps"] if robust else math.nan
    sure = f" (with confidence {100 * (1 - robust[0]['beta']):.6g} %)." if robust else "."
    figure.text(left, 1 - 0.72 / height, EXPLAINED[0], fontsize=10.5, color=GREY)
    figure.text(left, 1 - 0.96 / height, EXPLAINED[1] + sure, fontsize=10.5, color=GREY)
    for i, one in enumerate(compared):
        axes = panel(f"retraction {i}", EDGE + i * (wide + GAP), below, wide, tall)
        _draw_end(axes, scene, one, limits)
        axes.set_title(one.name, fontsize=13, weight="bold", color=_colour(i), pad=24)
        axes.text(0, 1.03, _facts(one), transform=axes.transAxes, fontsize=10.5, color=GREY)
    limit = scene.limits.strain
    bar = panel("strain", PAGE - EDGE - bar_room + 0.18, below + 0.15 * tall, 0.16, 0.7 * tall)
    figure.colorbar(
        ScalarMappable(Normalize(0.0, limit), strain_map()), cax=bar, label="strain, up to its limit"
    )
    names, gap = 1.45, 0.55
    each = (PAGE - 2 * EDGE - 2 * gap) / 3
    rows = (
        ("Strain of the worst 1 % of the tissue", "max_strain", limit, "{:.3f}".format),
        ("Friction needed to hold", "required_friction", scene.limits.friction, "{:.2f}".format),
        ("May fail in at most so many of 100", "bound", asked, _of_100),
    )
    for k, (said, name, allowed, text) in enumerate(rows):
        axes = panel(f"bars {k}", EDGE + k * (each + gap) + names, 0.4, each - names, BARS)
        _draw_bars(axes, said, compared, [_of(one, name) for one in compared], allowed, text)
    return figure


def _of(one: Compared, name: str) -> float:
    """A number of the certificate, or the bound, %; nan where there is none."""
    if name == "bound":
        return 100 * one.bound
    return math.nan if one.plan is None else float(getattr(one.plan.certificate, name))


def _of_100(value: float) -> str:
    return percent(value / 100).removesuffix(" %")


def _colour(i: int) -> str:
    return METHODS[i % len(METHODS)]


def _facts(one: Compared) -> str:
    if one.plan is None:
        text = f"no plan certified of {one.why}"
        return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
    by = "closed by" if one.plan.grasp.force is None else "pressing with"
    seconds = one.plan.timings.get("total")
    found = "" if seconds is None else f"; found in {seconds:.1f} s"
    return f"gripped at {one.plan.grasp.x * MM:.1f} mm, {by} {one.held}{found}".replace("-", "\N{MINUS SIGN}")


def _draw_end(axes: Axes, scene: Scene, one: Compared, limits: tuple[float, float, float, float]) -> None:
    """The flap at the end, over the flap at rest."""
    clear = one.plan is None or one.plan.certificate.clearance >= 0
    draw_surroundings(axes, scene, limits, clear=clear)
    axes.set_yticks([])
    axes.set_xlabel("mm from the fixed end")
    axes.spines["left"].set_visible(False)
    if one.plan is None:
        draw_flap_at_rest(axes, scene.tissue)
        return
    frames, section = drawn_frames(one.plan.certificate)
    topology = SectionTopology(section, scene.tissue.veins)
    rest = FlapArtist(axes, topology, scene.limits.strain, fade=0.7, zorder=1.0)
    rest.show(frames[0])
    final = FlapArtist(axes, topology, scene.limits.strain, zorder=3.0)
    final.show(frames[-1])
    JawArtist(axes, scene).show(frames[-1].jaws)


def _draw_bars(
    axes: Axes,
    title: str,
    compared: Sequence[Compared],
    values: Sequence[float],
    limit: float,
    text: Callable[[float], str],
) -> None:
    """One bar a method, and the limit; text: a value as it stands beside its bar."""
    axes.set_title(title, fontsize=11, weight="bold")
    where = range(len(compared) - 1, -1, -1)
    longest = max([*(v for v in (*values, limit) if math.isfinite(v)), 0.0]) or 1.0
    lengths = [v if math.isfinite(v) else 0.0 for v in values]
    colours = [_colour(i) for i in range(len(compared))]
    axes.barh(list(where), lengths, height=0.62, color=colours, zorder=2)
    for y, value, length in zip(where, values, lengths, strict=True):
        inside = length > 0.6 * longest  # where the limit's line would cross the number
        axes.annotate(
            text(value) if math.isfinite(value) else "no plan", (length, y),
            xytext=(-5 if inside else 5, 0), textcoords="offset points", ha="right" if inside else "left",
            va="center", color="white" if inside else INK, zorder=4, weight="bold",
        )  # fmt: skip
    if math.isfinite(limit):
        axes.axvline(limit, color=LIMIT, linewidth=1.3, linestyle=(0, (5, 3)), zorder=3)
        axes.annotate(
            f"limit {limit:g}", (limit, 1.0), xycoords=("data", "axes fraction"), xytext=(-4, -1),
            textcoords="offset points", ha="right", va="top", color=LIMIT, fontsize=8.5, path_effects=HALO,
        )  # fmt: skip
    axes.set_yticks(list(where), [one.name for one in compared])
    axes.tick_params(axis="y", length=0, labelsize=9.5)
    axes.set_xlim(0, 1.08 * longest)
    axes.set_ylim(-0.6, len(compared) - 0.1)
