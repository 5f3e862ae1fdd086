"""Behaviour cloning: the policy class of an algorithm, fitted to demonstrations by least squares."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecNormalize

from baselines.learning.agents import Agent, OnStep, State
from baselines.learning.demos import Demos, load_demos
from baselines.learning.envs import seed_of
from retract_env.task import SLICES, STIFFNESS_SAMPLES

if TYPE_CHECKING:
    from baselines.learning.algorithms.bc import BC
    from baselines.learning.recipe import Recipe

TOLD = 200
"""Gradient steps between words of progress."""


class Cloner(Agent):
    """An agent whose steps are gradient steps on demonstrations; its environments only judge it."""

    def __init__(self, recipe: Recipe, how: BC, envs: VecNormalize, seed: int, demos: Demos):
        """how: the recipe's learner."""
        super().__init__(recipe, envs, seed)
        self.how = how
        self.contents = {"dataset": demos.hash}
        self._seen = seen = demos.observations
        self.normalise(seen.mean(axis=0, dtype=np.float64), seen.var(axis=0, dtype=np.float64))
        self._targets = torch.from_numpy(demos.actions.copy())
        choosing = torch.from_numpy(seen[:, SLICES["holding"]] == 0)
        # the third number of a grasp has no meaning
        self._weights = torch.where(choosing, torch.tensor([1.0, 1.0, 0.0]) * self.how.grasp_weight, 1.0)
        parameters = [p for layer in self.layers() for p in layer.parameters()]
        self.optimizer = torch.optim.AdamW(
            parameters, self.how.learning_rate, weight_decay=self.how.weight_decay
        )

    @classmethod
    def of(cls, recipe: Recipe, envs: VecNormalize, seed: int, demos: int | None) -> Cloner:
        """As `Agent.of`."""
        how = cast("BC", recipe.learner)
        return cls(recipe, how, envs, seed, load_demos(how.dataset, demos))

    def learn(self, steps: int, on_step: OnStep) -> None:
        """So many gradient steps on batches drawn from the run's seed and the steps done."""
        rng = torch.Generator().manual_seed(seed_of(self.seed, self.steps))
        seen, count, size = self._normalised(), len(self._targets), self.how.batch_size
        for _ in range(steps):
            for group in self.optimizer.param_groups:
                group["lr"] = self.rate()
            batch = torch.randint(count, (size,), generator=rng)
            inputs = seen[batch]
            inputs[:, SLICES["k_eq"]] += self.how.stiffness_noise * torch.randn(
                (size, STIFFNESS_SAMPLES), generator=rng
            )
            error = self._mean_action(inputs) - self._targets[batch]
            weights = self._weights[batch]
            loss = (weights * error**2).sum() / weights.sum()
            self.optimizer.zero_grad()
            torch.autograd.backward(loss)
            self.optimizer.step()
            self.model.num_timesteps += 1
            if self.steps % TOLD == 0:
                on_step(self.steps)
                self.record({"train/loss": float(loss.detach())})
        on_step(self.steps)

    def state(self) -> State:
        """As the agent's, and the optimiser."""
        return super().state() | {"cloning": self.optimizer.state_dict()}

    def restore(self, state: State) -> None:
        """The inverse of `state`. Raises as the agent's."""
        super().restore(state)
        self.optimizer.load_state_dict(state["cloning"])

    def _normalised(self) -> torch.Tensor:
        """(n, SIZE) what the network sees of the demonstrations.

        One that began from a policy keeps that one's normalisation, which is not the data set's.
        """
        floor, clip = self.recipe.observation.floor, self.recipe.observation.clip
        deviation = np.sqrt(self.stats.var + floor**2)
        normal = np.clip((self._seen - self.stats.mean) / deviation, -clip, clip)
        return torch.from_numpy(normal.astype(np.float32))

    def _mean_action(self, inputs: torch.Tensor) -> torch.Tensor:
        """(n, 3), as `Policy` computes it, but not clipped: beyond the limits there is no gradient."""
        layers = self.layers()
        squash = torch.tanh if self.recipe.network.activation == "tanh" else torch.relu
        x = inputs
        for layer in layers[:-1]:
            x = squash(layer(x))
        x = layers[-1](x)
        return torch.tanh(x) if self.learner.actor.output == "tanh" else x
