"""The task that agents learn: actions, observation, reward, end of an episode, and what users may change."""

from retract_env.task.config import TaskConfig, Weights
from retract_env.task.observation import HIGH, LAYOUT, LOW, SIZE, SIZES, SLICES, Sensors
from retract_env.task.rules import KEYPOINTS, STIFFNESS_SAMPLES
from retract_env.task.situation import Situation
from retract_env.task.task import Outcome, RetractionTask, default_scene, sound

__all__ = [
    "HIGH",
    "KEYPOINTS",
    "LAYOUT",
    "LOW",
    "SIZE",
    "SIZES",
    "SLICES",
    "STIFFNESS_SAMPLES",
    "Outcome",
    "RetractionTask",
    "Sensors",
    "Situation",
    "TaskConfig",
    "Weights",
    "default_scene",
    "sound",
]
