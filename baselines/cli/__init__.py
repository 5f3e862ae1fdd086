"""The console command `retract`, a file a command."""

from baselines.cli.app import main

__all__ = ["main"]
