"""A model of Stable-Baselines3 in its environments: begun from a policy, exported, saved, restored.

What is saved are tensors, numbers and texts. An agent learns in legs. Each begins with environments and
generators seeded from the run's seed and the steps done, so that a run that was killed and resumed takes the
same course as one that was not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecNormalize

from baselines.learning.envs import seed_of
from baselines.learning.fields import RecipeError
from baselines.learning.policies import Policy
from retract_env.physics.registry import PHYSICS
from retract_env.task.rules import FAILURES
from retract_env.threads import limit_torch

if TYPE_CHECKING:
    from baselines.learning.algorithms import Learner
    from baselines.learning.recipe import Recipe

State = dict[str, Any]
OnStep = Callable[[int], None]

UNSOLVED = (*filter(None, FAILURES), "not_visible")
"""Why an episode ended without success."""
ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


class Agent:
    """A model in its environments, and the steps that it has learned for."""

    def __init__(self, recipe: Recipe, envs: VecNormalize, seed: int):
        self.recipe, self.envs, self.seed = recipe, envs, seed
        self.learner: Learner = recipe.learner
        self.stats = cast(RunningMeanStd, envs.obs_rms)  # of one vector, not of a dictionary
        self.started = ""
        """name of the policy that this one began from, if it did"""
        self.contents: dict[str, str] = {}
        """hash of what is learned from besides the environments, by what it is"""
        self.ended: Counter[str] = Counter()
        """how the episodes of this leg ended: "" with success, else what failed"""
        limit_torch(torch)
        shape = {
            "net_arch": list(recipe.network.sizes),
            "activation_fn": ACTIVATIONS[recipe.network.activation],
        }
        self.model: Any = self.learner.build(envs, shape, seed_of(seed))
        self.model.lr_schedule = lambda _: self.rate()  # its own would count from leg to leg
        self.model.set_logger(configure(None, []))  # what goes to standard output is the progress bar's

    @classmethod
    def of(cls, recipe: Recipe, envs: VecNormalize, seed: int, demos: int | None) -> Agent:
        """Who learns by a recipe. demos: how many episodes of a data set it learns from, None for all.

        Raises RecipeError, and DemosError for a data set that cannot be used.
        """
        if demos is not None:
            raise RecipeError(f"demos = {demos}, but {recipe.algorithm} learns from no data set")
        return cls(recipe, envs, seed)

    def log_to(self, folder: Path) -> None:
        """Write TensorBoard's logs into a folder, which is made. Raises OSError."""
        self.model.set_logger(configure(str(folder), ["tensorboard"]))

    @property
    def steps(self) -> int:
        """Of the environment, so far."""
        return int(self.model.num_timesteps)

    def rate(self) -> float:
        """The learning rate now."""
        done = min(1.0, self.steps / self.recipe.steps)
        return float(self.learner.learning_rate * (1.0 - (1.0 - self.learner.decay) * done))

    def learn(self, steps: int, on_step: OnStep) -> None:
        """One leg of so many steps, or a few more, as whole updates need."""
        seed = seed_of(self.seed, self.steps)
        set_random_seed(seed)
        self.model.action_space.seed(seed)
        self.envs.seed(seed)
        self.ended.clear()
        self.model._last_obs = None  # so that the environments are reset
        callback = _Watch(on_step, self.learner, self.ended)
        self.model.learn(steps, callback, log_interval=4, reset_num_timesteps=False)

    def record(self, values: Mapping[str, float]) -> None:
        """Put values into the logs."""
        for name, value in values.items():
            self.model.logger.record(name, value)
        self.model.logger.dump(self.steps)

    def policy(self) -> Policy:
        """What has been learned, its actions without noise."""
        layers = self.layers()
        stats, floor = self.stats, self.recipe.observation.floor
        name = self.recipe.name or self.recipe.algorithm
        return Policy(
            name=f"{self.started}+{name}" if self.started else name,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
            mean=stats.mean.astype(np.float32),
            deviation=np.sqrt(stats.var + floor**2).astype(np.float32),
            clip=self.recipe.observation.clip,
            activation=self.recipe.network.activation,
            output=self.learner.actor.output,
            env={"id": PHYSICS[self.recipe.task.physics].env_id, "kwargs": self.recipe.task.arguments},
        )

    def begin_from(self, policy: Policy) -> None:
        """Take over a policy and its normalisation of observations, which then stays as it is.

        Raises RecipeError where the recipe's network is another one, or observations cannot be normalised as
        they were.
        """
        policy, layers = policy.widened(), self.layers()
        shapes = [tuple(layer.weight.shape) for layer in layers]
        ours = (shapes, self.recipe.network.activation, self.learner.actor.output)
        if (theirs := ([w.shape for w in policy.weights], policy.activation, policy.output)) != ours:
            raise RecipeError(f"network: layers, activation and output {ours}, those to start from {theirs}")
        seen, least = self.recipe.observation, policy.deviation.min()
        if policy.clip != seen.clip:
            raise RecipeError(
                f"observation.clip = {seen.clip:g}, allowed that of the policy, {policy.clip:g}"
            )
        if least < np.float32(seen.floor):
            raise RecipeError(f"observation.floor = {seen.floor:g}, allowed the policy's, {least:g} at most")
        with torch.no_grad():
            for layer, weight, bias in zip(layers, policy.weights, policy.biases, strict=True):
                layer.weight.copy_(torch.from_numpy(weight))
                layer.bias.copy_(torch.from_numpy(bias))
        variance = np.maximum(policy.deviation.astype(np.float64) ** 2 - seen.floor**2, 0.0)
        self.normalise(policy.mean, variance)
        self._start(policy.name)

    def _start(self, name: str) -> None:
        self.started = name
        self.learner.act_from_start(self.model)

    def normalise(self, mean: Any, variance: Any) -> None:
        """Fix what observations are normalised with."""
        self.stats.mean = np.asarray(mean, np.float64)
        self.stats.var = np.asarray(variance, np.float64)
        self.envs.training = False

    def state(self) -> State:
        """All that the next leg depends on: tensors, numbers and texts."""
        stats = self.stats
        return {
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
            **self.learner.memory(self.model),
        }

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
        self.learner.remember(self.model, state)

    def layers(self) -> list[torch.nn.Linear]:
        """The policy's linear layers from observation to action."""
        return self.learner.actor.layers(self.model)


