"""The picture of a planned retraction: where to grasp, how the flap moves, how far it stays within limits."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import MaxNLocator
from PIL import Image

from baselines.jobs.files import written_whole
from baselines.pictures.drawing import (
    HALO,
    HATCHED,
    KPA_PER_MM,
    MM,
    MN,
    STYLE,
    FlapArtist,
    JawArtist,
    bed_note,
    draw_flap_at_rest,
    draw_histories,
    draw_surroundings,
    drawn_frames,
    squeeze_end,
    strain_map,
    view_limits,
)
from baselines.pictures.labels import Number, write_numbers
from baselines.pictures.stiffness import StiffnessCurve, stiffness_curve
from retract_env.drawing.palette import GREY, HIDDEN_VEIL, INK, LIMIT, SIGHT, STEEL, VALUE
from retract_env.drawing.shapes import SectionTopology, hidden_region

if TYPE_CHECKING:
    from planners.base import Plan
    from retract_env.physics.base import TissueState

DPI = 160
WIDTH, LEFT, RIGHT = 10.0, 0.75, 0.95  # inches: page, margins
GHOSTS = 3

VERDICTS = {
    "ok": "Certified",
    "not_visible": "Not certified, target still hidden",
    "strain": "Not certified, too much strain",
    "slip": "Not certified, a jaw slips",
    "release": "Not certified, a jaw lets go",
    "contact": "Not certified, tissue runs into itself or the fixed block",
    "torn": "Not certified, tissue tears",
    "diverged": "Not certified, no equilibrium found",
}


def draw_retraction(plan: Plan, path: str | Path) -> None:
    """Write the picture of a plan as PNG, 1600 pixels wide; the file appears whole or not at all.

    Above: stiffness k_eq of Eq. 2 along the flap with the ranked grasps, over the flap at rest, as in Fig. 4.
    Middle: the flap over the motion, coloured by strain up to its limit.
    Below: strain, friction and clearance over the increments with their limits (Sec. III-C).

    Raises ValueError where the certificate holds no frames.
    """
    data = picture(plan)
    with written_whole(Path(path)) as temporary:
        temporary.write_bytes(data)


def picture(plan: Plan, curve: StiffnessCurve | None = None) -> bytes:
    """What draw_retraction writes. Raises ValueError where the certificate holds no frames."""
    with matplotlib.rc_context(STYLE):
        figure = retraction_figure(plan, curve)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
    drawn = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
    data = io.BytesIO()
    # a third of the time that the usual level takes, for 2 % more bytes, which leaving out alpha saves
    drawn.convert("RGB").save(data, format="png", compress_level=3, dpi=(DPI, DPI))
    return data.getvalue()


def retraction_figure(plan: Plan, curve: StiffnessCurve | None = None) -> Figure:
    """What draw_retraction writes. Its axes' labels: stiffness, rest, motion, strain, history 0 to 2."""
    frames, _ = drawn_frames(plan.certificate)
    limits = view_limits(plan.scene, frames)
    inner = WIDTH - LEFT - RIGHT
    per_mm = inner / (limits[1] - limits[0])
    rest_mm = plan.scene.tissue.height * MM + 1.0
    below, histories = 0.55, 1.35
    motion, rest, stiffness = (limits[3] - limits[2]) * per_mm, rest_mm * per_mm, 1.45
    bottoms = np.cumsum([below, histories + 0.95, motion + 0.65, rest])
    height = bottoms[3] + stiffness + 1.3
    figure = Figure(figsize=(WIDTH, round(height * DPI) / DPI), dpi=DPI)

    def panel(label: str, bottom: float, tall: float, left: float = LEFT, wide: float = inner) -> Axes:
        return figure.add_axes((left / WIDTH, bottom / height, wide / WIDTH, tall / height), label=label)

    _draw_title(figure, plan, height)
    upper, lower = panel("stiffness", bottoms[3], stiffness), panel("rest", bottoms[2], rest)
    _draw_rest(lower, plan, limits[:2], rest_mm)
    _draw_stiffness(upper, lower, plan, stiffness_curve(plan) if curve is None else curve)
    middle = panel("motion", bottoms[1], motion)
    _draw_motion(middle, plan, limits)
    bar_height = min(0.6 * motion, 3.2)
    bar = panel("strain", bottoms[1] + motion - bar_height, bar_height, WIDTH - RIGHT + 0.12, 0.16)
    limit = plan.certificate.strain_limit
    figure.colorbar(
        ScalarMappable(Normalize(0.0, limit), strain_map()), cax=bar, label="strain, up to its limit"
    )
    bar.set_yticks(np.linspace(0.0, limit, 6), [f"{v:.2g}" for v in np.linspace(0.0, limit, 6)])
    gap = 0.55
    wide = (WIDTH - LEFT - 0.3 - 2 * gap) / 3
    lefts = [LEFT + i * (wide + gap) for i in range(3)]
    plots = [panel(f"history {i}", bottoms[0], histories, left, wide) for i, left in enumerate(lefts)]
    draw_histories(plots, plan.certificate)
    return figure


