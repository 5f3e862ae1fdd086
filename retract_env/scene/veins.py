"""What a vein may look like: rules that keep the mesh conforming to it sound, and the mesher from failing.

* At least three vertices, no crossing, no edge below 1 um, no corner or notch sharper than 5 degrees, and a
  mean thickness (twice area over perimeter) of at least 0.05 mm.
* At least 0.05 mm between two veins: veins that touch or overlap are to be drawn as one.
* At most 500 veins of at most 1000 vertices. Every pair of veins is compared, so that many more take minutes.
* Inside the flap. Whole edges may lie on the flap's own outline, which allows layers and strips; the edges
  beside them leave it at 5 degrees or more, and all other vertices keep 0.05 mm away from it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from retract_env.config import point_text, refusal

# shapely is imported where it is used: it takes longer to import than all else that a scene needs

Outline = tuple[tuple[float, float], ...]
"""(k, 2) m, polygon in the x-y section."""

MOST_VEINS, MOST_VERTICES = 500, 1000
MIN_GAP = 5e-5  # m, between veins, and between a vein and the flap's outline unless an edge lies on it
MIN_EDGE = 1e-6  # m; netgen spends hundreds of elements on an edge of 1 um and fails at 0.01 um
MIN_CORNER = math.radians(5.0)  # rad; netgen passes 1 degree, with as bad triangles, and fails at 0.1
SNAP = 1e-9  # m, closer than this to the flap's outline is on it: rounding, not drawing


def simple(outline: Outline) -> Outline:
    """Outline if a vein may have it, counter-clockwise from its first vertex, without a closing vertex.

    Raises a `refusal` of the field.
    """
    if len(outline) > 1 and outline[0] == outline[-1]:
        outline = outline[:-1]
    distinct = len(set(outline))
    if distinct < 3:
        raise refusal(f": {distinct} distinct vertices, allowed at least 3")
    before, after = outline[-1:] + outline[:-1], outline[1:] + outline[:1]
    for i, (p, q) in enumerate(zip(outline, after, strict=True)):
        if (edge := math.dist(p, q)) < MIN_EDGE:
            raise refusal(f"[{i}]: {edge:.2g} m from the next vertex, allowed at least {MIN_EDGE:g} m")

    import shapely

    polygon = shapely.polygons(outline)
    if not shapely.is_valid(polygon):
        if shapely.convex_hull(polygon).area < MIN_EDGE * polygon.length:
            raise refusal(": the polygon has no area")
        where = re.search(r"\[(\S+) (\S+)\]", shapely.is_valid_reason(polygon))
        near = f" near {point_text(float(where[1]), float(where[2]))}" if where else ""
        raise refusal(f": the polygon crosses or touches itself{near}")
    thickness = 2.0 * polygon.area / polygon.length
    if thickness < MIN_GAP - SNAP:
        raise refusal(f": mean thickness {thickness:.2g} m, allowed at least {MIN_GAP:g} m")
    for i, (o, p, q) in enumerate(zip(before, outline, after, strict=True)):
        back, ahead = math.atan2(o[1] - p[1], o[0] - p[0]), math.atan2(q[1] - p[1], q[0] - p[0])
        if abs(math.remainder(ahead - back, math.tau)) < MIN_CORNER:
            raise refusal(f"[{i}]: corner sharper than {math.degrees(MIN_CORNER):g} degrees")
    return outline if polygon.exterior.is_ccw else (outline[0], *outline[:0:-1])


def fitted(outlines: Sequence[Outline], length: float, height: float) -> list[Outline]:
    """Outlines in a flap of length x height m, what lies on the flap's own outline put there exactly.

    Raises a `refusal` of the field that holds the veins.
    """
    faults: list[str] = []
    fits = []
    for i, outline in enumerate(outlines):
        try:
            fits.append(_fit(outline, length, height))
        except ValueError as fault:
            faults.append(f"[{i}]{fault}")
            fits.append(outline)

    import shapely

    polygons = [shapely.polygons(outline) for outline in fits]
    pairs = shapely.STRtree(polygons).query(polygons, predicate="dwithin", distance=MIN_GAP - SNAP)
    for j, i in sorted(zip(*pairs.tolist(), strict=True)):
        if i < j:
            gap = shapely.distance(polygons[i], polygons[j])
            apart = f"is {gap:.2g} m from" if gap > 0 else "overlaps or touches"
            faults.append(f"[{j}]: {apart} veins[{i}], allowed at least {MIN_GAP:g} m between them")
    if faults:
        raise refusal(*faults)
    return fits


def _fit(outline: Outline, length: float, height: float) -> Outline:
    """Outline, vertices on the flap's own outline put there exactly. Raises ValueError with the fault."""
    points = [list(point) for point in outline]
    ends = (("free end", 0, -length, 1), ("fixed end", 0, 0.0, -1))
    for side, axis, at, inward in (("bottom", 1, 0.0, 1), ("top", 1, height, -1), *ends):
        off = [inward * (point[axis] - at) for point in outline]
        if min(off) >= MIN_GAP - SNAP:
            continue
        if min(off) < -SNAP:
            i = off.index(min(off))
            inside = f"x in [{-length:g}, 0] m, y in [0, {height:g}] m"
            raise ValueError(
                f": vertex {i} at {point_text(*outline[i])} is outside the flap, allowed {inside}"
            )
        for i, here in enumerate(off):
            there = off[(i + 1) % len(off)]
            near, far = min(here, there), max(here, there)
            if SNAP < near < MIN_GAP - SNAP:
                way = f"allowed at least {MIN_GAP:g} m, or 0 m for a whole edge"
                raise ValueError(f": {near:.2g} m from the {side} of the flap, {way}")
            if near <= SNAP < far < math.sin(MIN_CORNER) * math.dist(outline[i], outline[(i + 1) % len(off)]):
                least = math.degrees(MIN_CORNER)
                raise ValueError(f": leaves the {side} of the flap at less than {least:g} degrees")
            if here <= SNAP:
                points[i][axis] = at
                if off[i - 1] > SNAP and there > SNAP:
                    raise ValueError(f": touches the {side} of the flap with one vertex, allowed whole edges")
    return tuple((x, y) for x, y in points)
