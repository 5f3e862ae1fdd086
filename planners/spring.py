"""The spring model under the name that planners know it by; `retract_env.spring` holds it, as the environment
shows k_eq and takes its best grasp too."""

from __future__ import annotations

from retract_env.spring import Basin, SpringModel, optimal_compression

__all__ = ["Basin", "SpringModel", "optimal_compression"]
