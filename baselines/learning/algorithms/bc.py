"""Behaviour cloning: least squares between the policy's mean action and the demonstrated one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BeforeValidator

from baselines.learning.algorithms.base import ALGORITHMS, Actor, Learner
from baselines.learning.fields import Count, Share, Weight
from retract_env.config import Name, brief, refusal

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize


def _actors() -> dict[str, Actor]:
    """Policies that can be cloned into, by their algorithms."""
    return {name: kind.ACTOR for name, kind in ALGORITHMS.items() if kind.ACTOR is not None}


def _has_an_actor(value: Any) -> Any:
    if not isinstance(value, str) or value not in _actors():
        raise refusal(f" = {brief(value)}, allowed {', '.join(_actors())}")
    return value


class BC(Learner):
    """Behaviour cloning, by AdamW."""

    AGENT: ClassVar[str] = "baselines.learning.cloning:Cloner"

    policy: Annotated[str, BeforeValidator(_has_an_actor)]
    """The algorithm whose policy it fits, so that this one can go on from the result."""
    dataset: Name
    """A Minari data set."""
    batch_size: Count
    weight_decay: Share
    grasp_weight: Weight
    """How many times a move the choice of the grasp counts: there is one in an episode."""
    stiffness_noise: Weight
    """Deviation of the noise on the normalised k_eq: half of the observation, of which little depends."""

    @property
    def actor(self) -> Actor:
        return _actors()[self.policy]

    def build(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        return self.actor.untrained(envs, shape, seed)
