"""What is observed: one flat vector, and how good the sensors are that it comes from.

`LAYOUT` describes the vector; `SLICES` names its parts, so that nobody counts indices:
`observation[SLICES["gripper"]]`. Neither depends on how the task is configured, but for one bound: strain and
friction are observed up to the task's cap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from retract_env.config import Frozen, Listed, Range, one_of, refusal
from retract_env.mesh import SectionMesh
from retract_env.scene import Scene
from retract_env.spring import columns
from retract_env.task import rules
from retract_env.task.config import TaskConfig
from retract_env.task.rules import FORCES, KEYPOINTS, STIFFNESS_SAMPLES
from retract_env.task.situation import Situation

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.integer[Any]]


@dataclass(frozen=True)
class Part:
    """One part of the observation."""

    name: str
    size: int
    low: float
    high: float
    unit: str
    meaning: str


def layout(cap: float) -> tuple[Part, ...]:
    """The parts one after the other; cap: up to where strain and friction over their limits are observed."""
    return (
        Part("holding", 1, 0, 1, "", "0 until the grasp is chosen, 1 with closed jaws"),
        Part("time_left", 1, 0, 1, "all steps", "steps that are left"),
        Part("gripper", 2, -3, 3, "length", "midpoint of the jaws, x and y"),
        Part("angle", 2, -1, 1, "", "sine and cosine of the jaw axis' angle, from +y, counter-clockwise"),
        Part("separation", 1, 0, 2, "height", "distance between the jaws"),
        Part(
            "lower",
            2 * KEYPOINTS,
            -3,
            3,
            "length",
            "keypoints of the lower surface from the free end on, x y x y",
        ),
        Part("upper", 2 * KEYPOINTS, -3, 3, "length", "keypoints of the upper surface, likewise"),
        Part("target", 1, -1, 0, "length", "x of B, where the line of sight meets the bed"),
        Part("slope", 1, 0, 2, "rad", "angle between the line of sight and the bed"),
        Part("nearness", 1, 0, 10, "1 / length", "one over the distance from B to the camera"),
        Part(
            "k_eq",
            STIFFNESS_SAMPLES,
            0,
            10,
            "modulus / height",
            "stiffness along the flap from the free end on",
        ),
        Part("strain", 1, 0, cap, "limit", "eps_1% now"),
        Part("max_strain", 1, 0, cap, "limit", "greatest eps_1% so far"),
        Part("friction", 2, 0, cap, "limit", "friction that the lower and the upper jaw need now"),
        Part("max_friction", 1, 0, cap, "limit", "greatest friction needed so far"),
        Part("clearance", 1, -3, 3, "length", "signed distance of the lowest tissue to the line of sight"),
        Part("exposure", 1, 0, 1, "", "fraction of the area of interest that the camera sees"),
        Part(
            "forces",
            FORCES,
            -10,
            10,
            "E w d",
            "what the lower jaw presses and drags with, then the upper one",
        ),
    )


LAYOUT = layout(TaskConfig().cap)
"""Name, size, bounds, unit and meaning of each part. Values are clipped to their bounds. New parts come
at the end alone, so that what reads an earlier, shorter observation reads the first numbers of this one."""

_ENDS = np.cumsum([part.size for part in LAYOUT]).tolist()
SIZE = _ENDS[-1]
SIZES = tuple(_ENDS[-2:])
"""That observations have had: `forces` came later."""
SLICES = {part.name: slice(end - part.size, end) for part, end in zip(LAYOUT, _ENDS, strict=True)}


def bounds(config: TaskConfig) -> tuple[Floats, Floats]:
    """Least and greatest observation, (SIZE,) each."""
    parts = layout(config.cap)
    sizes = [part.size for part in parts]
    low, high = ([getattr(part, end) for part in parts] for end in ("low", "high"))
    return np.repeat(low, sizes).astype(np.float32), np.repeat(high, sizes).astype(np.float32)


LOW, HIGH = bounds(TaskConfig())
"""(SIZE,) each, of the task as it is unless told otherwise"""


class Observer:
    """Observes one scene."""

    def __init__(self, scene: Scene, config: TaskConfig, stated: Scene | None = None):
        """scene: what there is; stated: what is known of it, None where that is the same."""
        stated = stated or scene
        self._height, self._stated, self._steps = scene.tissue.height, stated, config.steps
        self._low, self._high = bounds(config)
        tissue, line = stated.tissue, stated.line_of_sight
        self._unit = tissue.modulus * stated.jaws.width * tissue.depth
        at = -tissue.length * (1 - (np.arange(STIFFNESS_SAMPLES) + 0.5) / STIFFNESS_SAMPLES)
        self._k_eq = columns.k_eq(tissue, at) * tissue.height / tissue.modulus
        distance = np.hypot(*np.subtract(line.camera, line.target))
        self._sight = np.array([line.target[0] / tissue.length, line.slope, tissue.length / distance])
        limits = scene.limits
        self._limits = np.array([limits.strain, limits.friction, limits.clearance])
        self._surfaces: tuple[SectionMesh, Ints, Ints] | None = None

    def __call__(self, now: Situation) -> Floats:
        """(SIZE,) as LAYOUT says."""
        tissue, state, section = self._stated.tissue, now.state, now.section
        if self._surfaces is None or self._surfaces[0] is not section:
            self._surfaces = section, *surface_nodes(section, self._height)
        lower, upper = self._surfaces[1:]
        points = np.empty(4 * KEYPOINTS)
        for nodes, part in ((lower, points[: 2 * KEYPOINTS]), (upper, points[2 * KEYPOINTS :])):
            rules.keypoints(section.points[nodes, 0], state.points[nodes], tissue.length, part)
        out, forces = np.empty(SIZE, np.float32), (0.0,) * FORCES
        if now.holding:
            forces = rules.sensed(tuple(state.reactions.ravel().tolist()), state.jaws, self._unit)
        rules.observe(
            now.holding,
            1 - now.steps / self._steps,
            state.jaws,
            tissue.length,
            tissue.height,
            points,
            self._sight,
            self._k_eq,
            float(state.worst_strain),
            now.greatest_strain,
            *state.required_friction.tolist(),
            now.greatest_friction,
            float(state.clearance),
            now.exposure,
            self._limits,
            forces,
            now.off,
            self._low,
            self._high,
            out,
        )
        return out


def surface_nodes(section: SectionMesh, height: float) -> tuple[Ints, Ints]:
    """Nodes of the lower and of the upper surface, along x. height: m, of the flap."""
    x, y = section.points.T
    by_x = np.argsort(x, kind="stable")
    low, high = (by_x[np.abs(y[by_x] - level) < 1e-6 * height] for level in (0.0, height))
    return low, high


# --- Sensors

KNOWN = ("holding", "time_left")
"""Parts that nobody has to measure: one deviation for all does not blur them."""
PartName = Annotated[str, one_of(SLICES)]
Deviation = Annotated[float, Range(0.0, 100.0)]


def _by_part(value: Any) -> Any:
    """One number as that of every part that is measured; a mapping, or pairs, as they are."""
    if isinstance(value, Mapping):
        return tuple(value.items())
    if isinstance(value, list | tuple):
        return value
    number = Range(0.0, 100.0)
    if number.fault(value) is not None:
        raise refusal(f"{number.fault(value)}, or a mapping from parts of the observation to such numbers")
    return tuple((name, value) for name in SLICES if name not in KNOWN) if value else ()


class Sensors(Frozen):
    """What of the observation is measured badly or not at all; by default all is exact."""

    noise: Annotated[tuple[tuple[PartName, Deviation], ...], BeforeValidator(_by_part)] = ()
    """Deviation of Gaussian noise by part, in the units in which the part is observed; one number is that of
    all parts but `holding` and `time_left`. What is blurred is clipped to the bounds."""
    hide: Annotated[tuple[PartName, ...], Listed] = ()
    """Parts that are left out: observed as 0, the vector stays as long as it is."""

    @cached_property
    def deviation(self) -> Array:
        """(SIZE,) of the noise on every number."""
        out = np.zeros(SIZE)
        for name, deviation in self.noise:
            out[SLICES[name]] = deviation
        return out

    def read(self, exact: Floats, config: TaskConfig, rng: np.random.Generator) -> Floats:
        """What the sensors say of an exact observation (SIZE,); rng is drawn from where there is noise, as
        often for every part."""
        if not (self.noise or self.hide):
            return exact
        seen = exact.copy()
        if self.noise:
            blurred = exact + self.deviation * rng.standard_normal(SIZE)
            seen = np.clip(blurred, *bounds(config)).astype(np.float32)
        for name in self.hide:
            seen[SLICES[name]] = 0
        return seen
