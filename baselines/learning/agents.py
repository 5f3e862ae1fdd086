"""Stable-Baselines3's algorithms as recipes name them: built, exported, begun from a policy, saved, restored.

What is saved are tensors, numbers and texts. An agent learns in legs. Each begins with environments and
generators seeded from the run's seed and the steps done, so that a run that was killed and resumed takes the
same course as one that was not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from sb3_contrib import TQC as SB3TQC
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3 import SAC as SB3SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecNormalize

from baselines.learning.envs import arguments, seed_of
from baselines.learning.policies import Policy
from baselines.learning.recipe import BC, PPO, SAC, TQC, Recipe, RecipeError
from retract_env.physics.registry import PHYSICS
from retract_env.threads import limit_torch

State = dict[str, Any]
OnStep = Callable[[int], None]

ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class Agent:
    """A model in its environments, and the steps that it has learned for."""

    def __init__(self, recipe: Recipe, envs: VecNormalize, seed: int, log: Path | None = None):
        """log: folder for TensorBoard. Raises RecipeError."""
        self.recipe, self.envs, self.seed = recipe, envs, seed
        self.stats = cast(RunningMeanStd, envs.obs_rms)  # of one vector, not of a dictionary
        self.started = ""
        """name of the policy that this one began from, if it did"""
        limit_torch(torch)
        self.model: Any = build(recipe, envs, seed_of(seed))
        # what goes to standard output is the progress bar's
        self.model.set_logger(configure(None if log is None else str(log), ["tensorboard"] if log else []))

    @property
    def steps(self) -> int:
        return int(self.model.num_timesteps)

    def learn(self, steps: int, on_step: OnStep) -> None:
        """One leg of so many steps, or a few more, as whole updates need."""
        seed = seed_of(self.seed, self.steps)
        set_random_seed(seed)
        self.model.action_space.seed(seed)
        self.envs.seed(seed)
        self.model._last_obs = None  # so that the environments are reset
        callback = _Watch(on_step, getattr(self.recipe.learner, "critic_first", 0))
        self.model.learn(steps, callback, log_interval=4, reset_num_timesteps=False)

    def record(self, values: Mapping[str, float]) -> None:
        """Put values into the logs."""
        for name, value in values.items():
            self.model.logger.record(name, value)
        self.model.logger.dump(self.steps)

    def policy(self) -> Policy:
        """What has been learned, its actions without noise."""
        layers = self._layers()
        stats, floor = self.stats, self.recipe.observation.floor
        return Policy(
            name=f"{self.started}+{self.recipe.algorithm}" if self.started else self.recipe.algorithm,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
            mean=stats.mean.astype(np.float32),
            deviation=np.sqrt(stats.var + floor**2).astype(np.float32),
            clip=self.recipe.observation.clip,
            activation=self.recipe.network.activation,
            output=self._output,
            env={"id": PHYSICS[self.recipe.task.physics].env_id, "kwargs": arguments(self.recipe.task)},
        )

    def begin_from(self, policy: Policy) -> None:
        """Take over a policy and its normalisation of observations, which then stays as it is.

        Raises RecipeError where the recipe's network is another one.
        """
        layers = self._layers()
        ours = ([tuple(layer.weight.shape) for layer in layers], self.recipe.network.activation, self._output)
        if (theirs := ([w.shape for w in policy.weights], policy.activation, policy.output)) != ours:
            raise RecipeError(f"network: layers, activation and output {ours}, those to start from {theirs}")
        with torch.no_grad():
            for layer, weight, bias in zip(layers, policy.weights, policy.biases, strict=True):
                layer.weight.copy_(torch.from_numpy(weight))
                layer.bias.copy_(torch.from_numpy(bias))
        floor = self.recipe.observation.floor
        self.normalise(policy.mean, np.maximum(policy.deviation.astype(np.float64) ** 2 - floor**2, 0.0))
        self._start(policy.name)

    def _start(self, name: str) -> None:
        """From now on the actions of the warm-up are the policy's, not random ones."""
        self.started = name
        if isinstance(self.model, OffPolicyAlgorithm):
            model: Any = self.model
            choose = model._sample_action
            model._sample_action = lambda _, noise=None, count=1: choose(0, noise, count)

    def normalise(self, mean: Any, variance: Any) -> None:
        """Fix what observations are normalised with."""
        self.stats.mean = np.asarray(mean, np.float64)
        self.stats.var = np.asarray(variance, np.float64)
        self.envs.training = False

    def state(self) -> State:
        """All that the next leg depends on: tensors, numbers and texts."""
        stats = self.stats
        state: State = {
            "steps": self.steps,
            "started": self.started,
            "updates": int(self.model._n_updates),
            "parameters": self.model.get_parameters(),
            "variables": {
                name: getattr(self.model, name).detach() for name in self.model._get_torch_save_params()[1]
            },
            "normalisation": {
                "mean": torch.from_numpy(stats.mean.copy()),
                "variance": torch.from_numpy(stats.var.copy()),
                "count": float(stats.count),
                "fixed": not self.envs.training,
            },
        }
        if isinstance(self.model, OffPolicyAlgorithm):
            buffer = self.model.replay_buffer
            assert buffer is not None
            filled = buffer.buffer_size if buffer.full else buffer.pos
            state["replay"] = {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in BUFFER}
            state["replay_at"] = [int(buffer.pos), bool(buffer.full)]
        return state

    def restore(self, state: State) -> None:
        """The inverse of `state`. Raises KeyError, ValueError or RuntimeError for another agent's."""
        self.model.set_parameters(state["parameters"], exact_match=True, device="cpu")
        for name, value in state["variables"].items():
            getattr(self.model, name).data.copy_(value)
        self.model.num_timesteps, self.model._n_updates = state["steps"], state["updates"]
        if state["started"]:
            self._start(state["started"])
        kept = state["normalisation"]
        self.stats.mean = kept["mean"].numpy().copy()
        self.stats.var = kept["variance"].numpy().copy()
        self.stats.count = kept["count"]
        self.envs.training = not kept["fixed"]
        if isinstance(self.model, OffPolicyAlgorithm):
            buffer = self.model.replay_buffer
            assert buffer is not None
            for name, value in state["replay"].items():
                getattr(buffer, name)[: len(value)] = value.numpy()
            buffer.pos, buffer.full = state["replay_at"]

    def _layers(self) -> list[torch.nn.Linear]:
        """The policy's linear layers from observation to action."""
        net: Any = self.model.policy
        if isinstance(self.model, OffPolicyAlgorithm):
            parts = [net.actor.latent_pi, net.actor.mu]
        else:
            parts = [net.mlp_extractor.policy_net, net.action_net]
        return [m for part in parts for m in part.modules() if isinstance(m, torch.nn.Linear)]

    @property
    def _output(self) -> Literal["clip", "tanh"]:
        return "tanh" if isinstance(self.model, OffPolicyAlgorithm) else "clip"


