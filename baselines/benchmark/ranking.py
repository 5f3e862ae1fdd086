"""Methods ranked: the tables of a split, and what their columns mean."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from baselines.benchmark.contest import REASONS, TROUBLES
from baselines.benchmark.scores import Interval, Summary
from baselines.benchmark.splits import Benchmark
from baselines.jobs.journal import Row

RANKING = (
    "method", "certified", "survival", "excess", "at 99 % survival", "time, s", "decision, ms", "Bullet",
    "closed loop",
)  # fmt: skip
"""Columns of the table that ranks; the others say more."""
LEGEND = """\
Methods are ranked by the share of scenes where they are **certified**, then by **survival**, then by
**excess**. In brackets: 95 % intervals, by resampling scenes and training seeds; Clopper and Pearson's over
scenes for shares of all or none.

**certified**: share of scenes whose retraction the certifier passes on its mesh `{resolution}`.
**survival**: share of {draws} fresh draws of what each scene leaves unknown under which the plan still holds,
none where it is not certified; by the corrected rod, where that cannot decide by finite elements on up to
{judged} draws a plan, and by the rod's word on the others; where the rod cannot follow the plan, of the first
{judged} draws alone.
**excess**: strain over the least certified one that is known for the scene, less 1; median where certified.
**at 99 % survival**: the same with the strain that it takes to survive 99 % of the draws: the plan's own
where it does, else that of the same place and motion held more firmly; median where there is such a grip, and
the share of scenes where there is. None where survival is of the first {judged} draws alone.
**time**: median processor time until grasp and path are handed in, on one thread; {limit:g} s by the clock
are allowed, and more is a failure (`time`). **decision**: mean time of one action of a policy. **Bullet**:
share of scenes where the policy succeeds in `TissueRetract-v0`, played there without retraining.{closed_loop}

**of ctc's**: share that is certified of the scenes where ctc is. **score**: interquartile mean of the least
strain known over the method's, 0 where it is not certified. **friction margin** (part of the limit that is
left) and **clearance**: medians where certified. **FEM**: mean equilibria computed until grasp and path are
handed in. `unsure`: nothing was handed in, as the planner's own rod finds a limit broken; `unsolved`: as its
own problem had no solution. `raised`, `returned` and `died`: what became of a method whose answer cannot be
judged. Nothing here was chosen by its results on these scenes."""
CLOSED_LOOP = """
**closed loop**: share of draws, {played} a scene, on which a policy succeeds if it sees what happens.
There and on Bullet, a policy that hands nothing in on a scene has failed on it."""
YOUR_OWN = """\
Any function of a scene that returns a grasp and a path, or a policy, is judged like these: with this as a
module `mine` in the folder where it is called, by `retract benchmark --method mine:lift`.

```python
from retract_env.grasp import Grasp, JawPath


def lift(scene):
    height, length = scene.tissue.height, scene.tissue.length
    grasp = Grasp(x=-0.6 * length, compression=0.2 * height)
    poses = [(grasp.x, height / 2, 0.0, height)]  # x, y, angle, separation: at rest, closed, then the motion
    for step in range(25):
        poses.append((grasp.x, height / 2 + length * step / 24, 0.0, height - grasp.compression))
    return grasp, JawPath.from_poses(poses, "lift")
```

What else it may return, and what happens if it fails: docs/how-to-add.md, "A benchmark method"."""


def legend(benchmark: Benchmark) -> str:
    """What the columns mean."""
    return LEGEND.format(
        resolution=benchmark.resolution,
        draws=benchmark.survival.draws,
        judged=benchmark.survival.judged,
        limit=benchmark.limit,
        closed_loop=CLOSED_LOOP.format(played=benchmark.played) if benchmark.played else "",
    )


def heading(name: str, benchmark: Benchmark, rows: Sequence[Row]) -> tuple[str, str]:
    """A split's title, and which scenes and which code its rows are from."""
    found, split = len({row["number"] for row in rows}), benchmark.splits.get(name)
    code = ", ".join(sorted({row["code"] for row in rows}))
    version = ", ".join(sorted({f"version {row['split_version']}, {row['split_hash']}" for row in rows}))
    said = f"Split {name}, {version}; retract {code}."
    if split is not None and found < split.count:
        said += f" A try on the first {found} of its {split.count} scenes, not the benchmark."
    return f"{name}: {found} scenes", said


