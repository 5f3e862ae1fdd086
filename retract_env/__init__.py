"""What tissue is and how it behaves: scenes, grasps, meshes, physics and the objectives of a retraction.

Importing the package registers the environments `TissueRetract-v0` and `TissueRetractFEM-v0` with Gymnasium.
"""

from gymnasium.envs.registration import register, registry

__version__ = "0.1.0"

for _name, _physics in (("TissueRetract-v0", "bullet"), ("TissueRetractFEM-v0", "fem")):
    if _name not in registry:  # a reload would be warned of
        register(
            id=_name,
            entry_point="retract_env.env:TissueRetractEnv",
            # The environment itself ends an episode there (task.MAX_STEPS), since it shows the time that is
            # left; here it is for tools that ask the spec.
            max_episode_steps=64,
            kwargs={"physics": _physics},
        )
