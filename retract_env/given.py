"""What the environments are given, read: plain data to scenes, grasps and settings, refused in one line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from retract_env.config import Frozen, brief
from retract_env.grasp import Grasp
from retract_env.scene import UNKNOWNS, Scene, Uncertainty, load_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.task import Sensors, TaskConfig, actions, default_scene

Array = NDArray[np.float64]


class Settings(Frozen):
    """What is given as plain data, read together so that an error names the argument."""

    task: TaskConfig = TaskConfig()
    ranges: SceneRanges = SceneRanges()
    sensors: Sensors = Sensors()
    unknowns: Uncertainty | None = None
    """None: all is as scenes say. What is set here counts instead of what they say of their uncertainty."""

    @property
    def set_here(self) -> dict[str, Any] | None:
        """What counts instead of what scenes say of their uncertainty; None where all is as they say."""
        named = self.unknowns
        return None if named is None else {name: getattr(named, name) for name in named.model_fields_set}

    def check_same_task(self, task: TaskConfig) -> None:
        """Raise ValueError, with the fields that differ, for the task of a state from another environment."""
        if task != self.task:
            theirs, ours = task.model_dump(), self.task.model_dump()
            names = ", ".join(name for name in ours if theirs[name] != ours[name])
            raise ValueError(f"the state is of an environment whose task differs in {names}")

    def prior(self, scene: Scene) -> Scene:
        """The scene with the uncertainty that counts."""
        if not self.set_here:
            return scene
        return scene.model_copy(update={"uncertainty": scene.uncertainty.model_copy(update=self.set_here)})


Unknowns = bool | Mapping[str, Any] | Uncertainty | None


def check_choices(*choices: tuple[str, Any, Sequence[Any]]) -> None:
    """Raise ValueError for the first of (name, value, what is allowed) that is not allowed."""
    for name, value, allowed in choices:
        if value not in allowed:
            raise ValueError(f"{name} = {value!r}, allowed {', '.join(map(str, allowed))}")


def read_settings(
    task: Mapping[str, Any] | TaskConfig | None,
    ranges: Mapping[str, Any] | SceneRanges | None,
    sensors: Mapping[str, Any] | Sensors | None,
    grip: str | None,
    unknowns: Unknowns = None,
) -> Settings:
    """The settings; grip: None is the task's; unknowns: True is what scenes say. Raises ConfigError."""
    if isinstance(unknowns, bool):
        unknowns = {} if unknowns else None
    given = {"task": task, "ranges": ranges, "sensors": sensors, "unknowns": unknowns}
    settings = Settings.from_data({name: value for name, value in given.items() if value is not None})
    if grip is None:
        return settings
    check_choices(("grip", grip, ("compression", "force")))
    return settings.model_copy(update={"task": settings.task.model_copy(update={"grip": grip})})


def read_scene(source: str | Mapping[str, Any] | Scene | None) -> Scene | Literal["random"]:
    """A scene from what the environment was given. Raises SceneError."""
    if source is None:
        return default_scene()
    if source == "random":
        return "random"
    if isinstance(source, Scene):
        return source
    return Scene.from_data(source) if isinstance(source, Mapping) else load_scene(source)


def read_grasp(source: str | Mapping[str, float] | Grasp) -> Grasp | str:
    """The grasp that the environment was given, "agent" and "spring" as they are. Raises ValueError."""
    if isinstance(source, Grasp) or source in ("agent", "spring"):
        return source
    if isinstance(source, Mapping) and set(source) in ({"x", "compression"}, {"x", "force"}):
        return Grasp(**source)
    raise ValueError(f"grasp = {source!r}, allowed 'agent', 'spring', x and compression, or x and force")


class Options(NamedTuple):
    """What is asked of one episode; None where nothing is."""

    scene: Scene | Literal["random"] | None = None
    grasp: Grasp | str | None = None
    line_of_sight: Any = None
    unknowns: Array | None = None
    """(UNKNOWNS,), or (count, UNKNOWNS) of many environments"""


NOTHING = Options()


def read_options(options: Mapping[str, Any] | None, count: int | None = None) -> Options:
    """The options of a reset; count: of how many environments, None: of a single one. Raises ValueError."""
    options = options or {}
    if unknown := set(options) - set(Options._fields):
        raise ValueError(f"options: unknown {', '.join(sorted(map(str, unknown)))}")
    line = options.get("line_of_sight")
    if line is None and "line_of_sight" in options:
        raise ValueError("line_of_sight = None, allowed a camera and a target")
    return Options(
        read_scene(options["scene"]) if "scene" in options else None,
        read_grasp(options["grasp"]) if "grasp" in options else None,
        line,
        _read_draw(options["unknowns"], count) if "unknowns" in options else None,
    )


def _read_draw(source: Any, count: int | None) -> Array:
    each = (len(UNKNOWNS),)
    shapes = [each] if count is None else [each, (count, *each)]
    allowed = f"{' or '.join(map(str, shapes))} numbers in [-1, 1]"
    try:
        z = np.array(source, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"unknowns = {source!r}, allowed {allowed}".replace("\n", " ")) from None
    if z.shape not in shapes:
        raise ValueError(f"unknowns have shape {z.shape}, allowed {allowed}")
    if not (np.abs(z) <= 1).all():
        raise ValueError(f"unknowns = {z.tolist()}, allowed {allowed}")
    return z


def read_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    """Which of so many environments are reset, None: all. Raises ValueError."""
    if mask is None:
        return np.ones(count, np.bool_)
    found: NDArray[np.bool_] = np.asarray(mask)
    if found.shape != (count,) or found.dtype != np.bool_ or not found.any():
        said = " ".join(brief(mask).split())
        raise ValueError(
            f"options['reset_mask'] = {said}, allowed ({count},) bool, at least one of them True"
        )
    return found


def read_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed, or None, for each of so many environments. Raises ValueError."""
    if seed is None:
        return [None] * count
    if isinstance(seed, int | np.integer):
        each: list[Any] = [int(seed) + k for k in range(count)]
    elif isinstance(seed, Iterable):
        each = list(seed)
    else:
        raise ValueError(f"seed = {seed!r}, allowed a whole number, or one or None for each environment")
    if len(each) != count:
        raise ValueError(f"seed has {len(each)} numbers, allowed {count}")
    return [None if one is None else _read_seed(one, k) for k, one in enumerate(each)]


def _read_seed(seed: Any, k: int) -> int:
    if not isinstance(seed, int | np.integer) or seed < 0:
        said = " ".join(brief(seed).split())
        raise ValueError(f"seed of environment {k} = {said}, allowed None or a whole number from 0 on")
    return int(seed)


def read_actions(given: ArrayLike, count: int) -> Array:
    """Actions (count, 3) with each number clipped to [-1, 1]. Raises ValueError."""
    try:
        numbers = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"actions = {given!r}, allowed numbers".replace("\n", " ")) from None
    if numbers.shape != (count, actions.SIZE):
        raise ValueError(f"actions have shape {numbers.shape}, allowed ({count}, {actions.SIZE})")
    if not np.isfinite(numbers).all():
        k = int(np.flatnonzero(~np.isfinite(numbers).all(axis=1))[0])
        raise ValueError(f"action of environment {k} = {numbers[k].tolist()}, allowed finite numbers")
    return np.clip(numbers, -1.0, 1.0)
