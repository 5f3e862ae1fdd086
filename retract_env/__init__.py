"""What tissue is and how it behaves: scenes, grasps, meshes, physics and the objectives of a retraction.

Importing the package registers an environment with Gymnasium for every physics: `TissueRetract-v0`,
`TissueRetractFEM-v0`, `TissueRetractRod-v0`. So it loads gymnasium, also for who only plans: an id that is
not registered does not exist, and `gym.make("retract_env:TissueRetract-v0")` imports this package and nothing
more of it. That costs 0.07 s beyond numpy, which everything here needs; nothing heavier is imported.
"""

from gymnasium.envs.registration import register, registry

from retract_env.physics.registry import PHYSICS, PhysicsKind

__version__ = "0.1.0"


def register_physics(kind: PhysicsKind) -> None:
    """Add a physics, and its environment to Gymnasium; one of the same name is replaced."""
    PHYSICS[kind.name] = kind
    if kind.env_id not in registry:  # a reload would be warned of
        # Without max_episode_steps: the environment itself ends an episode, since it shows the time that is
        # left, and its spec says after how many steps. A limit given here would cut off longer tasks.
        register(
            id=kind.env_id,
            entry_point="retract_env.env:TissueRetractEnv",
            vector_entry_point=kind.vector,
            kwargs={"physics": kind.name},
        )


for _kind in tuple(PHYSICS.values()):
    register_physics(_kind)
