"""What the environments are given, read: plain data to scenes, grasps and settings, refused in one line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from retract_env.config import Frozen
from retract_env.grasp import Grasp
from retract_env.scene import Scene, load_scene
from retract_env.scene.sampling import SceneRanges
from retract_env.task import Sensors, TaskConfig, default_scene


class Settings(Frozen):
    """What is given as plain data, read together so that an error names the argument."""

    task: TaskConfig = TaskConfig()
    ranges: SceneRanges = SceneRanges()
    sensors: Sensors = Sensors()


def read_settings(
    task: Mapping[str, Any] | TaskConfig | None,
    ranges: Mapping[str, Any] | SceneRanges | None,
    sensors: Mapping[str, Any] | Sensors | None,
    grip: str | None,
) -> Settings:
    """The settings; grip: None is the task's. Raises ConfigError."""
    given = {"task": task, "ranges": ranges, "sensors": sensors}
    settings = Settings.from_data({name: value for name, value in given.items() if value is not None})
    if grip is None:
        return settings
    if grip not in ("compression", "force"):
        raise ValueError(f"grip = {grip!r}, allowed compression, force")
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
