"""What is to be retracted: the flap and its veins, the line of sight, the limits, the jaws. Sec. III and V.

Frame: at rest the flap fills x in [-length, 0], y in [0, height]; x = 0 is fixed, y = 0 is the bed, gravity
acts along -y, the camera looks from the upper left. SI units; angles in radians.

Values are checked once, here, where they enter. Every error is a `SceneError` of one line that names the
field, the value and what is allowed, as in `tissue.height = -0.0044 m, allowed (0, 0.05] m`.

What a vein may look like follows from the mesh that conforms to it, and keeps the mesher from failing:

* at least three vertices, no crossing, no edge below 1 um, no corner or notch sharper than 5 degrees, and a
  mean thickness (twice area over perimeter) of at least 0.05 mm;
* at least 0.05 mm between two veins: veins that touch or overlap are to be drawn as one;
* inside the flap. Whole edges may lie on the flap's own outline, which allows layers and strips; the edges
  beside them leave it at 5 degrees or more, and all other vertices keep 0.05 mm away from it.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import re
import reprlib
from dataclasses import dataclass, fields
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError, core_schema

if TYPE_CHECKING:
    from os import PathLike

    # numpy and shapely take longer to import than all else here
    import numpy as np

MIN_GAP = 5e-5  # m, between veins, and between a vein and the flap's outline unless an edge lies on it
MIN_EDGE = 1e-6  # m; netgen spends hundreds of elements on an edge of 1 um and fails at 0.01 um
MIN_CORNER = math.radians(5.0)  # rad; netgen passes 1 degree, with as bad triangles, and fails at 0.1
SNAP = 1e-9  # m, closer than this to the flap's outline is on it: rounding, not drawing


class SceneError(ValueError):
    """A scene that cannot be used; the message is one line."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.splitlines()))


# --- Errors: a fault is what follows the path of its field: it starts with " = ", ": ", "[2]" or ".key"


def _fault(*lines: str) -> PydanticCustomError:
    return PydanticCustomError("scene", "{first}", {"first": lines[0], "lines": lines})


def _scene_error(error: ValidationError) -> SceneError:
    """The first three faults in one line, and how many there are besides."""
    lines = []
    for item in error.errors(include_url=False):
        path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in item["loc"])
        if item["type"] == "scene":
            lines += [(path or "scene" * line.startswith(" =")) + line for line in item["ctx"]["lines"]]
        else:
            lines.append(f"{path}: {'missing' if item['type'] == 'missing' else item['msg']}")
    shown = [line.removeprefix(".").removeprefix(": ") for line in lines[:3]]
    more = len(lines) - len(shown)
    return SceneError("; ".join(shown) + (f"; and {more} more" if more else ""))


def _shown(value: object) -> str:
    brief = reprlib.Repr()
    brief.maxstring = brief.maxother = 60
    try:
        return brief.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "a number of many digits"


def _point_text(x: float, y: float) -> str:
    return f"({x:.6g}, {y:.6g}) m"


# --- Values


@dataclass(frozen=True)
class Range:
    """Interval that a finite number has to lie in; `ends` says which ends belong to it."""

    low: float
    high: float
    unit: str = ""
    ends: str = "[]"

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g} {self.unit}".rstrip()
        return f"{self.ends[0]}{self.low:g}, {self.high:g}{self.ends[1]} {self.unit}".rstrip()

    def fault(self, value: object) -> str | None:
        """What is wrong with value, None if nothing is."""
        number = _float(value)
        if number is None:
            return f" = {_shown(value)}, not a number; allowed {self}"
        above = number > self.low if self.ends[0] == "(" else number >= self.low
        below = number < self.high if self.ends[1] == ")" else number <= self.high
        if above and below:  # both False for nan
            return None
        shown = _shown(value) if isinstance(value, int) else repr(number)
        return f" = {f'{shown} {self.unit}'.rstrip()}, allowed {self}"

    def check(self, value: object) -> float:
        """Value as a float. Raises what pydantic takes for a fault of the field."""
        if (fault := self.fault(value)) is not None:
            raise _fault(fault)
        return float(value) + 0.0  # type: ignore[arg-type]  # -0.0 becomes 0.0: equal scenes, equal hashes

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.check, handler(source))