def verdict(plan: Plan) -> str:
    """One line: certified or why not, with the margins."""
    c = plan.certificate
    parts = (
        f"strain {c.max_strain:.3f} of {c.strain_limit:g}",
        f"friction {c.required_friction:.2f} of {c.friction_limit:g}",
        f"clearance {c.clearance * MM:+.2f} mm",
    )
    text = f"{VERDICTS.get(c.reason, c.reason)}   {'   ·   '.join(parts)}"
    return text.replace("-", "\N{MINUS SIGN}")


def heading(plan: Plan) -> str:
    """Scene and planner, at most 60 characters."""
    title = f"{plan.scene.name.replace('_', ' ')}  ·  planner {plan.planner}"
    return title if len(title) <= 60 else title[:59] + "…"


def _draw_title(figure: Figure, plan: Plan, height: float) -> None:
    left, grasp = LEFT / WIDTH, plan.grasp
    held = f"closed by {grasp.compression * MM:.2f} mm"
    if grasp.force is not None:
        held = f"pressing with {grasp.force * MN:.1f} mN"
    where = f"Grasp {-grasp.x * MM:.1f} mm from the fixed end, jaws {held}"
    colour = SIGHT if plan.certificate.certified else LIMIT
    figure.text(left, 1 - 0.38 / height, heading(plan), fontsize=16, weight="bold")
    figure.text(left, 1 - 0.63 / height, where, fontsize=10.5, color=GREY)
    figure.text(left, 1 - 0.86 / height, verdict(plan), fontsize=10.5, weight="bold", color=colour)


def _draw_stiffness(axes: Axes, below: Axes, plan: Plan, curve: StiffnessCurve) -> None:
    tissue, chosen = plan.scene.tissue, plan.grasp.x
    x, k = curve.x, curve.k * KPA_PER_MM
    axes.set_xlim(*below.get_xlim())
    low, high = float(k.min()), float(k.max())
    room = max(high - low, 0.5 * high)
    axes.set_ylim(low - 0.42 * room, high + 0.15 * room)
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes.plot(x * MM, k, color=INK, linewidth=1.4, zorder=3)
    axes.set_ylabel("stiffness k_eq\nkPa/mm")
    axes.yaxis.set_label_coords(-0.045, 0.5)
    axes.tick_params(labelbottom=False, bottom=False)
    axes.spines["bottom"].set_visible(False)
    # the chosen one first, so that it has its number below it
    grasps = sorted(curve.grasps, key=lambda g: (abs(g[1] - chosen) > 1e-9, g[0]))
    best = [abs(at - chosen) <= 1e-9 for _, at, _ in grasps]
    places = [(at * MM, stiffness * KPA_PER_MM) for _, at, stiffness in grasps]
    for (rank, _, _), is_best, (at, height) in zip(grasps, best, places, strict=True):
        colour = VALUE if is_best else GREY
        axes.plot(
            at, height, "o", markersize=8 if is_best else 5, markerfacecolor=VALUE if is_best else "white",
            markeredgecolor=colour, markeredgewidth=1.2, zorder=4 if is_best else 5, gid=f"grasp {rank}",
        )  # fmt: skip
        line: Any = {"linewidth": 1.6} if is_best else {"linewidth": 0.8, "linestyle": (0, (2, 2))}
        below.plot([at] * 2, [0, tissue.height * MM], color=colour, zorder=3, **line)
        if is_best:
            axes.plot([at] * 2, [axes.get_ylim()[0], height], color=VALUE, linewidth=1.6, zorder=2)
    numbers = [
        Number(place, str(rank or ""), VALUE, 11.0, 8.0, "bold")
        if is_best
        else Number(place, str(rank or ""))
        for (rank, _, _), is_best, place in zip(grasps, best, places, strict=True)
    ]
    write_numbers(axes, numbers, np.column_stack((x * MM, k)), path_effects=HALO, zorder=6)
    axes.set_title(f"Where to grasp: {_grasps_in_words(plan)}; blue was chosen", pad=6)


