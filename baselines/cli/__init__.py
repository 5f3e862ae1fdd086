"""The console command `retract`, a file a command."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(args: Sequence[str] | None = None) -> int:
    """Run the command with these arguments (default: the process's) and return its exit code."""
    try:
        from baselines.cli.app import main as run  # half a second, in which Ctrl-C is as good as later

        return run(args)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return 130
