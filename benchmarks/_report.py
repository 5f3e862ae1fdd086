"""What the benchmarks print: the machine that they ran on, and tables in Markdown."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from retract_env.threads import ONE_THREAD, cores

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "numba", "netgen-mesher", "pypardiso")
BUSY = 0.5
"""load over which times are not to be trusted"""


def machine() -> str:
    """One line, and another where the machine is busy with something else."""
    parts = [_processor(), f"{cores()} cores", platform.system(), f"Python {platform.python_version()}"]
    for name in PACKAGES:
        try:
            parts.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            parts.append(f"no {name}")
    text = ", ".join(parts)
    if hasattr(os, "getloadavg") and os.getloadavg()[0] > BUSY:
        text += f"\nbusy: load {os.getloadavg()[0]:.1f} before the start, so times will be too long"
    return text


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table, columns aligned; floats with three digits."""
    cells = [list(head), *([_cell(value) for value in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    rule = ["-" * (w - 1) + (":" if k else "-") for k, w in enumerate(widths)]
    aligned = [
        [c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        for row in (cells[0], rule, *cells[1:])
    ]
    return "\n".join("| " + " | ".join(row) + " |" for row in aligned)


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def progress(text: str) -> None:
    """Say on standard error what is being done."""
    print(f"  {text} ...", file=sys.stderr, flush=True)


def on_one_thread(module: str, arguments: Sequence[str]) -> None:
    """Run the module again in a process whose linear algebra has one thread, unless this is such a one.

    NumPy reads these variables when it is first imported. Does not return where a process was started.
    """
    if any(os.environ.get(name) != "1" for name in ONE_THREAD):
        environment = os.environ | dict.fromkeys(ONE_THREAD, "1")
        command = [sys.executable, "-m", module, *arguments]
        sys.exit(subprocess.run(command, env=environment, cwd=ROOT).returncode)
