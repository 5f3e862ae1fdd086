"""Commands that are stopped, or find no room on the disk: nothing is half written; going on ends alike."""

from __future__ import annotations

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image, ImageSequence

from baselines.jobs.journal import Journal, Row, WorkItem

RETRACT = [sys.executable, "-c", "from baselines.cli import main; import sys; sys.exit(main())"]
LONGEST = 1800.0
"""s, for a command that nobody stops."""
PATIENCE = 120.0
"""s that a command may go on for once it is interrupted."""
ROOM = 4096
"""bytes, at which a file may not grow any more where the disk is full"""
ENDS = ("interrupt", "kill", "full disk")
LOST = "Exception ignored on calling ctypes callback"
"""What Python says of an interrupt that comes while LLVM compiles: it is lost, and the command goes on."""


@dataclass(frozen=True)
class Command:
    """One that is run to its end, stopped, and run again."""

    arguments: tuple[str, ...]
    """{out}: the folder that it writes into, {before}: one with a plan in it"""
    again: tuple[str, ...] = ()
    """arguments with which a run goes on that has begun, where they are others"""
    timing: tuple[str, ...] = ()
    """files and folders whose content depends on the time that the work took, or on where it lies"""


COARSE = ("--resolution", "coarse")
COMMANDS: Mapping[str, Command] = {
    "plan": Command(
        ("plan", "homogeneous", "--planner", "circular", *COARSE, "--workers", "1", "--out", "{out}")
    ),
    "certify": Command(("certify", "{before}/plan.json", *COARSE, "--out", "{out}/certificate.json")),
    "view": Command(("view", "{before}", "--out", "{out}/view.html")),
    "reproduce": Command(
        ("reproduce", "fig7", *COARSE, "--workers", "2", "--out", "{out}"), timing=("fig7.md",)
    ),
    "evaluate": Command(
        ("evaluate", "--policy", "ppo-0", "--split", "validation", "--scenes", "2", "--jobs", "1")
    ),
    "benchmark": Command(
        (
            *("benchmark", "--method", "eased", "--method", "nothing", "--split", "validation:2"),
            *("--jobs", "2", "--out", "{out}"),
        ),
        timing=("benchmark.csv", "benchmark.md", "benchmark.html"),
    ),
    "demos": Command(
        (
            *("demos", "--dataset", "soak/it-v0", "--planner", "circular", "--count", "2", *COARSE),
            *("--jobs", "1", "--journal", "{out}/demos.jsonl"),
        ),
        timing=("data",),
    ),
    "train": Command(
        ("train", "ppo", "--steps", "8192", "--envs", "32", "--out", "{out}/run"),
        ("train", "ppo", "--resume", "--out", "{out}/run"),
        ("run/run.json", "run/checkpoint.pt", "run/curve.csv", "run/tensorboard", "run/policy/policy.json"),
    ),
}


def stop_tasks(times: int, code: str) -> list[dict[str, Any]]:
    """Every command, stopped in every way, so many times at a random moment."""
    return [
        {"part": "stops", "command": name, "end": end, "number": number, "code": code}
        for number in range(times)
        for name in COMMANDS
        for end in ENDS
    ]


def stopped(task: WorkItem) -> Row:
    """What is left of a command that was stopped, and what it comes to when it is run again."""
    command, rng = COMMANDS[task["command"]], np.random.default_rng([task["number"], ENDS.index(task["end"])])
    with tempfile.TemporaryDirectory() as parent:
        before = Path(parent) / "before"
        plan = COMMANDS["plan"].arguments
        if any("{before}" in argument for argument in command.arguments):
            _run(_filled(plan, before, before), before)
        whole, cut = Path(parent) / "whole", Path(parent) / "cut"
        start = time.monotonic()
        code, errors = _run(_filled(command.arguments, whole, before), whole)
        took = time.monotonic() - start
        if code != 0:
            return _wrong(f"undisturbed it ends with {code}: {errors}")
        after = float(rng.uniform(0.05, 0.95)) * took
        arguments = _filled(command.arguments, cut, before)
        row: Row = {"after": after / took, "exit": None}
        try:
            code, errors = _run(arguments, cut, task["end"], after)
        except subprocess.TimeoutExpired:
            return _wrong(f"{task['end']}: still at work {PATIENCE:.0f} s later") | row
        row["exit"] = code
        if fault := _said(task["end"], code, errors) or _half_written(cut):
            return _wrong(fault) | row
        if command.again and (cut / "run" / "run.json").exists():
            again = _filled(command.again, cut, before)
        else:
            again = arguments
        code, errors = _run(again, cut)
        if code != 0:
            return _wrong(f"run again it ends with {code}: {errors}") | row
        if different := _different(whole, cut, command.timing):
            return _wrong(f"run again it comes to other {', '.join(different)}") | row
    return {"outcome": "went on", "detail": "", **row}


