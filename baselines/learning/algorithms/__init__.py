"""The algorithms that agents learn by: a module each, and a line here.

Reading a recipe needs no more than this, so what computes (torch, Stable-Baselines3) is imported inside the
algorithms' methods.
"""

from baselines.learning.algorithms.base import ALGORITHMS, Learner
from baselines.learning.algorithms.bc import BC
from baselines.learning.algorithms.ppo import PPO
from baselines.learning.algorithms.ppo_lagrangian import PPOLagrangian
from baselines.learning.algorithms.sac import SAC
from baselines.learning.algorithms.tqc import TQC

ALGORITHMS.update({"ppo": PPO, "ppo_lagrangian": PPOLagrangian, "sac": SAC, "tqc": TQC, "bc": BC})

__all__ = ["ALGORITHMS", "BC", "PPO", "SAC", "TQC", "Learner", "PPOLagrangian"]
