"""Drawings of a flap and its surroundings, its section or the scene in space; no GPU, no window."""
