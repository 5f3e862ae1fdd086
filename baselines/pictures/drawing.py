"""What the still picture and the animation share: flap, jaws, surroundings, histories. Drawn in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Affine2D
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from baselines.pictures.labels import name_level
from baselines.pictures.steps import drawn_out
from retract_env.drawing.gauges import needed_friction
from retract_env.drawing.palette import (
    GREY,
    GROUND,
    HATCH,
    INK,
    LIMIT,
    SIGHT,
    STEEL,
    STRAIN,
    TISSUE,
    VALUE,
    VEIN,
    VEIN_EDGE,
    WEDGE,
    WHITE,
)
from retract_env.drawing.shapes import JawShapes, SectionTopology, sight_reach

if TYPE_CHECKING:
    from planners.certify import Certificate
    from retract_env.mesh import SectionMesh
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene, Tissue

Array = NDArray[np.float64]

MM = MN = 1e3
"""mm in a metre"""
KPA_PER_MM = 1e-6
"""kPa/mm in a Pa/m"""

STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK, "text.usetex": False,
    "text.parse_math": False,  # a $ in a scene's name is one
    "axes.edgecolor": GREY, "axes.labelcolor": INK, "axes.linewidth": 0.8, "axes.unicode_minus": True,
    "axes.spines.top": False, "axes.spines.right": False,
    "axes.titlelocation": "left", "axes.titlesize": 9.5, "axes.titlecolor": INK,
    "xtick.color": GREY, "ytick.color": GREY, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
    "figure.facecolor": "white", "savefig.bbox": None, "path.simplify": True, "hatch.linewidth": 0.6,
}  # fmt: skip
HATCHED: Any = {"facecolor": GROUND, "edgecolor": HATCH, "hatch": "////", "linewidth": 0}
NOTE_BOX = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.9}
HALO = [withStroke(linewidth=2.5, foreground="white")]
BED, WALL, MARGIN = 0.08, 0.12, 0.06  # of the flap's length


def strain_map(fade: float = 0.0) -> Colormap:
    """Perceptually uniform, pale when relaxed, dark at the limit; fade in [0, 1] blends with white."""
    colours = STRAIN / 255
    return ListedColormap(colours + fade * (1.0 - colours), name=f"strain{fade:g}")


class FlapArtist:
    """One flap coloured by strain up to `limit`, with outline and veins; show() moves it to another state."""

    def __init__(
        self,
        axes: Axes,
        topology: SectionTopology,
        limit: float,
        fade: float = 0.0,
        zorder: float = 3.0,
        straight: bool = False,
    ) -> None:
        """straight: whether to draw the elements' edges straight, which is faster."""
        self._topology = topology
        zeros = np.zeros(len(topology.nodes))
        faces = topology.straight if straight else topology.faces
        self._triangulation = Triangulation(zeros, zeros, faces)
        self.mesh = TriMesh(self._triangulation, cmap=strain_map(fade), zorder=zorder)
        self.mesh.set_clim(0.0, limit)
        self.mesh.set_array(zeros)
        soft = 1.0 - 0.7 * fade
        line: dict[str, Any] = {"alpha": soft, "solid_capstyle": "round", "solid_joinstyle": "round"}
        self.veins = Line2D([], [], color=VEIN_EDGE, linewidth=0.9 * soft, zorder=zorder + 0.1, **line)
        self.outline = Line2D([], [], color=INK, linewidth=1.1 * soft, zorder=zorder + 0.2, **line)
        self.artists = (self.mesh, self.veins, self.outline)
        axes.add_collection(self.mesh, autolim=False)
        axes.add_line(self.veins)
        axes.add_line(self.outline)

    def show(self, state: TissueState) -> None:
        """Draw this state from now on."""
        points = np.asarray(state.points) * MM
        self._triangulation.x, self._triangulation.y = points[self._topology.nodes].T
        self.mesh.set_array(self._topology.smooth(np.asarray(state.strain)))
        # one line with gaps draws far faster than many short ones
        self.veins.set_data(*self._topology.vein_lines(points).T)
        self.outline.set_data(*points[self._topology.outline].T)


