"""What is to be retracted: the flap and its veins, the line of sight, the limits, the jaws. Sec. III and V.

Frame: at rest the flap fills x in [-length, 0], y in [0, height]; x = 0 is fixed, y = 0 is the bed, gravity
acts along -y, the camera looks from the upper left. SI units; angles in radians.

Every error is a `SceneError` of one line that names the field, the value and what is allowed, as in
`tissue.height = -0.0044 m, allowed (0, 0.05] m`. What a vein may look like is said in `veins`, random scenes
are drawn in `sampling`.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import ValidationInfo, field_validator, model_validator

from retract_env.config import (
    Flag,
    Frozen,
    Name,
    Paired,
    Range,
    config_file,
    listed,
    one_of,
    point_text,
    read_yaml,
    refusal,
)
from retract_env.errors import ConfigError, SceneError
from retract_env.scene.bounds import (
    CAMERA_DISTANCE,
    CAMERA_HEIGHTS,
    DEPTHS,
    HEIGHTS,
    LENGTHS,
    MODULI,
    SLOPES,
)
from retract_env.scene.uncertainty import Uncertainty
from retract_env.scene.veins import MOST_VEINS, MOST_VERTICES, Outline, fitted, simple

if TYPE_CHECKING:
    from os import PathLike

    # numpy takes longer to import than all else here
    import numpy as np

    from retract_env.scene.sampling import SceneRanges

Coordinate = Annotated[float, Range(-10.0, 10.0, "m")]
Vertex = Annotated[tuple[Coordinate, Coordinate], Paired]
Modulus = Annotated[float, MODULI]
Poisson = Annotated[float, Range(0.0, 0.49)]
Camera = Annotated[tuple[Coordinate, Annotated[float, CAMERA_HEIGHTS]], Paired]
Target = Annotated[tuple[Coordinate, Annotated[float, Range(0.0, 0.0, "m")]], Paired]


class _Part(Frozen):
    """Constructors and `from_data` raise `SceneError`."""

    error_type: ClassVar[type[ConfigError]] = SceneError


class Vein(_Part):
    """Stiffer body embedded in the flap, extruded along the depth.

    `retract_env.scene.veins` says which outlines are accepted. A closing vertex that repeats the first is
    dropped, and the order becomes counter-clockwise, beginning at the same vertex.
    """

    outline: Annotated[tuple[Vertex, ...], listed(MOST_VERTICES)]
    """(k, 2) m, polygon in the x-y section."""
    modulus: Modulus
    """Young's modulus, Pa."""
    poisson: Poisson = 0.45

    @field_validator("outline")
    @classmethod
    def _is_simple(cls, outline: Outline) -> Outline:
        return simple(outline)


class Tissue(_Part):
    """The flap: a block of soft tissue with veins along its depth. Values of the paper: Sec. V."""

    length: Annotated[float, LENGTHS]
    height: Annotated[float, HEIGHTS]
    depth: Annotated[float, DEPTHS]
    density: Annotated[float, Range(0.0, 2e4, "kg/m^3")]
    modulus: Modulus
    """Young's modulus, Pa."""
    poisson: Poisson
    veins: Annotated[tuple[Vein, ...], listed(MOST_VEINS)] = ()

    @field_validator("veins")
    @classmethod
    def _fit_in_the_flap(cls, veins: tuple[Vein, ...], info: ValidationInfo) -> tuple[Vein, ...]:
        if not veins or "length" not in info.data or "height" not in info.data:
            return veins  # a fault of the length or height is reported by itself
        outlines = fitted([vein.outline for vein in veins], info.data["length"], info.data["height"])
        return tuple(
            vein if outline == vein.outline else vein.model_copy(update={"outline": outline})
            for vein, outline in zip(veins, outlines, strict=True)
        )