class _Watch(BaseCallback):
    """Tells of progress, logs what becomes of episodes, and keeps the actor as it is while the critic alone
    is to learn."""

    def __init__(self, on_step: OnStep, learner: Learner, ended: Counter[str]):
        super().__init__()
        self._tell, self._learner, self._ended = on_step, learner, ended
        self._critic_first: int = getattr(learner, "critic_first", 0)

    def _on_rollout_start(self) -> None:
        self._learner.before_rollout(self.model)
        self._learner.let_actor_learn(self.model, self.num_timesteps >= self._critic_first)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        if last := [infos[place] for place in np.flatnonzero(self.locals["dones"])]:
            self._log(last)
        self._tell(self.num_timesteps)
        return True

    def _log(self, infos: Sequence[Mapping[str, Any]]) -> None:
        """Means over the episodes since the last line of the log; infos: of those that are over now."""
        logger = self.logger
        failures = ["" if info["is_success"] else info["failure"] or "not_visible" for info in infos]
        self._ended.update(failures)
        sums = {f"failures/{reason}": float(failures.count(reason)) for reason in UNSOLVED}
        for name in infos[0]["episode_terms"]:
            sums[f"rewards/{name}"] = sum(info["episode_terms"][name] for info in infos)
        for name, value in sums.items():
            # as `record_mean`, which takes a call for each episode and value: too slow beside rods
            before = logger.name_to_count[name]
            count = before + len(infos)
            logger.record(name, (logger.name_to_value[name] * before + value) / count)
            logger.name_to_count[name] = count
