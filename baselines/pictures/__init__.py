"""Pictures and films of a plan."""