class JawArtist:
    """The gripper's two pads and the fingers behind them, which ghosts go without."""

    def __init__(self, axes: Axes, scene: Scene, fade: float = 0.0, zorder: float = 5.0) -> None:
        self._shapes = JawShapes(scene)
        look: dict[str, Any] = {"edgecolor": WHITE, "linewidth": 0.6, "alpha": 1.0 - fade, "closed": True}
        blank, fingers = np.zeros((1, 2)), 2 if fade == 0 else 0
        self.pads = [Polygon(blank, facecolor=INK, zorder=zorder + 0.1, **look) for _ in range(2)]
        self.fingers = [Polygon(blank, facecolor=STEEL, zorder=zorder, **look) for _ in range(fingers)]
        for patch in (*self.fingers, *self.pads):
            axes.add_patch(patch)
        above = Rectangle((-1e4, 0.0), 2e4, 1e4, transform=axes.transData)
        for finger in self.fingers if scene.bed else ():  # the bed hides what reaches below it
            finger.set_clip_path(above)
        self.artists = (*self.fingers, *self.pads)

    def show(self, jaws: Array) -> None:
        """jaws: (4,) m, x1, y1, x2, y2 of the lower and the upper jaw."""
        fingers, pads = self._shapes.at(jaws)
        for patch, shape in zip(self.artists, (*fingers[: len(self.fingers)], *pads), strict=True):
            patch.set_xy(shape[:-1] * MM)


def draw_flap_at_rest(axes: Axes, tissue: Tissue) -> None:
    """The flap before anything happens, with its veins, mm."""
    length, height = tissue.length * MM, tissue.height * MM
    axes.add_patch(
        Rectangle((-length, 0), length, height, facecolor=TISSUE, edgecolor=INK, linewidth=1.1, zorder=1)
    )
    for vein in tissue.veins:
        outline = np.array(vein.outline) * MM
        axes.add_patch(Polygon(outline, facecolor=VEIN, edgecolor=VEIN_EDGE, linewidth=0.9, zorder=2))


def view_limits(scene: Scene, frames: Sequence[TissueState]) -> tuple[float, float, float, float]:
    """x0, x1, y0, y1 in mm that hold the flap in all frames, the jaws, bed and fixed end."""
    tissue = scene.tissue
    shapes = [np.asarray(f.points) for f in frames] + [np.asarray(f.jaws).reshape(2, 2) for f in frames]
    spread = np.vstack([*shapes, [(-tissue.length, tissue.height)]])
    spread = spread[np.isfinite(spread).all(axis=1)] * MM
    (left, low), (right, top) = spread.min(axis=0), spread.max(axis=0)
    length = tissue.length * MM
    left, right = left - MARGIN * length, max(right + 0.02 * length, WALL * length)
    ground = -BED * length if scene.bed else min(-BED * length, low - MARGIN * length)
    return left, right, ground, max(top + 0.1 * length, 0.45 * (right - left))


def draw_surroundings(
    axes: Axes, scene: Scene, limits: tuple[float, float, float, float], clear: bool = True
) -> list[Artist]:
    """Bed, fixed end, line of sight AB, the region below it that tissue must leave, the area of interest.

    clear: whether the flap ends above AB; the line's label goes on the other side.
    Returns what lies over the flap.
    """
    x0, x1, y0, y1 = limits
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    axes.set_aspect("equal")
    axes.set_yticks([t for t in axes.get_yticks() if (0 if scene.bed else y0) <= t <= y1])
    line, height, length = scene.line_of_sight, scene.tissue.height * MM, scene.tissue.length * MM
    camera, target = np.array(line.camera) * MM, np.array(line.target) * MM
    distance = float(np.linalg.norm(camera - target))
    away = (camera - target) / distance
    inside = 0.04 * length
    end = target + sight_reach(target, away, distance, x0 + inside, y1 - inside) * away
    far = 1e2 * length
    wedge = np.array([target, target + far * away, (x0 - far, far), (x0 - far, 0.0)])
    axes.add_patch(Polygon(wedge, facecolor=WEDGE, edgecolor="none", zorder=0.5))
    if scene.bed:
        axes.add_patch(Rectangle((x0, y0), x1 - x0, -y0, zorder=2.4, **HATCHED))
        axes.plot([x0, x1], [0, 0], color=GREY, linewidth=1.0, zorder=2.5)
    axes.add_patch(Rectangle((0, 0), x1, height, zorder=2.4, **HATCHED))
    seen = np.array([(-length, target[0]), (-0.008 * length, -0.008 * length)])
    axes.plot(*seen, color=SIGHT, linewidth=4.0, solid_capstyle="butt", zorder=2.6)
    bed_note(axes, float(seen[0].mean()), "area of interest", SIGHT)
    bed_note(axes, target[0], "B", SIGHT, weight="bold")
    axes.text(x1 / 2, height / 2, "fixed\nend", ha="center", va="center", zorder=2.7, bbox=NOTE_BOX)
    aside = np.array([-away[1], away[0]]) * (1.0 if clear else -1.0)
    x, y = end + length * (0.02 * aside - 0.03 * away)
    name = axes.text(
        x, y, f"to camera A, {distance:.0f} mm", color=SIGHT, zorder=4.65, ha="left",
        va="center", rotation=-float(np.degrees(np.arctan2(away[1], -away[0]))), rotation_mode="anchor",
        path_effects=HALO,
    )  # fmt: skip
    tip = MarkerStyle("^", transform=Affine2D().rotate(float(np.arctan2(-away[0], away[1]))))
    return [
        *axes.plot([0, 0], [0, height], color=INK, linewidth=2.2, solid_capstyle="butt", zorder=4.5),
        *axes.plot(*np.array([target, end]).T, color=SIGHT, linewidth=1.6, zorder=4.6),
        *axes.plot(*end, marker=tip, color=SIGHT, markersize=8, zorder=4.6),
        name,  # the flap passes below it
        *axes.plot(target[0], 0.0, "o", color=SIGHT, markersize=6, markeredgecolor="white", zorder=4.7),
    ]


