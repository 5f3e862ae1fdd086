"""The task that agents learn: actions, observation, reward, end of an episode."""

from retract_env.task.task import (
    CAP,
    HIGH,
    KEYPOINTS,
    LAYOUT,
    LOW,
    MAX_STEPS,
    REWARD_RANGE,
    SIZE,
    SLICES,
    STIFFNESS_SAMPLES,
    WEIGHTS,
    RetractionTask,
    Situation,
    default_scene,
    sound,
)

__all__ = [
    "CAP",
    "HIGH",
    "KEYPOINTS",
    "LAYOUT",
    "LOW",
    "MAX_STEPS",
    "REWARD_RANGE",
    "SIZE",
    "SLICES",
    "STIFFNESS_SAMPLES",
    "WEIGHTS",
    "RetractionTask",
    "Situation",
    "default_scene",
    "sound",
]
