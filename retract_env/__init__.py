"""What tissue is and how it behaves: scenes, grasps, meshes, physics and the objectives of a retraction."""

__version__ = "0.1.0"