def _wrong(what: str) -> Row:
    return {"outcome": "unsound", "detail": what[-600:]}


def _filled(arguments: tuple[str, ...], out: Path, before: Path) -> list[str]:
    return [argument.format(out=out, before=before) for argument in arguments]


def _run(arguments: list[str], out: Path, end: str = "", after: float = LONGEST) -> tuple[int, str]:
    """Exit code and what was said on standard error; data sets are kept in the folder too.

    Raises TimeoutExpired where it does not end when it is stopped.
    """
    environment = os.environ | {"MINARI_DATASETS_PATH": str(out / "data")}
    with subprocess.Popen(
        [*RETRACT, *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_no_room if end == "full disk" else None,
    ) as process:
        try:
            _, errors = process.communicate(timeout=after if end in ("interrupt", "kill") else LONGEST)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT if end == "interrupt" else signal.SIGKILL)
            _, errors = process.communicate(timeout=PATIENCE)
        finally:
            with suppress(ProcessLookupError):  # what it began, where it hangs
                os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, errors.strip()


def _no_room() -> None:
    """No file may grow beyond ROOM, as on a disk that is full."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))


def _said(end: str, code: int, errors: str) -> str:
    """What is wrong with how it ended."""
    allowed = {"interrupt": (0, 130), "kill": (0, -signal.SIGKILL), "full disk": (0, 2)}[end]
    if code not in allowed:
        return f"{end}: exit {code}: {errors}"
    if errors.count("Traceback") > errors.count(LOST):
        return f"{end}: a traceback: {errors}"
    if end == "full disk" and code == 2 and len(errors.splitlines()) != 1:
        return f"{end}: not one line: {errors}"
    return ""


def _half_written(folder: Path) -> str:
    """A file that is there, has no temporary name and cannot be read."""
    for path in sorted(folder.rglob("*")) if folder.exists() else ():
        try:
            if path.suffix == ".jsonl":
                Journal(path)
            elif path.suffix in READERS and not path.name.startswith("."):
                READERS[path.suffix](path)
        except UNREADABLE as problem:
            return f"{path.name}: {problem}"
    return ""


def _page(path: Path) -> None:
    if not path.read_text("utf-8").rstrip().endswith("</html>"):
        raise ValueError("it has no end")


def _table(path: Path) -> None:
    text = path.read_text("utf-8")
    columns = {len(row) for row in csv.reader(text.splitlines(keepends=True), strict=True)}
    if not text.endswith("\n") or len(columns) > 1:
        raise ValueError("it has no end")


def _picture(path: Path) -> None:
    """Every frame; Pillow takes a film that ends too soon for a shorter one."""
    with Image.open(path) as picture:
        picture.verify()
    with Image.open(path) as picture:
        for frame in ImageSequence.Iterator(picture):
            frame.load()
    if path.suffix == ".gif" and not path.read_bytes().endswith(b";"):
        raise ValueError("it has no end")


READERS: Mapping[str, Callable[[Path], object]] = {
    ".json": lambda path: json.loads(path.read_text("utf-8")),
    ".yaml": lambda path: yaml.safe_load(path.read_text("utf-8")),
    ".csv": _table,
    ".html": _page,
    ".png": _picture,
    ".gif": _picture,
}
UNREADABLE = (ValueError, csv.Error, yaml.YAMLError, OSError, SyntaxError)
"""What they raise; the last two are Pillow's."""


def _different(whole: Path, cut: Path, timing: tuple[str, ...]) -> list[str]:
    """Names of files that are not the same, but for what depends on time, and what is hidden."""

    def content(folder: Path) -> dict[str, bytes]:
        return {
            name: path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
            and not (name := path.relative_to(folder).as_posix()).startswith(".")
            and not any(name == one or name.startswith(f"{one}/") for one in timing)
            and path.suffix != ".jsonl"
        }

    one, other = content(whole), content(cut)
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
