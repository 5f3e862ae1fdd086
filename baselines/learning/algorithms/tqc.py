"""Truncated quantile critics (Kuznetsov et al., 2020), as sb3-contrib has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import model_validator

from baselines.learning.algorithms.sac import SAC
from retract_env.config import refusal, whole

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize
    from typing_extensions import Self


class TQC(SAC):
    """Truncated quantile critics: soft actor-critic that mistrusts its most hopeful quantiles."""

    critics: Annotated[int, whole(1, 10)]
    quantiles: Annotated[int, whole(1, 200)]
    dropped: Annotated[int, whole(0, 199)]
    """Quantiles dropped from each critic."""

    @model_validator(mode="after")
    def _some_are_left(self) -> Self:
        if self.dropped >= self.quantiles:
            raise refusal(f".dropped = {self.dropped}, allowed fewer than quantiles = {self.quantiles}")
        return self

    def build(self, envs: VecNormalize, shape: dict[str, Any], seed: int) -> Any:
        from sb3_contrib import TQC as SB3TQC

        shape = shape | {"n_quantiles": self.quantiles, "n_critics": self.critics}
        return self.soft(SB3TQC, envs, shape, seed, top_quantiles_to_drop_per_net=self.dropped)
