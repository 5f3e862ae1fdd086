"""Soft actor-critic (Haarnoja et al., 2018), as Stable-Baselines3 has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from baselines.learning.algorithms.base import Actor, Learner, linear_layers
from baselines.learning.fields import Count, Rate, Share, Steps
from retract_env.config import Range

if TYPE_CHECKING:
    import torch
    from stable_baselines3.common.vec_env import VecNormalize

REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""What the replay buffer holds of each transition."""


class SquashedActor(Actor):
    """The mean of a Gaussian, through a hyperbolic tangent."""

    output = "tanh"

    def layers(self, model: Any) -> list[torch.nn.Linear]:
        return linear_layers(model.actor.latent_pi, model.actor.mu)

    def untrained(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        from stable_baselines3 import SAC as SB3SAC

        return SB3SAC("MlpPolicy", envs, buffer_size=1, policy_kwargs=shape, seed=seed, device="cpu")


class SAC(Learner):
    """Soft actor-critic."""

    ACTOR: ClassVar[Actor | None] = SquashedActor()

    buffer: Count
    """Transitions that are remembered."""
    warmup: Steps
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
    critic_first: Steps
    """Steps at the start in which the critic alone learns."""
    target_entropy: Annotated[float, Range(-100.0, 0.0)]

    def build(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        from stable_baselines3 import SAC as SB3SAC

        return self.soft(SB3SAC, envs, shape, seed)

    def soft(self, kind: Any, envs: VecNormalize, shape: dict[str, Any], seed: int, **options: Any) -> Any:
        """A model of Stable-Baselines3's class `kind`; options: arguments that others lack."""
        import torch

        model = kind(
            "MlpPolicy",
            envs,
            learning_rate=self.learning_rate,
            buffer_size=self.buffer,
            learning_starts=self.warmup,
            batch_size=self.batch_size,
            tau=self.tau,
            gamma=self.gamma,
            train_freq=self.train_every,
            gradient_steps=self.updates,
            ent_coef=self.entropy_weight,
            target_entropy=self.target_entropy,
            policy_kwargs=shape,
            seed=seed,
            device="cpu",
            **options,
        )
        with torch.no_grad():
            model.actor.log_std.bias.fill_(self.log_std)
        return model

    def let_actor_learn(self, model: Any, learns: bool) -> None:
        model.policy.actor.requires_grad_(learns)

    def act_from_start(self, model: Any) -> None:
        """The actions of the warm-up are the policy's, not random ones."""
        choose = model._sample_action
        model._sample_action = lambda _, noise=None, count=1: choose(0, noise, count)

    def memory(self, model: Any) -> dict[str, Any]:
        """The replay buffer."""
        import torch

        buffer = model.replay_buffer
        filled = buffer.buffer_size if buffer.full else buffer.pos
        return {
            "replay": {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in REPLAYED},
            "replay_at": [int(buffer.pos), bool(buffer.full)],
        }

    def remember(self, model: Any, memory: dict[str, Any]) -> None:
        buffer = model.replay_buffer
        for name, value in memory["replay"].items():
            getattr(buffer, name)[: len(value)] = value.numpy()
        buffer.pos, buffer.full = memory["replay_at"]
