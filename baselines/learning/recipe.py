"""A training recipe: one strict YAML file an algorithm, with every hyperparameter in it.

Errors are a `RecipeError` of one line that names the file, the field, the value and what is allowed.
"""

from __future__ import annotations

from os import PathLike
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from retract_env.config import Frozen, Listed, Range, brief, config_file, one_of, read_yaml, whole
from retract_env.errors import ConfigError
from retract_env.physics.registry import PHYSICS


class RecipeError(ConfigError):
    """A recipe that cannot be used; the message is one line."""


class _Part(Frozen):
    """Constructors and `from_data` raise `RecipeError`."""

    error_type: ClassVar[type[ConfigError]] = RecipeError


Count = Annotated[int, whole(1, 10**9)]
Rate = Annotated[float, Range(0.0, 1.0, "", "(]")]
Share = Annotated[float, Range(0.0, 1.0)]
Weight = Annotated[float, Range(0.0, 1e3)]


class Task(_Part):
    """What is learned on: arguments of the environment."""

    physics: Annotated[str, one_of(PHYSICS)] = "fem"
    scene: str | dict[str, Any] = "random"
    """as the environment takes it: "random", a file, or plain data"""
    grasp: Literal["agent", "spring"] = "agent"
    resolution: str | None = None


class Network(_Part):
    """The policy's network, and any critic's."""

    sizes: Annotated[tuple[Annotated[int, whole(1, 4096)], ...], Listed] = (256, 256)
    """Units of each hidden layer."""
    activation: Literal["tanh", "relu"] = "tanh"


class Observation(_Part):
    """How observations are normalised: (o - mean) / sqrt(variance + floor^2), clipped."""

    clip: Annotated[float, Range(1.0, 100.0)] = 10.0
    floor: Annotated[float, Range(1e-4, 1.0)] = 0.01
    """Least deviation that counts: what hardly varies in training would otherwise be blown up in use."""


class Evaluation(_Part):
    """When the policy is judged in its environment and everything is saved."""

    every: Count
    """Steps between evaluations, each with a checkpoint."""
    scenes: Annotated[int, whole(1, 1000)] = 16
    """So many of the validation split; a recipe with a scene of its own is judged on that one."""


class PPO(_Part):
    """Proximal policy optimisation."""

    learning_rate: Rate
    rollout: Count
    """Steps of each environment between updates."""
    batch_size: Count
    epochs: Count
    gamma: Share
    gae_lambda: Share
    clip_range: Rate
    entropy_weight: Weight
    value_weight: Weight
    max_gradient: Weight
    log_std: Annotated[float, Range(-10.0, 2.0)]
    """Logarithm of the actions' deviation at the start."""
    target_kl: Rate | None
    critic_first: Annotated[int, whole(0, 10**9)]
    """Steps at the start in which the critic alone learns."""


class SAC(_Part):
    """Soft actor-critic."""

    learning_rate: Rate
    buffer: Count
    """Transitions that are remembered."""
    warmup: Annotated[int, whole(0, 10**9)]
    """Steps before the first update; random ones, or those of the policy that training starts from."""
    batch_size: Count
    tau: Rate
    gamma: Share
    train_every: Count
    """Steps of each environment between updates."""
    updates: Count
    """Gradient steps then."""
    entropy_weight: Rate | Literal["auto"]
    log_std: Annotated[float, Range(-10.0, 2.0)]
    """Logarithm of the actions' deviation at the start."""
    critic_first: Annotated[int, whole(0, 10**9)]
    """Steps at the start in which the critic alone learns."""
    target_entropy: Annotated[float, Range(-100.0, 0.0)]


class TQC(SAC):
    """Truncated quantile critics: soft actor-critic that mistrusts its most hopeful quantiles."""

    critics: Annotated[int, whole(1, 10)]
    quantiles: Annotated[int, whole(1, 200)]
    dropped: Annotated[int, whole(0, 199)]
    """Quantiles dropped from each critic."""


class BC(_Part):
    """Behaviour cloning: least squares between the policy's mean action and the demonstrated one."""

    policy: Literal["ppo", "sac", "tqc"]
    """Whose policy class it is, so that this algorithm can go on from the result."""
    dataset: Annotated[str, Field(min_length=1)]
    """A Minari data set."""
    learning_rate: Rate
    """At the start; it falls to zero as a cosine."""
    batch_size: Count
    weight_decay: Share
    grasp_weight: Weight
    """How many times a move the choice of the grasp counts: there is one in an episode."""
    stiffness_noise: Weight
    """Deviation of the noise on the normalised k_eq: half of the observation, of which little depends."""


Learner = PPO | SAC | TQC | BC
LEARNERS: dict[str, type[PPO] | type[SAC] | type[TQC] | type[BC]] = {
    "ppo": PPO,
    "sac": SAC,
    "tqc": TQC,
    "bc": BC,
}


class Recipe(_Part):
    """All that decides a training run, but the seed and how many environments run side by side."""

    algorithm: Literal["ppo", "sac", "tqc", "bc"]
    steps: Count
    """Of all environments together; for bc, gradient steps."""
    task: Task = Task()
    network: Network = Network()
    observation: Observation = Observation()
    evaluation: Evaluation
    learner: Learner

    @classmethod
    def from_data(cls, data: Any) -> Recipe:
        """Recipe from plain data; its `learner` is read as the algorithm's. Raises RecipeError."""
        if isinstance(data, dict) and data.get("algorithm") in LEARNERS and "learner" in data:
            kind = LEARNERS[data["algorithm"]]
            if not isinstance(data["learner"], dict):
                raise RecipeError(f"learner = {brief(data['learner'])}, not a mapping")
            try:
                data = data | {"learner": kind.from_data(data["learner"])}
            except RecipeError as error:
                raise RecipeError(f"learner.{error}") from None
        return super().from_data(data)

    def dump(self) -> dict[str, Any]:
        """Plain data that `from_data` and a YAML file take back."""
        return self.model_dump(mode="json")


def load_recipe(path: str | PathLike[str]) -> Recipe:
    """Recipe from a YAML file, or the shipped one of a name. Raises RecipeError, naming the file."""
    try:
        return Recipe.from_data(read_yaml(config_file(path, "train")))
    except ConfigError as error:
        raise RecipeError(f"{path}: {error}") from None
