"""The algorithms that agents learn by: a module each, and a line here.

Reading a recipe needs no more than this, so what computes (torch, Stable-Baselines3) is imported inside the
algorithms' methods.
"""

from baselines.learning.algorithms.base import Learner
from baselines.learning.algorithms.bc import BC
from baselines.learning.algorithms.ppo import PPO
from baselines.learning.algorithms.sac import SAC
from baselines.learning.algorithms.tqc import TQC

ALGORITHMS: dict[str, type[Learner]] = {"ppo": PPO, "sac": SAC, "tqc": TQC, "bc": BC}
"""By the name that recipes and the console use."""

__all__ = ["ALGORITHMS", "BC", "PPO", "SAC", "TQC", "Learner"]