class LineOfSight(_Part):
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
            raise refusal(f".camera[0]{fault} (no further right than the target)")
        return self

    @classmethod
    def at(cls, target_x: float, slope: float, distance: float = CAMERA_DISTANCE) -> LineOfSight:
        """Line to (target_x, 0) m that climbs at slope rad towards -x, the camera at distance m."""
        for name, value, allowed in (
            ("slope", slope, SLOPES),
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


class Limits(_Part):
    """What the tissue and the grasp bear. Sec. III-C."""

    strain: Annotated[float, Range(0.0, 1.0, "", "()")] = 0.5
    """eps_L, bound of eps_1%."""
    friction: Annotated[float, Range(0.0, 5.0, "", "(]")] = 0.5
    """mu, Coulomb coefficient of jaw on tissue."""
    clearance: Annotated[float, Range(0.0, 0.1, "m")] = 0.0
    """m, how far above the line of sight all has to be at the end."""


class Jaws(_Part):
    """The gripper's two rigid patches."""

    width: Annotated[float, Range(0.0, 0.125, "m", "()")] = 1e-3
    """Along x, m; below a quarter of the flap's length."""
    depth: Annotated[float, DEPTHS] | None = None
    """Along z, m, centred; None is the whole depth of the flap."""
    in_sight: Flag = False
    """Whether the tool hides the target as tissue does: pads and stems have to end above the line too."""
    thickness: Annotated[float, Range(0.0, 0.02, "m", "(]")] = 1e-3
    """m, of a pad, away from the tissue; it is as wide as the jaws."""
    stem: Annotated[float, Range(0.0, 0.1, "m")] = 5e-3
    """m, how far the stem reaches away from the tissue; it is half as wide as the pad is thick."""


class Material(_Part):
    """The hyperelastic law of tissue and veins; their moduli are those of small strain under any.

    "neo-hookean": W0 = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2. "fung", after Fung (1967), isotropic:
    W = mu/(2 b) (exp(2 b W0 / mu) - 1), which is as stiff at first, narrows as much when it is stretched, and
    has exp(2 b W0 / mu) times the stress: for b = 2, 8, 20, where nu = .45, it is 1.1, 1.6 and 3.3 times as
    much in tissue that is 15 % longer, and 1.6, 5.7 and 79 times where that is 25 % shorter.
    """

    law: Annotated[Literal["neo-hookean", "fung"], one_of(("neo-hookean", "fung"))] = "neo-hookean"
    stiffening: Annotated[float, Range(0.0, 20.0)] = 0.0
    """b, above 0 for "fung", 0 for "neo-hookean"."""

    @model_validator(mode="after")
    def _suits_the_law(self) -> Material:
        allowed = Range(0.0, 20.0, "", "(]") if self.law == "fung" else Range(0.0, 0.0)
        if (fault := allowed.fault(self.stiffening)) is not None:
            raise refusal(f".stiffening{fault} for law = {self.law!r}")
        return self


# `uncertainty` and `material` are new likewise, as wholes.
ADDED: dict[str, dict[str, Any]] = {
    "limits": {"clearance": 0.0},
    "jaws": {"in_sight": False, "thickness": 1e-3, "stem": 5e-3},
}
"""Fields that scenes have had since version 0.2, and their defaults, which leave a scene's hash as it was."""


class Scene(_Part):
    """One retraction problem."""

    name: Name
    tissue: Tissue
    line_of_sight: LineOfSight
    limits: Limits = Limits()
    jaws: Jaws = Jaws()
    gravity: Annotated[float, Range(0.0, 100.0, "m/s^2")] = 9.8
    """Along -y, m/s^2."""
    bed: Flag = True
    """Whether the flap lies on something at y = 0."""
    uncertainty: Uncertainty = Uncertainty()
    """What of all this, and of a plan, is not known."""
    material: Material = Material()

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
            faults.append(f".line_of_sight.camera = {point_text(x, y)}, inside the flap")
        if faults:
            raise refusal(*faults)
        return self

    def dump(self) -> dict[str, Any]:
        """Plain data: dicts, lists, numbers, texts; `from_data` and a YAML file take it back."""
        return self.model_dump(mode="json")

    @property
    def neo_hookean(self) -> bool:
        """Whether the tissue is of the law that every model knows."""
        return self.material == Material()

    def needs_neo_hookean(self, who: str) -> None:
        """Raise SceneError for another law, which `who` does not know."""
        if not self.neo_hookean:
            raise SceneError(f"material.law = {self.material.law!r}, allowed 'neo-hookean' {who}")

    @property
    def hash(self) -> str:
        """SHA-256, hex, of the values without the name; equal scenes on any machine have equal ones."""
        values = self.model_dump(mode="json", exclude={"name"})
        for name, whole in (("uncertainty", Uncertainty()), ("material", Material())):
            if getattr(self, name) == whole:
                del values[name]
        for part, added in ADDED.items():
            for name, default in added.items():
                if values[part][name] == default:
                    del values[part][name]
        return hashlib.sha256(json.dumps(values, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def load_scene(path: str | PathLike[str]) -> Scene:
    """Scene from a YAML file, its keys and units those of `Scene`, or a shipped one by its name.

    Raises SceneError, naming the file.
    """
    try:
        return Scene.from_data(read_yaml(config_file(path, "scenes")))
    except ConfigError as error:
        raise SceneError(f"{path}: {error}") from None


def sample_scene(rng: np.random.Generator, ranges: SceneRanges | None = None) -> Scene:
    """Random flap with irregular oval veins; the same rng state gives the same scene.

    `sampling` has the default ranges. Raises SceneError if the ranges lead to values that no scene may have,
    or to veins without room.
    """
    from retract_env.scene import sampling  # which builds on this module

    return sampling.sample_scene(rng, ranges)
