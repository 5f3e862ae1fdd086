"""What an algorithm is to a training run: its hyperparameters, and all that it does in a way of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from baselines.learning.fields import Part, Rate, Share

if TYPE_CHECKING:
    import torch
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize


class Actor(ABC):
    """A kind of policy network in a model of Stable-Baselines3."""

    output: Literal["clip", "tanh"]
    """what brings the numbers of its last layer into [-1, 1]"""

    @abstractmethod
    def layers(self, model: Any) -> list[torch.nn.Linear]:
        """Its linear layers from observation to action."""

    @abstractmethod
    def untrained(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        """A model that holds such a network and little besides, for others to fit."""


class Learner(Part):
    """Hyperparameters as fields; an algorithm's class says the rest in methods.

    `model` is one of Stable-Baselines3's, as `build` makes it.
    """

    ACTOR: ClassVar[Actor | None] = None
    """What it trains; None for algorithms that train another one's."""
    AGENT: ClassVar[str] = "baselines.learning.agents:Agent"
    """Who learns by it, "module:Class"; made by the class' method `of`."""

    learning_rate: Rate
    """At the start."""
    decay: Share = 1.0
    """Part of the learning rate that is left at the end; it falls evenly."""

    @property
    def actor(self) -> Actor:
        """What kind of policy it trains."""
        assert self.ACTOR is not None
        return self.ACTOR

    def build(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        """The model, untrained. shape: `net_arch` and `activation_fn` of its networks."""
        raise NotImplementedError  # every algorithm has its own

    def environment(self, envs: VecEnv) -> VecEnv:
        """What it learns in: the environments, or a wrapper of them."""
        return envs

    def before_rollout(self, model: Any) -> None:
        """Called each time before environments are stepped for the next updates."""

    def let_actor_learn(self, model: Any, learns: bool) -> None:
        """Whether updates change the policy as well, or the critic alone."""
        raise NotImplementedError  # every algorithm has its own

    def act_from_start(self, model: Any) -> None:
        """The policy was trained before: it acts where an untrained one would leave that to chance."""

    def memory(self, model: Any) -> dict[str, Any]:  # noqa: ARG002  (some have more)
        """What the next leg depends on besides parameters: tensors, numbers and texts."""
        return {}

    def remember(self, model: Any, memory: dict[str, Any]) -> None:
        """The inverse of `memory`. Raises KeyError, ValueError or RuntimeError for another algorithm's."""


ALGORITHMS: dict[str, type[Learner]] = {}
"""By the name that recipes and the console use; filled where the package begins."""


def linear_layers(*parts: Any) -> list[torch.nn.Linear]:
    """Linear layers of networks, in their order."""
    import torch

    return [m for part in parts for m in part.modules() if isinstance(m, torch.nn.Linear)]