def _float(value: object) -> float | None:
    """None for what is no number: texts and booleans too, which float() would take."""
    if isinstance(value, float):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _pair(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise _fault(f" = {_shown(value)}, not a point [x, y] in m")
    return value


def _listed(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple):
        raise _fault(f" = {_shown(value)}, not a list")
    return value


def _bool(value: Any) -> Any:
    if not isinstance(value, bool):
        raise _fault(f" = {_shown(value)}, not true or false")
    return value


def _name(value: Any) -> Any:
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= 100:
        raise _fault(f" = {_shown(value)}, not a text of 1 to 100 printable characters")
    return value


Coordinate = Annotated[float, Range(-10.0, 10.0, "m")]
Outline = tuple[tuple[float, float], ...]
Vertex = Annotated[tuple[Coordinate, Coordinate], BeforeValidator(_pair)]
Modulus = Annotated[float, Range(100.0, 1e8, "Pa")]
Poisson = Annotated[float, Range(0.0, 0.49)]
Camera = Annotated[tuple[Coordinate, Annotated[float, Range(1e-3, 10.0, "m")]], BeforeValidator(_pair)]
Target = Annotated[tuple[Coordinate, Annotated[float, Range(0.0, 0.0, "m")]], BeforeValidator(_pair)]


# --- The scene


class Frozen(BaseModel):
    """Immutable, hashable and picklable; constructors raise `SceneError`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _scene_error(error) from None

    # So marked, nested models are still validated in their parent's pass: paths are whole, all faults seen.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        known = list(cls.model_fields)
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise _fault(f" = {_shown(data)}, not a mapping; known keys: {', '.join(known)}")
        faults = []
        for key in data:
            if key not in known:
                shown = key if isinstance(key, str) and key.isidentifier() else _shown(key)
                close = difflib.get_close_matches(str(shown), known, n=1)
                guess = f", did you mean {close[0]}?" if close else ";"
                faults.append(f".{shown}: unknown key{guess} known keys: {', '.join(known)}")
        if faults:
            raise _fault(*faults)
        return data


class Vein(Frozen):
    """Stiffer body embedded in the flap, extruded along the depth.

    The module's docstring says which outlines are accepted. A closing vertex that repeats the first is
    dropped, and the order becomes counter-clockwise, beginning at the same vertex.
    """

    outline: Annotated[tuple[Vertex, ...], BeforeValidator(_listed)]
    """(k, 2) m, polygon in the x-y section."""
    modulus: Modulus
    """Young's modulus, Pa."""
    poisson: Poisson = 0.45

    @field_validator("outline")
    @classmethod
    def _is_simple(cls, outline: Outline) -> Outline:
        if len(outline) > 1 and outline[0] == outline[-1]:
            outline = outline[:-1]
        distinct = len(set(outline))
        if distinct < 3:
            raise _fault(f": {distinct} distinct vertices, allowed at least 3")
        before, after = outline[-1:] + outline[:-1], outline[1:] + outline[:1]
        for i, (p, q) in enumerate(zip(outline, after, strict=True)):
            if (edge := math.dist(p, q)) < MIN_EDGE:
                raise _fault(f"[{i}]: {edge:.2g} m from the next vertex, allowed at least {MIN_EDGE:g} m")

        import shapely

        polygon = shapely.polygons(outline)
        if not shapely.is_valid(polygon):
            if shapely.convex_hull(polygon).area < MIN_EDGE * polygon.length:
                raise _fault(": the polygon has no area")
            where = re.search(r"\[(\S+) (\S+)\]", shapely.is_valid_reason(polygon))
            near = f" near {_point_text(float(where[1]), float(where[2]))}" if where else ""
            raise _fault(f": the polygon crosses or touches itself{near}")
        thickness = 2.0 * polygon.area / polygon.length
        if thickness < MIN_GAP - SNAP:
            raise _fault(f": mean thickness {thickness:.2g} m, allowed at least {MIN_GAP:g} m")
        for i, (o, p, q) in enumerate(zip(before, outline, after, strict=True)):
            back, ahead = math.atan2(o[1] - p[1], o[0] - p[0]), math.atan2(q[1] - p[1], q[0] - p[0])
            if abs(math.remainder(ahead - back, math.tau)) < MIN_CORNER:
                raise _fault(f"[{i}]: corner sharper than {math.degrees(MIN_CORNER):g} degrees")
        return outline if polygon.exterior.is_ccw else (outline[0], *outline[:0:-1])


class Tissue(Frozen):
    """The flap: a block of soft tissue with veins along its depth. Values of the paper: Sec. V."""

    length: Annotated[float, Range(0.0, 0.5, "m", "(]")]
    height: Annotated[float, Range(0.0, 0.05, "m", "(]")]
    depth: Annotated[float, Range(0.0, 0.5, "m", "(]")]
    density: Annotated[float, Range(0.0, 2e4, "kg/m^3")]
    modulus: Modulus
    """Young's modulus, Pa."""
    poisson: Poisson
    veins: Annotated[tuple[Vein, ...], BeforeValidator(_listed)] = ()

    @field_validator("veins")
    @classmethod
    def _fit_in_the_flap(cls, veins: tuple[Vein, ...], info: ValidationInfo) -> tuple[Vein, ...]:
        if not veins or "length" not in info.data or "height" not in info.data:
            return veins  # a fault of the length or height is reported by itself
        faults: list[str] = []
        fitted = []
        for i, vein in enumerate(veins):
            try:
                outline = _fit(vein.outline, info.data["length"], info.data["height"])
            except ValueError as fault:
                faults.append(f"[{i}]{fault}")
                outline = vein.outline
            fitted.append(vein if outline == vein.outline else vein.model_copy(update={"outline": outline}))

        import shapely

        polygons = [shapely.polygons(vein.outline) for vein in fitted]
        pairs = shapely.STRtree(polygons).query(polygons, predicate="dwithin", distance=MIN_GAP - SNAP)
        for j, i in sorted(zip(*pairs.tolist(), strict=True)):
            if i < j:
                gap = shapely.distance(polygons[i], polygons[j])
                apart = f"is {gap:.2g} m from" if gap > 0 else "overlaps or touches"
                faults.append(f"[{j}]: {apart} veins[{i}], allowed at least {MIN_GAP:g} m between them")
        if faults:
            raise _fault(*faults)
        return tuple(fitted)


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
                f": vertex {i} at {_point_text(*outline[i])} is outside the flap, allowed {inside}"
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


class LineOfSight(Frozen):
    """From the camera A to the farthest point B of the area of interest, on the bed. Fig. 2, Sec. III-C.

    The tissue must end above the line, on the fixed end's side.
    """

    camera: Camera
    """A, (x, y) m, above the bed and not beyond the target."""
    target: Target
    """B, (x, 0) m."""

    @model_validator(mode="after")
    def _looks_towards_the_fixed_end(self) -> LineOfSight:
        if (fault := Range(-10.0, self.target[0], "m").fault(self.camera[0])) is not None:
            raise _fault(f".camera[0]{fault} (no further right than the target)")
        return self

    @classmethod
    def at(cls, target_x: float, slope: float, distance: float = 0.1) -> LineOfSight:
        """Line to (target_x, 0) m that climbs at slope rad towards -x, the camera at distance m."""
        for name, value, allowed in (
            ("slope", slope, Range(0.0, math.pi / 2, "rad", "(]")),
            ("distance", distance, Range(1e-3, 10.0, "m")),
        ):
            if (fault := allowed.fault(value)) is not None:
                raise SceneError(name + fault)
        camera = (target_x - distance * math.cos(slope), distance * math.sin(slope))
        return cls(camera=camera, target=(target_x, 0.0))

    @property
    def slope(self) -> float:
        """Angle between line and bed, rad, in (0, pi/2]; pi/4 climbs at 45 degrees towards -x."""
        return math.atan2(self.camera[1], self.target[0] - self.camera[0])


class Limits(Frozen):
    """What the tissue and the grasp bear. Sec. III-C."""

    strain: Annotated[float, Range(0.0, 1.0, "", "()")] = 0.5
    """eps_L, bound of eps_1%."""
    friction: Annotated[float, Range(0.0, 5.0, "", "(]")] = 0.5
    """mu, Coulomb coefficient of jaw on tissue."""


class Jaws(Frozen):
    """The gripper's two rigid patches."""

    width: Annotated[float, Range(0.0, 0.125, "m", "()")] = 1e-3
    """Along x, m; below a quarter of the flap's length."""
    depth: Annotated[float, Range(0.0, 0.5, "m", "(]")] | None = None
    """Along z, m, centred; None is the whole depth of the flap."""


class Scene(Frozen):
    """One retraction problem."""

    name: Annotated[str, BeforeValidator(_name)]
    tissue: Tissue
    line_of_sight: LineOfSight
    limits: Limits = Limits()
    jaws: Jaws = Jaws()
    gravity: Annotated[float, Range(0.0, 100.0, "m/s^2")] = 9.8
    """Along -y, m/s^2."""
    bed: Annotated[bool, BeforeValidator(_bool)] = True
    """Whether the flap lies on something at y = 0."""

    @model_validator(mode="after")
    def _parts_agree(self) -> Scene:
        tissue, (x, y) = self.tissue, self.line_of_sight.camera
        checks = [
            (".line_of_sight.target[0]", self.line_of_sight.target[0], Range(-tissue.length, 0.0, "m", "()")),
            (".jaws.width", self.jaws.width, Range(0.0, tissue.length / 4, "m", "()")),
        ]
        if self.jaws.depth is not None:
            checks.append((".jaws.depth", self.jaws.depth, Range(0.0, tissue.depth, "m", "(]")))
        found = [(field, allowed.fault(value)) for field, value, allowed in checks]
        faults = [field + fault for field, fault in found if fault is not None]
        if -tissue.length <= x <= 0 and y <= tissue.height:
            faults.append(f".line_of_sight.camera = {_point_text(x, y)}, inside the flap")
        if faults:
            raise _fault(*faults)
        return self

    @classmethod
    def from_data(cls, data: Any) -> Scene:
        """Scene from plain data, as `dump` gives it. Raises SceneError."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise _scene_error(error) from None

    def dump(self) -> dict[str, Any]:
        """Plain data: dicts, lists, numbers, texts; `from_data` and a YAML file take it back."""
        return self.model_dump(mode="json")

    @property
    def hash(self) -> str:
        """SHA-256, hex, of the values without the name; equal scenes on any machine have equal ones."""
        values = self.model_dump(mode="json", exclude={"name"})
        return hashlib.sha256(json.dumps(values, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


# --- From a file


class _Loader(yaml.SafeLoader):
    """YAML's safe subset in which keys do not repeat and 1e-3 is a number, as in YAML 1.2."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(None, None, f"key {key.value} given twice", key.start_mark)
                seen.add(key.value)
        return node


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def load_scene(path: str | PathLike[str]) -> Scene:
    """Scene from a YAML file, its keys and units those of `Scene`. Raises SceneError, naming the file."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        data = yaml.load(text, Loader=_Loader)
    except OSError as error:
        raise SceneError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not UTF-8 text (byte {error.start})") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
        raise SceneError(f"{path}: not readable as YAML{where}: {problem}") from None
    except (ValueError, RecursionError) as error:  # no such date, an endless integer, nesting too deep
        raise SceneError(f"{path}: not readable as YAML: {error}") from None
    if data is None:
        raise SceneError(f"{path}: the file is empty")
    try:
        return Scene.from_data(data)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


# --- By chance


@dataclass(frozen=True)
class SceneRanges:
    """What `sample_scene` draws from: (least, greatest) each, uniform unless said otherwise."""

    veins: tuple[int, int] = (0, 20)
    """How many; both ends occur."""
    vein_modulus: tuple[float, float] = (8e4, 4e5)
    """Pa, log-uniform, for each vein."""
    vein_width: tuple[float, float] = (0.25, 0.6)
    """Along x, before tilting, as a fraction of the flap's height; shrinks where there is no room."""
    vein_height: tuple[float, float] = (0.2, 0.55)
    """Along y, likewise."""
    tissue_modulus: tuple[float, float] = (4e4, 4e4)
    """Pa, log-uniform."""
    length: tuple[float, float] = (0.05, 0.05)
    """m."""
    height: tuple[float, float] = (4.4e-3, 4.4e-3)
    """m."""
    depth: tuple[float, float] = (4.4e-3, 4.4e-3)
    """m."""
    target: tuple[float, float] = (0.1, 0.4)
    """Distance of B from the fixed end, as a fraction of the length."""
    slope: tuple[float, float] = (math.radians(30.0), math.radians(70.0))
    """Of the line of sight, rad."""

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = getattr(self, field.name)
            if not 0 <= low <= high < math.inf:
                raise SceneError(f"{field.name} = ({low}, {high}), not a range from at least 0 upwards")


def sample_scene(rng: np.random.Generator, ranges: SceneRanges | None = None) -> Scene:
    """Random flap with irregular oval veins; the same rng state gives the same scene.

    Raises SceneError if the ranges lead to values that no scene may have, or to veins without room.
    """
    ranges = ranges or SceneRanges()

    def uniform(ends: tuple[float, float]) -> float:
        return float(rng.uniform(*ends))

    def log_uniform(ends: tuple[float, float]) -> float:
        return float(ends[0] * (ends[1] / ends[0]) ** rng.uniform())

    length, height, depth = uniform(ranges.length), uniform(ranges.height), uniform(ranges.depth)
    modulus = log_uniform(ranges.tissue_modulus)
    line = LineOfSight.at(-length * uniform(ranges.target), uniform(ranges.slope))
    count = int(rng.integers(ranges.veins[0], ranges.veins[1], endpoint=True))
    veins = [
        Vein(outline=outline, modulus=log_uniform(ranges.vein_modulus))
        for outline in _scatter(rng, count, length, height, ranges)
    ]
    tissue = Tissue(
        length=length,
        height=height,
        depth=depth,
        density=1000.0,
        modulus=modulus,
        poisson=0.45,
        veins=tuple(veins),
    )
    return Scene(name="sampled", tissue=tissue, line_of_sight=line)


def _scatter(
    rng: np.random.Generator, count: int, length: float, height: float, ranges: SceneRanges
) -> list[Outline]:
    """Ovals at random places, twice the least gap apart from each other and from the flap's outline."""
    import shapely

    gap, tries = 2 * MIN_GAP, 300
    placed: list[Outline] = []
    polygons: list[shapely.Polygon] = []
    for _ in range(count):
        for attempt in range(tries):
            shrink = 0.85 ** (attempt // 20)
            a, b = (shrink * height * rng.uniform(*of) / 2 for of in (ranges.vein_width, ranges.vein_height))
            oval = _oval(rng, a, b)
            (left, right), (low, high) = ((min(v) - gap, max(v) + gap) for v in zip(*oval, strict=True))
            if right - left > length or high - low > height:
                continue
            x, y = rng.uniform(-length - left, -right), rng.uniform(-low, height - high)
            outline = tuple((round(px + x, 6), round(py + y, 6)) for px, py in oval)
            polygon = shapely.polygons(outline)
            if not shapely.dwithin(polygon, polygons, gap).any():
                placed.append(outline)
                polygons.append(polygon)
                break
        else:
            flap = f"a flap of {length:g} x {height:g} m"
            raise SceneError(f"no room for vein {len(placed) + 1} of {count} in {flap}")
    return sorted(placed, key=min)  # numbered from the free end


def _oval(rng: np.random.Generator, a: float, b: float) -> Outline:
    """8 to 10 vertices around the origin, semi-axes about a and b m, dented and tilted a little."""
    corners = int(rng.integers(8, 10, endpoint=True))
    angles = (rng.uniform(-0.25, 0.25, corners) + range(corners)) * (math.tau / corners)
    radii = rng.uniform(0.85, 1.0, corners)
    tilt = rng.uniform(-0.35, 0.35)
    c, s = math.cos(tilt), math.sin(tilt)
    polar = zip(angles.tolist(), radii.tolist(), strict=True)
    ring = [(a * r * math.cos(t), b * r * math.sin(t)) for t, r in polar]
    return tuple((c * x - s * y, s * x + c * y) for x, y in ring)
