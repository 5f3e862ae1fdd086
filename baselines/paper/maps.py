"""Tables of numbers as coloured maps, every cell with its number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from baselines.pictures.drawing import HATCHED
from retract_env.drawing.palette import INK

Array = NDArray[np.float64]


def draw_map(
    axes: Axes,
    values: Array,
    columns: Sequence[str],
    rows: Sequence[str],
    colours: Colormap,
    norm: Normalize,
    form: str,
    size: float = 8.5,
) -> None:
    """values: (r, c), the first row at the bottom; nan is hatched. form: of the numbers, size: theirs, pt."""
    axes.imshow(np.ma.masked_invalid(values), origin="lower", cmap=colours, norm=norm, aspect="auto")
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for (r, c), value in np.ndenumerate(values):
        if np.isnan(value):
            axes.add_patch(Rectangle((c - 0.5, r - 0.5), 1, 1, **HATCHED))
            continue
        red, green, blue, _ = colours(norm(value))
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        axes.text(
            c, r, format(value, form), ha="center", va="center", color="white" if dark else INK, fontsize=size
        )