def table_of(
    summary: Sequence[Summary], names: Sequence[str] | None = None
) -> tuple[list[str], list[list[str]]]:
    """Head and lines of the table, of these columns or of all; those that say nothing are left out."""
    columns = {
        "method": [s.method + (f" ({s.runs} seeds)" if s.runs > 1 else "") for s in summary],
        "certified": [_shares(s.certified) for s in summary],
        "survival": [_shares(s.survival) for s in summary],
        "excess": [_shares(s.excess) for s in summary],
        "at 99 % survival": [_firm(s) for s in summary],
        "time, s": [_number(s.seconds, 2) for s in summary],
        "decision, ms": [_number(s.step_seconds * 1e3, 2) for s in summary],
        "Bullet": [_percent(s.transfer) for s in summary],
        "closed loop": [_shares(s.closed_loop) for s in summary],
        "of ctc's": [_percent(s.of_reference) for s in summary],
        "failures": [_failures(s) for s in summary],
        "score": [_interval(s.score) for s in summary],
        "friction margin": [_percent(s.friction_margin) for s in summary],
        "clearance, mm": [_number(s.clearance * 1e3, 2) for s in summary],
        "FEM": [_number(s.evaluations, 0) for s in summary],
    }
    kept = {n: cells for n, cells in columns.items() if any(cells) and (names is None or n in names)}
    return list(kept), [list(line) for line in zip(*kept.values(), strict=True)]


def details(summary: Sequence[Summary]) -> list[str]:
    """Columns of the table that says more."""
    head, _ = table_of(summary)
    return ["method", *(name for name in head if name not in RANKING)]


def in_text(summary: Sequence[Summary], names: Sequence[str] | None = None) -> str:
    """The table in Markdown."""
    head, lines = table_of(summary, names)
    rule = ["---"] * len(head)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, rule, *lines])


def troubles(rows: Sequence[Row]) -> list[str]:
    """What went wrong with answers that could not be judged, a line each with how often."""
    found = Counter(
        (r["method"], r["reason"] if r["reason"] in TROUBLES else "", r["detail"])
        for r in rows
        if r["reason"] in TROUBLES or r["detail"]
    )
    return [
        f"{method}: {' '.join(filter(None, (reason, detail)))}, {count} times"
        for (method, reason, detail), count in sorted(found.items(), key=lambda item: (item[0][0], -item[1]))
    ]


def _failures(summary: Summary) -> str:
    """Most frequent first."""
    some = sorted((f for f in REASONS if summary.failures[f] > 0), key=lambda f: -summary.failures[f])
    return ", ".join(f"{f.replace('_', ' ')} {_percent(summary.failures[f])}" for f in some)


def _firm(summary: Summary) -> str:
    """Of how many scenes the median is belongs to it; none at all is said too."""
    if math.isnan(summary.firm):
        return ""
    if math.isnan(summary.firm_excess.value):
        return "" if summary.firm else "none"
    some = "" if summary.firm == 1 else f", on {_percent(summary.firm)}"
    return _shares(summary.firm_excess) + some


def _interval(interval: Interval) -> str:
    if math.isnan(interval.value):
        return ""
    return f"{interval.value:.2f} ({interval.low:.2f} to {interval.high:.2f})"


def _shares(interval: Interval) -> str:
    if math.isnan(interval.value):
        return ""
    low, high = (_percent(end).removesuffix(" %") for end in (interval.low, interval.high))
    return f"{_percent(interval.value)} ({low} to {high})"


def _percent(share: float) -> str:
    """Whole per cent, but for what is nearly none or all with the digits, three at most, that show it."""
    if math.isnan(share):
        return ""
    texts = [f"{100 * share:.{digits}f}" for digits in range(4)]
    return next((text for text in texts if float(text) not in (0, 100)), texts[0]) + " %"


def _number(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"
