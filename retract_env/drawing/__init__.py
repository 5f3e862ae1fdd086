"""Drawings of a flap's section and of its surroundings, for every picture; no GPU, no window."""
