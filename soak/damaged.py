"""Damaged files: each is read, or refused in one line, in bounded time and memory; nothing in it is run."""

from __future__ import annotations

import json
import resource
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.benchmark.splits import load_benchmark
from baselines.cli.certify import read_certificate, read_plan
from baselines.cli.console import BadInput
from baselines.jobs.files import write_json
from baselines.jobs.journal import Journal, Row, WorkItem
from baselines.learning.policies import load_policy, policy_folder
from baselines.learning.recipe import load_recipe
from planners import certify
from planners.base import plan_to_json
from planners.paths import PATHS
from retract_env.config import config_file
from retract_env.errors import ConfigError
from retract_env.grasp import Grasp
from retract_env.scene import load_scene
from soak.outcomes import apart, refused

BLOCK = 200
"""Files that are one piece of work."""
LIMIT = 600.0
"""s, for a block."""
LONGEST = 20.0
"""s of processor time that a file may take."""
MOST_MEMORY = 4 * 2**30
"""bytes that the process may have while it reads"""

BOMB = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n".encode() for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
EVIL = (
    *(b"", b"\0", b"\xff\xfe", b"nan", b"-.inf", b"1e999", b"9" * 5000, b"0x" + b"f" * 400, b"12:30:45"),
    *(b"2001-01-01", b"[" * 5000, b"{" * 5000, b'{"a":' * 3000, b"- " * 2000, b"&a [*a]", b"<<: *a", BOMB),
    *(b"!!python/object/apply:os.system ['touch pwned']", b"true", b"null", b'"\\ud800"', b"\t", b"? "),
    *(b"../../../../etc/passwd", b"\xe2\x80\xae", b"--- ", b"...", b"%YAML 9.9\n---\n"),
)
"""What is put in the place of something else."""

Read = Callable[[Path], object]
READERS: Mapping[str, Read] = {
    "scene": load_scene,
    "recipe": load_recipe,
    "benchmark": load_benchmark,
    "plan": read_plan,
    "certificate": read_certificate,
    "policy": lambda path: load_policy(path.parent),
    "tensors": lambda path: load_policy(path.parent),
    "journal": Journal,
}

YAML = {
    "scene": ("ten_veins", "scenes"),
    "recipe": ("ppo_robust", "train"),
    "benchmark": ("benchmark", ""),
}
"""Shipped files, by name and folder."""


def file_tasks(damaged: int, code: str) -> list[dict[str, Any]]:
    """So many damaged files of each kind."""
    return [
        {
            "part": "files",
            "kind": kind,
            "first": first,
            "count": min(BLOCK, damaged - first),
            "limit": LIMIT,
            "code": code,
        }
        for first in range(0, damaged, BLOCK)
        for kind in READERS
    ]


def read(task: WorkItem) -> Row:
    """What becomes of a block of damaged files."""
    return apart(_read, task, task["limit"])


def _read(task: dict[str, Any]) -> Row:
    kind = task["kind"]
    name, sound, beside = sound_file(kind)
    counted = {"read": 0, "refused": 0}
    with suppress(ValueError, OSError):  # where the system knows no such limit
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    with tempfile.TemporaryDirectory() as folder:
        for other, content in beside.items():
            (Path(folder) / other).write_bytes(content)
        path, known = Path(folder) / name, {name, *beside}
        for number in range(task["first"], task["first"] + task["count"]):
            path.write_bytes(damage(sound, np.random.default_rng([number, 3])))
            start = resource.getrusage(resource.RUSAGE_SELF).ru_utime
            try:
                READERS[kind](path)
                counted["read"] += 1
            except (ConfigError, BadInput) as problem:
                counted["refused"] += 1
                if (said := refused(ValueError(str(problem))))["outcome"] != "refused":
                    return said | {"detail": f"{kind} {number}: {said['detail']}"}
            except Exception as problem:
                return {
                    "outcome": "raised",
                    "detail": f"{kind} {number}: {type(problem).__name__}: {problem}"[:500],
                }
            if (spent := resource.getrusage(resource.RUSAGE_SELF).ru_utime - start) > LONGEST:
                return {"outcome": "time", "detail": f"{kind} {number}: {spent:.1f} s"}
            if extra := {p.name for p in Path(folder).iterdir()} - known:
                return {"outcome": "unsound", "detail": f"{kind} {number}: left {sorted(extra)}"}
    return {"outcome": "ended", "detail": "", "tried": counted}


def damage(sound: bytes, rng: np.random.Generator) -> bytes:
    """The content with an injury, or a few."""
    content = bytearray(sound)
    for _ in range(int(rng.geometric(0.6))):
        size = len(content)
        a, b = sorted(int(i) for i in rng.integers(0, size + 1, 2))
        b = min(b, a + int(rng.integers(1, 200)))
        kind = rng.integers(0, 8)
        if kind == 0:  # bits
            for i in rng.integers(0, max(size, 1), 4):
                if i < size:
                    content[i] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del content[a:b]
        elif kind == 2:
            content[a:a] = content[a:b] * int(rng.integers(1, 20))
        elif kind == 3:
            del content[a:]
        elif kind in (4, 5):
            content[a:b] = EVIL[int(rng.integers(0, len(EVIL)))]
        else:
            _in_the_place_of_a_number(content, rng)
    return bytes(content)


def _in_the_place_of_a_number(content: bytearray, rng: np.random.Generator) -> None:
    digits = [i for i, c in enumerate(content) if chr(c).isdigit()]
    if not digits:
        return
    a = b = digits[int(rng.integers(0, len(digits)))]
    while b < len(content) and chr(content[b]) in "0123456789.eE+-":
        b += 1
    evil = [
        b"nan",
        b"-1",
        b"0",
        b"1e308",
        b"1e-308",
        b"-0.0",
        b"Infinity",
        b"1" * 400,
        b"null",
        b'"x"',
        b"[]",
        b"{}",
        b"true",
    ]
    content[a:b] = evil[int(rng.integers(0, len(evil)))]


@cache
def sound_file(kind: str) -> tuple[str, bytes, dict[str, bytes]]:
    """A file's name and content before it is damaged, and what lies beside it."""
    if kind in YAML:
        return "it.yaml", config_file(*YAML[kind]).read_bytes(), {}
    if kind in ("policy", "tensors"):
        folder = policy_folder("ppo-0")
        content = {name: (folder / name).read_bytes() for name in ("policy.json", "policy.safetensors")}
        damaged = "policy.json" if kind == "policy" else "policy.safetensors"
        return damaged, content.pop(damaged), content
    if kind == "journal":
        lines = [json.dumps({"key": f"{i:064x}", "row": {"value": i / 7}}) for i in range(5)]
        return "it.jsonl", ("\n".join(lines) + "\n").encode(), {}
    scene, grasp = load_scene("homogeneous"), Grasp(-0.03, 5e-4)
    path = PATHS["ctc"](scene, grasp)
    if kind == "plan":
        return "plan.json", json.dumps(plan_to_json(scene, "ctc", grasp, path, "coarse")).encode(), {}
    with tempfile.TemporaryDirectory() as parent:
        file = Path(parent) / "certificate.json"
        write_json(file, certify(scene, grasp, path, "coarse").to_json())
        return file.name, file.read_bytes(), {}
