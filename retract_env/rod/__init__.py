"""The flap as a planar rod: its cross-sections, veins included."""