class _Watch(BaseCallback):
    """Tells of progress, and keeps the actor as it is while the critic alone is to learn."""

    def __init__(self, on_step: OnStep, critic_first: int):
        super().__init__()
        self._tell, self._critic_first = on_step, critic_first

    def _on_rollout_start(self) -> None:
        learns = self.num_timesteps >= self._critic_first
        policy: Any = self.model.policy
        actor = (
            policy.actor if isinstance(self.model, OffPolicyAlgorithm) else policy.mlp_extractor.policy_net
        )
        heads = [] if isinstance(self.model, OffPolicyAlgorithm) else [policy.action_net]
        for part in (actor, *heads):
            part.requires_grad_(learns)
        if not isinstance(self.model, OffPolicyAlgorithm):
            policy.log_std.requires_grad_(learns)

    def _on_step(self) -> bool:
        self._tell(self.num_timesteps)
        return True


def build(recipe: Recipe, envs: VecNormalize, seed: int) -> Any:
    """The model that a recipe describes, untrained. Raises RecipeError."""
    how, network = recipe.learner, recipe.network
    sizes = list(network.sizes)
    shape: dict[str, Any] = {"net_arch": sizes, "activation_fn": ACTIVATIONS[network.activation]}
    common: dict[str, Any] = {"seed": seed, "device": "cpu"}
    if isinstance(how, BC):
        kind: Any = {"ppo": SB3PPO, "sac": SB3SAC, "tqc": SB3TQC}[how.policy]
        few = {} if how.policy == "ppo" else {"buffer_size": 1}
        return kind("MlpPolicy", envs, policy_kwargs=shape, **few, **common)
    if isinstance(how, PPO):
        return SB3PPO(
            "MlpPolicy",
            envs,
            learning_rate=how.learning_rate,
            n_steps=how.rollout,
            batch_size=how.batch_size,
            n_epochs=how.epochs,
            gamma=how.gamma,
            gae_lambda=how.gae_lambda,
            clip_range=how.clip_range,
            ent_coef=how.entropy_weight,
            vf_coef=how.value_weight,
            max_grad_norm=how.max_gradient,
            target_kl=how.target_kl,
            policy_kwargs={**shape, "log_std_init": how.log_std},
            **common,
        )
    assert isinstance(how, SAC)
    options: dict[str, Any] = {
        "learning_rate": how.learning_rate,
        "buffer_size": how.buffer,
        "learning_starts": how.warmup,
        "batch_size": how.batch_size,
        "tau": how.tau,
        "gamma": how.gamma,
        "train_freq": how.train_every,
        "gradient_steps": how.updates,
        "ent_coef": how.entropy_weight,
        "target_entropy": how.target_entropy,
    }
    algorithm: Any = SB3SAC
    if isinstance(how, TQC):
        algorithm = SB3TQC
        options["top_quantiles_to_drop_per_net"] = how.dropped
        shape |= {"n_quantiles": how.quantiles, "n_critics": how.critics}
    model = algorithm("MlpPolicy", envs, policy_kwargs=shape, **options, **common)
    with torch.no_grad():
        model.actor.log_std.bias.fill_(how.log_std)
    return model
