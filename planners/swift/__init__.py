"""Grasp, grip and path together, on the rod, on all flaps that a scene may turn out to be: "swift"."""
