"""A planned retraction as a short film: GIF everywhere, MP4 where imageio-ffmpeg is installed."""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from baselines.jobs.files import written_whole
from baselines.pictures.drawing import (
    STYLE,
    FlapArtist,
    JawArtist,
    draw_histories,
    draw_surroundings,
    drawn_frames,
    path_steps,
    squeeze_end,
    strain_map,
    view_limits,
)
from baselines.pictures.steps import shown_frames
from baselines.pictures.still import heading, verdict
from retract_env.drawing.palette import GREY, LIMIT, PALE_VALUE, SIGHT, VALUE
from retract_env.drawing.shapes import SectionTopology

if TYPE_CHECKING:
    from planners.base import Plan

Array = NDArray[np.float64]

DPI, WIDTH_PX = 100, 800
PAUSE_S = 2.0


def animate_retraction(plan: Plan, path: str | Path, fps: int = 20) -> None:
    """Write the motion as .gif or .mp4, by the name's ending, 800 pixels wide, of at most 60 increments.

    Raises ValueError for another ending, for fps outside [1, 50] (what a GIF can time), for a certificate
    without frames, and for .mp4 where imageio-ffmpeg is missing. The file appears whole or not at all.
    """
    path = Path(path)
    data = film(plan, path.suffix.lower().removeprefix("."), fps)
    with written_whole(path) as temporary:
        temporary.write_bytes(data)


def film(plan: Plan, kind: str, fps: int = 20) -> bytes:
    """What animate_retraction writes, kind: gif or mp4. Raises ValueError as it does."""
    if kind not in ("gif", "mp4"):
        raise ValueError(f"animation .{kind}: the name must end in .gif or .mp4")
    if not 1 <= fps <= 50:
        raise ValueError(f"fps = {fps:g}, allowed [1, 50]")
    if kind == "mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ValueError("writing .mp4 needs imageio-ffmpeg: pip install imageio-ffmpeg, or choose .gif")
    with matplotlib.rc_context(STYLE):
        images = list(animation_images(plan))
    return _gif(images, fps) if kind == "gif" else _mp4(images, fps)


def animation_images(plan: Plan) -> Iterator[Image.Image]:
    """Yield images 800 pixels wide, one per shown increment. The still parts are drawn once."""
    certificate, scene = plan.certificate, plan.scene
    frames, section = drawn_frames(certificate)
    limits = view_limits(scene, frames)
    left, right, below, strip, title = 52, 76, 48, 96, 62  # pixels
    inner = WIDTH_PX - left - right
    tall = inner * (limits[3] - limits[2]) / (limits[1] - limits[0])
    bottom = below + strip + 62
    height = 16 * round((bottom + tall + title) / 16)  # video encoders want multiples of 16
    figure = Figure(figsize=(WIDTH_PX / DPI, height / DPI), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)

    def panel(left: float, bottom: float, wide: float, tall: float) -> Axes:  # pixels
        return figure.add_axes((left / WIDTH_PX, bottom / height, wide / WIDTH_PX, tall / height))

    axes = panel(left, bottom, inner, tall)
    over = draw_surroundings(axes, scene, limits, clear=frames[-1].clearance >= 0)
    axes.set_xlabel("mm from the fixed end", fontsize=8.5, labelpad=1)
    figure.text(left / WIDTH_PX, 1 - 26 / height, heading(plan), fontsize=13, weight="bold")
    limit = certificate.strain_limit
    bar = panel(WIDTH_PX - right + 10, bottom + 0.4 * tall, 12, 0.58 * tall)
    figure.colorbar(ScalarMappable(Normalize(0.0, limit), strain_map()), cax=bar)
    bar.set_ylabel("strain, up to its limit", fontsize=8.5)
    gap = 44
    wide = (WIDTH_PX - left - 24 - 2 * gap) / 3
    plots = [panel(left + i * (wide + gap), below, wide, strip) for i in range(3)]
    curves = draw_histories(plots, certificate, colour=PALE_VALUE)

    flap = FlapArtist(axes, SectionTopology(section, plan.scene.tissue.veins), limit, straight=True)
    jaws = JawArtist(axes, scene)
    traces = [ax.plot([], [], color=VALUE, linewidth=2.2, zorder=4)[0] for ax in plots]
    dot_look: Any = {"color": VALUE, "markersize": 5.5, "markeredgecolor": "white", "zorder": 5}
    dots = [ax.plot([], [], "o", **dot_look)[0] for ax in plots]
    now = figure.text(left / WIDTH_PX, 1 - 48 / height, "", fontsize=9.5, color=GREY)
    moving: list[Artist] = [*flap.artists, *jaws.artists, *over, *traces, *dots]
    moving.sort(key=lambda artist: artist.get_zorder())
    for artist in (*moving, now):
        artist.set_animated(True)
    canvas.draw()
    blank = still = canvas.copy_from_bbox(figure.bbox)
    turn = squeeze_end(frames)
    for index in shown_frames(path_steps(frames)):
        state = frames[index]
        flap.show(state)
        jaws.show(state.jaws)
        for (steps, values), trace, dot in zip(curves, traces, dots, strict=True):
            trace.set_data(steps[: index + 1], values[: index + 1])
            dot.set_data(steps[index : index + 1], values[index : index + 1])
        last = index == len(frames) - 1
        phase = "squeezing the flap" if index < turn else "moving the flap out of view"
        words = verdict(plan) if last else phase
        if words != now.get_text():
            now.set(text=words, color=(SIGHT if certificate.certified else LIMIT) if last else GREY)
            canvas.restore_region(blank)
            figure.draw_artist(now)
            still = canvas.copy_from_bbox(figure.bbox)
        canvas.restore_region(still)
        for artist in moving:
            figure.draw_artist(artist)
        drawn = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
        yield drawn.convert("RGB")


def _gif(images: list[Image.Image], fps: int) -> bytes:
    # One palette for all frames, so that still parts never flicker: white, the strain map, and what a few
    # frames show, without off-whites, which Pillow would take for white.
    some = np.vstack(
        [np.asarray(images[i])[::2, ::2] for i in np.linspace(0, len(images) - 1, 5).astype(int)]
    )
    strains = strain_map()(np.linspace(0.0, 1.0, 95))[:, :3] * 255
    sampled = Image.fromarray(some).quantize(160, method=Image.Quantize.MEDIANCUT).getpalette()
    shown = np.array(sampled).reshape(-1, 3)[:160]
    colours = np.vstack(([(255, 255, 255)], strains.round(), shown[shown.min(axis=1) < 240]))
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.astype(np.uint8).tobytes())
    paged = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    frame = round(1000 / fps)
    data = io.BytesIO()
    paged[0].save(
        data, format="GIF", save_all=True, append_images=paged[1:], loop=0, optimize=False, disposal=1,
        duration=[frame] * (len(paged) - 1) + [frame + round(PAUSE_S * 1000)],
    )  # fmt: skip
    return data.getvalue()


def _mp4(images: list[Image.Image], fps: int) -> bytes:
    import imageio.v3 as imageio

    held = [np.asarray(image) for image in images + [images[-1]] * round(PAUSE_S * fps)]
    data = imageio.imwrite(
        "<bytes>", np.stack(held), extension=".mp4", plugin="FFMPEG", fps=fps, macro_block_size=16
    )
    return bytes(data or b"")
