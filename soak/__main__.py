"""`python -m soak [PART ...]`: try it very often, and say what happened. It goes on where it was stopped."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from baselines.jobs.files import write_json, written_whole
from baselines.jobs.journal import Row, Work
from baselines.jobs.told import run_told
from baselines.jobs.version import code_version
from benchmarks._report import machine
from retract_env.threads import cores
from soak.bugs import BUGS, bug_tasks, planted
from soak.caches import cache_tasks, compiled
from soak.damaged import file_tasks, read
from soak.episodes import episode_tasks, grown, played
from soak.guided import guided, guided_tasks
from soak.interruptions import stop_tasks, stopped
from soak.outcomes import WRONG
from soak.plans import followed, path_tasks, plan_tasks, planned

PARTS: Mapping[str, tuple[int, Callable[[int, str], list[dict[str, Any]]], Work]] = {
    "plans": (2000, plan_tasks, planned),
    "paths": (2000, path_tasks, followed),
    "rod": (10_000, lambda count, code: episode_tasks("rod", count, code), played),
    "fem": (2000, lambda count, code: episode_tasks("fem", count, code), played),
    "bullet": (200, lambda count, code: episode_tasks("bullet", count, code), played),
    "files": (10_000, file_tasks, read),
    "guided": (20_000, guided_tasks, guided),
    "stops": (20, stop_tasks, stopped),
    "caches": (3, cache_tasks, compiled),
    "bugs": (len(BUGS), bug_tasks, planted),
}
"""How often each part tries, at length; its tasks, and what does one."""


def main(arguments: Sequence[str]) -> int:
    """Exit code: 1 where something that may not happen did."""
    parser = argparse.ArgumentParser(prog="python -m soak", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all if none is given")
    parser.add_argument(
        "--share", type=float, default=1.0, help="of the tries that a part makes, for a short run"
    )
    parser.add_argument("--jobs", type=int, default=cores(), help="processes")
    parser.add_argument(
        "--out", type=Path, default=Path("out/soak"), help="folder for journals and soak.json"
    )
    asked = parser.parse_args(arguments)
    if unknown := [part for part in asked.parts if part not in PARTS]:
        parser.error(f"unknown {', '.join(unknown)}, allowed {', '.join(PARTS)}")
    if not 0 < asked.share <= 1 or asked.jobs < 1:
        parser.error("allowed: a --share in (0, 1], at least 1 of --jobs")
    asked.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, dict[str, Any]] = {}
    bad = 0
    try:
        for part in asked.parts or PARTS:
            count, tasks_of, work = PARTS[part]
            tasks = tasks_of(max(1, round(asked.share * count)), code_version())
            if not tasks:
                print(f"{part}: skipped, what it needs is not installed")
                continue
            rows = run_told(tasks, work, asked.out / f"{part}.jsonl", asked.jobs, False, part, Console())
            found[part] = summary(tasks, rows)
            bad += len(found[part]["wrong"])
            print(told(part, found[part]))
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    _keep(asked.out / "soak.json", found)
    return 1 if bad else 0


def _keep(file: Path, found: Mapping[str, dict[str, Any]]) -> None:
    """Write what parts came to, with where; what the file says of other parts stays."""
    before = json.loads(file.read_text("utf-8")) if file.exists() else {}
    where = {"code": code_version(), "machine": machine()}
    parts = {part: before[part] for part in PARTS if part in before}
    with written_whole(file) as temporary:
        write_json(temporary, parts | {part: where | of for part, of in found.items()})


def summary(tasks: Sequence[Mapping[str, Any]], rows: Sequence[Row]) -> dict[str, Any]:
    """What a part came to, in numbers."""
    out: dict[str, Any] = {"tried": len(rows), "outcomes": dict(Counter(row["outcome"] for row in rows))}
    inner: Counter[str] = Counter()
    for row in rows:
        inner.update(row.get("tried", {}))
    if inner:
        out["within"] = dict(inner)
    blocks = [row for row in rows if "slowest" in row]
    if blocks:
        out["steps"] = sum(row["steps"] for row in blocks)
        out["slowest_s"] = max(row["slowest"] for row in blocks)
        out["memory_mb"] = [round(row["after"]["memory"] / 2**20, 1) for row in (blocks[0], blocks[-1])]
        out["files"] = [row["after"]["files"] for row in (blocks[0], blocks[-1])]
    wrong = [(task, row) for task, row in zip(tasks, rows, strict=True) if row["outcome"] in WRONG]
    out["wrong"] = [
        _which(task) | {"outcome": row["outcome"], "detail": row["detail"]} for task, row in wrong
    ]
    if blocks and (more := grown(blocks[0]["after"], blocks[-1]["after"])):
        out["wrong"].append({"outcome": "unsound", "detail": f"from the first block to the last: {more}"})
    return out


def told(part: str, found: Mapping[str, Any]) -> str:
    """A part's summary as lines."""
    wrong = found["wrong"]
    good = {name: value for name, value in found.items() if name != "wrong"}
    lines = [f"{part}: {json.dumps(good)}", *(f"  WRONG {json.dumps(one)}" for one in wrong[:20])]
    return "\n".join(lines + ([f"  and {len(wrong) - 20} more"] if len(wrong) > 20 else []))


def _which(task: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in task.items() if name not in ("code", "limit")}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