def _grasps_in_words(plan: Plan) -> str:
    """What the numbers along the flap are."""
    if any(math.isfinite(candidate.grasp.score) for candidate in plan.candidates):
        stable = "stable grasps lie where the flap is softest, 1 is the most secure"
        return stable if plan.scene.tissue.veins else "no spot is softer than another"
    return "numbers are places tried, in that order"


def _draw_rest(axes: Axes, plan: Plan, span: tuple[float, float], tall: float) -> None:
    height = plan.scene.tissue.height * MM
    axes.set_xlim(*span)
    axes.set_ylim(-0.3, tall - 0.3)
    axes.set_aspect("equal")
    draw_flap_at_rest(axes, plan.scene.tissue)
    axes.add_patch(Rectangle((0, 0), span[1], height, zorder=1, **HATCHED))
    axes.plot([0, 0], [0, height], color=INK, linewidth=2.2, solid_capstyle="butt", zorder=2)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(left=False, labelleft=False, length=2, pad=1)


def _ghosts(frames: Sequence[TissueState]) -> list[int]:
    start, last = squeeze_end(frames), len(frames) - 1
    middle = np.array([np.asarray(f.jaws).reshape(2, 2).mean(axis=0) for f in frames[start:]])
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))))
    wanted = np.linspace(0.0, travelled[-1], GHOSTS + 2)[1:-1]
    picks = start + np.searchsorted(travelled, wanted)
    return sorted({int(i) for i in picks if 0 < i < last})


def _draw_motion(axes: Axes, plan: Plan, limits: tuple[float, float, float, float]) -> None:
    frames, scene, limit = plan.certificate.frames, plan.scene, plan.certificate.strain_limit
    topology = SectionTopology(drawn_frames(plan.certificate)[1], scene.tissue.veins)
    draw_surroundings(axes, scene, limits, clear=frames[-1].clearance >= 0)
    if len(frames) > 1:
        for depth, index in enumerate([0, *_ghosts(frames)]):
            ghost = FlapArtist(axes, topology, limit, fade=0.75 - 0.08 * depth, zorder=1.0 + 0.3 * depth)
            ghost.show(frames[index])
            pads = JawArtist(axes, scene, fade=0.7, zorder=1.2 + 0.3 * depth)
            pads.show(frames[index].jaws)
    final = FlapArtist(axes, topology, limit, zorder=3.0)
    final.show(frames[-1])
    final.mesh.set_gid("final flap")
    jaws = JawArtist(axes, scene)
    jaws.show(frames[-1].jaws)
    tracks = np.array([f.jaws for f in frames]).reshape(-1, 2, 2) * MM
    for side in (0, 1):
        axes.plot(*tracks[:, side].T, color=STEEL, linewidth=1.0, linestyle=(0, (1, 1.5)), zorder=2.8)
    outline = np.asarray(frames[-1].points)[topology.outline]
    shade = hidden_region(outline, scene.line_of_sight.camera) * MM
    axes.add_patch(Polygon(shade, facecolor=HIDDEN_VEIL, edgecolor="none", zorder=2.3))
    reach = float(shade[-1, 0])  # the bed is hidden from here to the fixed end
    if reach / 2 - scene.line_of_sight.target[0] * MM > 4.0:
        bed_note(axes, reach / 2, "hidden", GREY)
    axes.set_xlabel("mm from the fixed end")
    axes.set_ylabel("mm above the bed" if scene.bed else "mm above B")
    axes.yaxis.set_label_coords(-0.045, 0.5)
    axes.set_title(
        "How the flap moves: at rest and on the way (pale), at the end (full colour). "
        "Green must be clear of tissue, grey stays hidden.", pad=6,
    )  # fmt: skip
