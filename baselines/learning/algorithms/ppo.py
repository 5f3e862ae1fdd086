"""Proximal policy optimisation (Schulman et al., 2017), as Stable-Baselines3 has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from baselines.learning.algorithms.base import Actor, Learner, linear_layers
from baselines.learning.fields import Count, Rate, Share, Steps, Weight
from retract_env.config import Range, whole

if TYPE_CHECKING:
    import torch
    from stable_baselines3.common.vec_env import VecNormalize


class GaussianActor(Actor):
    """The mean of a Gaussian, clipped."""

    output = "clip"

    def layers(self, model: Any) -> list[torch.nn.Linear]:
        return linear_layers(model.policy.mlp_extractor.policy_net, model.policy.action_net)

    def untrained(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        from stable_baselines3 import PPO as SB3PPO

        return SB3PPO("MlpPolicy", envs, policy_kwargs=shape, seed=seed, device="cpu")


class PPO(Learner):
    """Proximal policy optimisation."""

    ACTOR: ClassVar[Actor | None] = GaussianActor()

    rollout: Annotated[int, whole(2, 10**9)]
    """Steps of each environment between updates."""
    batch_size: Annotated[int, whole(2, 10**9)]
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
    critic_first: Steps
    """Steps at the start in which the critic alone learns."""

    def build(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        from stable_baselines3 import PPO as SB3PPO

        return SB3PPO(
            "MlpPolicy",
            envs,
            learning_rate=self.learning_rate,
            n_steps=self.rollout,
            batch_size=self.batch_size,
            n_epochs=self.epochs,
            gamma=self.gamma,
            gae_lambda=self.gae_lambda,
            clip_range=self.clip_range,
            ent_coef=self.entropy_weight,
            vf_coef=self.value_weight,
            max_grad_norm=self.max_gradient,
            target_kl=self.target_kl,
            policy_kwargs={**shape, "log_std_init": self.log_std},
            seed=seed,
            device="cpu",
        )

    def let_actor_learn(self, model: Any, learns: bool) -> None:
        policy = model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net, policy.log_std):
            part.requires_grad_(learns)