def bed_note(axes: Axes, x: float, text: str, colour: str, **look: Any) -> None:
    """A word in the bed below x, mm."""
    y = 0.58 * axes.get_ylim()[0]
    axes.text(x, y, text, color=colour, ha="center", va="center", zorder=2.7, bbox=NOTE_BOX, **look)


def drawn_frames(certificate: Certificate) -> tuple[tuple[TissueState, ...], SectionMesh]:
    """The states to draw and their mesh. Raises ValueError where the certificate came from a file without."""
    if not certificate.frames or certificate.section is None:
        raise ValueError("nothing to draw: the certificate holds no frames")
    return certificate.frames, certificate.section


def squeeze_end(frames: Sequence[TissueState]) -> int:
    """Index of the last frame of the squeeze."""
    return max(0, sum(f.progress <= 1.0 + 1e-9 for f in frames) - 1)


def path_steps(frames: Sequence[TissueState]) -> Array:
    """(n,) how far along the path each frame is, in waypoints, as `drawn_out`."""
    return drawn_out([frame.progress for frame in frames])


def draw_histories(
    axes: Sequence[Axes], certificate: Certificate, colour: str = VALUE
) -> list[tuple[Array, Array]]:
    """Strain, needed friction and clearance along the path with their limits, on three axes.

    Returns the three curves, (n,) steps as `path_steps` and (n,) values. Friction without bound is drawn at
    the top.
    """
    frames = certificate.frames
    steps = path_steps(frames)
    strain = np.array([f.worst_strain for f in frames])
    friction = np.array([needed_friction(f) for f in frames])
    clearance = np.array([f.clearance for f in frames]) * MM
    friction_limit = certificate.friction_limit
    asked = certificate.clearance_limit * MM
    top = 1.3 * max(friction_limit, np.max(friction, where=np.isfinite(friction), initial=0.0))
    lifted = np.isinf(friction)
    drawn = np.where(lifted, top, friction)
    rows = (
        ("Strain of the worst 1 %", strain, certificate.strain_limit, f"limit {certificate.strain_limit:g}"),
        ("Friction needed to hold", drawn, friction_limit, f"limit {friction_limit:g}"),
        ("Clearance to line AB, mm", clearance, asked, f"in view above {asked:g}"),
    )
    turn = float(steps[squeeze_end(frames)])
    for ax, (title, values, limit, text) in zip(axes, rows, strict=True):
        ax.set_title(title, pad=5)
        ax.axvspan(0, turn, facecolor=GROUND, zorder=0)
        ax.axhline(limit, color=LIMIT, linewidth=1.3, linestyle=(0, (5, 3)), zorder=2)
        marker = "o" if len(steps) == 1 else None
        ax.plot(steps, values, color=colour, marker=marker, linewidth=2.0, zorder=3, solid_capstyle="round")
        last = max(float(steps[-1]), 1.0)
        ax.set_xlim(0, 1.03 * last)
        ax.xaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
        ax.set_xlabel("step of the path (shaded: squeeze)", labelpad=2)
        known = values[np.isfinite(values)]
        low, high = float(known.min(initial=0.0)), float(known.max(initial=limit))
        room = high - low or 1.0
        ax.set_ylim(low - 0.08 * room if low < 0 else 0.0, high + 0.25 * room)
        name_level(
            ax, np.column_stack((steps, values)), limit, text, 8.5, color=LIMIT, path_effects=HALO, zorder=2.5
        )  # fmt: skip
    axes[1].plot(steps[lifted], drawn[lifted], "^", color=LIMIT, markersize=6, zorder=3.5)
    return [(steps, values) for _, values, _, _ in rows]
