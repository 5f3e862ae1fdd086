"""A training recipe: one strict YAML file an algorithm, with every hyperparameter in it.

Errors are a `RecipeError` of one line that names the file, the field, the value and what is allowed.
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from baselines.learning.algorithms import ALGORITHMS, Learner
from baselines.learning.fields import Count, Part, RecipeError
from retract_env.config import (
    Flag,
    Listed,
    Name,
    Range,
    brief,
    config_file,
    one_of,
    read_yaml,
    refusal,
    whole,
)
from retract_env.errors import ConfigError
from retract_env.physics.registry import PHYSICS

if TYPE_CHECKING:
    from typing_extensions import Self


def _scene(value: Any) -> Any:
    """Plain data has to be a scene's; a file is read when training begins."""
    if isinstance(value, dict):
        from retract_env.scene import Scene

        try:
            Scene.from_data(value)
        except ConfigError as error:
            raise refusal(f".{error}") from None
    elif not isinstance(value, str):
        raise refusal(f" = {brief(value)}, allowed 'random', a file, or a scene as plain data")
    return value


def _read_by(model: str) -> BeforeValidator:
    """Plain data that a model of `retract_env.task` takes; that is imported where there are any."""

    def check(value: Any) -> Any:
        if not isinstance(value, dict):
            raise refusal(f" = {brief(value)}, not a mapping")
        if value:
            from retract_env import task

            try:
                getattr(task, model).from_data(value)
            except ConfigError as error:
                raise refusal(f".{error}") from None
        return value

    return BeforeValidator(check)


class EnvSettings(Part):
    """What is learned on: arguments of the environment."""

    physics: Annotated[str, one_of(PHYSICS)] = "rod"
    scene: Annotated[Name | dict[str, Any], BeforeValidator(_scene)] = "random"
    """as the environment takes it: "random", a file, or plain data"""
    grasp: Literal["agent", "spring"] = "agent"
    resolution: Name | None = None
    grip: Literal["compression", "force"] | None = None
    """None: the task's"""
    task: Annotated[dict[str, Any], _read_by("TaskConfig")] = Field(default_factory=dict)
    """what differs from the task's defaults"""
    sensors: Annotated[dict[str, Any], _read_by("Sensors")] = Field(default_factory=dict)
    unknowns: Flag = False

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of the environment, without those that are empty."""
        given = self.model_dump(mode="json", exclude={"physics"})
        optional = {"grip", "task", "sensors", "unknowns"}
        return {name: value for name, value in given.items() if value or name not in optional}

    @model_validator(mode="after")
    def _resolution_is_the_physics(self) -> Self:
        if self.resolution is not None:
            try:
                PHYSICS[self.physics].check(self.resolution)
            except ImportError:
                pass  # the recipe may be sound; the run says what to install
            except ValueError as error:
                raise refusal(f".{error}") from None
        return self


class Network(Part):
    """The policy's network, and any critic's."""

    sizes: Annotated[tuple[Annotated[int, whole(1, 4096)], ...], Listed] = (256, 256)
    """Units of each hidden layer."""
    activation: Literal["tanh", "relu"] = "tanh"


class Observation(Part):
    """How observations are normalised: (o - mean) / sqrt(variance + floor^2), clipped."""

    clip: Annotated[float, Range(1.0, 100.0)] = 10.0
    floor: Annotated[float, Range(1e-4, 1.0)] = 0.01
    """Least deviation that counts: what hardly varies in training would otherwise be blown up in use."""


class Evaluation(Part):
    """When the policy is judged in its environment, and when everything is saved.

    A checkpoint ends a leg: the next begins with environments that are reset and generators seeded anew, so
    that a run which was killed takes the same course as one that was not. So checkpoints are the recipe's.
    """

    every: Count
    """Steps between evaluations, each with a checkpoint."""
    checkpoint: Count | None = None
    """Steps between further checkpoints; None: at evaluations only."""
    scenes: Annotated[int, whole(1, 1000)] = 16
    """So many of the validation split; a recipe with a scene of its own is judged on that one."""
    fem: Annotated[int, whole(0, 1000)] = 8
    """On so many of these it is also played on coarse finite elements, where it learns on something else."""


def learner_of(algorithm: object) -> type[Learner]:
    """The algorithm of that name. Raises RecipeError for another one."""
    if not isinstance(algorithm, str) or algorithm not in ALGORITHMS:
        raise RecipeError(f"algorithm = {brief(algorithm)}, allowed {', '.join(ALGORITHMS)}")
    return ALGORITHMS[algorithm]


class Recipe(Part):
    """All that decides a training run, but the seed, and how many environments where it does not say."""

    name: Name | None = None
    """What its policies are called, whatever their seed; None: as the algorithm."""
    algorithm: str
    """in `ALGORITHMS`"""
    steps: Count
    """Of all environments together; for bc, gradient steps."""
    envs: Annotated[int, whole(1, 100_000)] | None = None
    """Environments side by side unless told otherwise; None: one a core."""
    task: EnvSettings = EnvSettings()
    network: Network = Network()
    observation: Observation = Observation()
    evaluation: Evaluation
    learner: SerializeAsAny[Learner]

    @model_validator(mode="after")
    def _learner_is_the_algorithms(self) -> Self:
        if type(self.learner) is not ALGORITHMS.get(self.algorithm):
            kind = type(self.learner).__name__
            raise refusal(f".algorithm = {brief(self.algorithm)}, but the learner's is {kind}")
        return self

    @classmethod
    def from_data(cls, data: Any) -> Recipe:
        """Recipe from plain data; its `learner` is read as the algorithm's. Raises RecipeError."""
        if isinstance(data, dict) and {"algorithm", "learner"} <= data.keys():
            kind, given = learner_of(data["algorithm"]), data["learner"]
            if not isinstance(given, dict):
                raise RecipeError(f"learner = {brief(given)}, not a mapping")
            try:
                data = data | {"learner": kind.from_data(given)}
            except RecipeError as error:
                raise RecipeError(f"learner.{error}") from None
        return super().from_data(data)

    def dump(self) -> dict[str, Any]:
        """Plain data that `from_data` and a YAML file take back."""
        return self.model_dump(mode="json")


def load_recipe(path: str | PathLike[str]) -> Recipe:
    """Recipe from a YAML file, or the shipped one of that name. Raises RecipeError, naming the file."""
    try:
        return Recipe.from_data(read_yaml(config_file(path, "train")))
    except ConfigError as error:
        raise RecipeError(f"{path}: {error}") from None
