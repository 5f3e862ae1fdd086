"""The benchmark's results as files: rows in CSV, a table in Markdown, charts, and one HTML page of it all."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from baselines.benchmark.charts import curve_chart, profile_chart, share_chart
from baselines.benchmark.scores import Interval, Summary, best_known, scores_by_method, summaries
from baselines.benchmark.tasks import numbers
from baselines.jobs.files import written_whole
from baselines.jobs.journal import Row
from planners.certify import FAILURES

NAME = "benchmark"
Curves = Mapping[str, Sequence[Sequence[Mapping[str, Any]]]]
"""Training's lines, by method, one list for each seed."""

LEGEND = """\
**scenes**: how many, the first of the split, where a method was not judged on all of them.
**certified**: share of scenes that the certifier passes on its mesh `{resolution}`, with the 95 %
interval over scenes and training seeds. **of ctc's**: the same among the scenes that ctc certifies.
**score**: interquartile mean of the least certified strain known for the scene over the method's, 0
where it is not certified, with its interval. **excess**: strain over the best known one, less 1; it,
**friction margin** (part of the limit that is left) and **clearance** are medians where certified.
**FEM**: equilibria computed until grasp and path were handed in; **time**: the median until then, on one
thread; what the certifier spends is left out. **decision**: mean time of one action of a policy.
**Bullet**: share of scenes where the policy succeeds in `TissueRetract-v0`, played there without
retraining."""


def write_report(
    rows: Sequence[Row],
    folder: Path,
    resolution: str,
    command: str,
    curves: Curves,
    known: Mapping[str, float],
    seed: int,
    bootstrap: int,
) -> list[Path]:
    """Write all files, or none; returns their paths. rows: of all splits; known: strains that were certified
    before, by the scene's hash; seed, bootstrap: of the intervals. Raises OSError."""
    best = best_known(rows, known)
    splits = {s: [row for row in rows if row["split"] == s] for s in dict.fromkeys(r["split"] for r in rows)}
    found = {split: summaries(of, best, seed, bootstrap) for split, of in splits.items()}
    charts: dict[str, tuple[str, bytes]] = {}
    for split, of in splits.items():
        charts[f"{NAME}-{split}-outcomes.png"] = (
            f"What becomes of each method's retractions on the split {split}, with 95 % intervals",
            share_chart(found[split]),
        )
        charts[f"{NAME}-{split}-profiles.png"] = (
            f"How near each method comes to the least strain known, on the split {split}",
            profile_chart(scores_by_method(of, best)),
        )
    if curves:
        title = "Training, judged on the validation split: every seed"
        charts[f"{NAME}-training.png"] = (title, curve_chart(curves))
    files = {
        f"{NAME}.csv": _csv(numbers(rows)).encode(),
        f"{NAME}.md": _markdown(found, resolution, command, charts).encode(),
        f"{NAME}.html": _page(found, resolution, command, charts).encode(),
        **{name: picture for name, (_, picture) in charts.items()},
    }
    with ExitStack() as all_or_none:
        for name, content in files.items():
            all_or_none.enter_context(written_whole(folder / name)).write_bytes(content)
    return [folder / name for name in files]


def table_of(summary: Sequence[Summary]) -> tuple[list[str], list[list[str]]]:
    """Head and lines of the table; columns that say nothing are left out."""
    columns = {
        "method": [s.method + (f" ({s.runs} seeds)" if s.runs > 1 else "") for s in summary],
        "scenes": [str(s.scenes) if s.scenes < _most(summary) else "" for s in summary],
        "certified": [_interval(s.certified, percent=True) for s in summary],
        "of ctc's": [_percent(s.of_reference) for s in summary],
        "failures": [_failures(s) for s in summary],
        "score": ["" if math.isnan(s.score.value) else _interval(s.score) for s in summary],
        "excess": [_percent(s.excess) for s in summary],
        "friction margin": [_percent(s.friction_margin) for s in summary],
        "clearance, mm": [_number(s.clearance * 1e3, 2) for s in summary],
        "FEM": [_number(s.evaluations, 0) for s in summary],
        "time, s": [_number(s.seconds, 2) for s in summary],
        "decision, ms": [_number(s.step_seconds * 1e3, 2) for s in summary],
        "Bullet": [_percent(s.transfer) for s in summary],
    }
    kept = {name: cells for name, cells in columns.items() if any(cells)}
    return list(kept), [list(line) for line in zip(*kept.values(), strict=True)]


def in_text(summary: Sequence[Summary]) -> str:
    """The table in Markdown."""
    head, lines = table_of(summary)
    rule = ["---"] * len(head)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, rule, *lines])


def _markdown(
    found: Mapping[str, Sequence[Summary]],
    resolution: str,
    command: str,
    charts: Mapping[str, tuple[str, bytes]],
) -> str:
    parts = ["# Benchmark", f"`{command}`", LEGEND.format(resolution=resolution)]
    for split, summary in found.items():
        parts += [f"## {split}: {_most(summary)} scenes", in_text(summary)]
        parts += [f"![{t}]({name})" for name, (t, _) in charts.items() if name.startswith(f"{NAME}-{split}-")]
    if (training := f"{NAME}-training.png") in charts:
        parts += ["## Training", f"![{charts[training][0]}]({training})"]
    return "\n\n".join(parts) + "\n"


def _page(
    found: Mapping[str, Sequence[Summary]],
    resolution: str,
    command: str,
    charts: Mapping[str, tuple[str, bytes]],
) -> str:
    legend = html.escape(LEGEND.format(resolution=resolution)).split("**")
    # every second piece stood between two stars
    legend = [f"<b>{piece}</b>" if k % 2 else piece for k, piece in enumerate(legend)]
    parts = ["<h1>Benchmark</h1>", f"<p><code>{html.escape(command)}</code></p>", f"<p>{''.join(legend)}</p>"]
    for split, summary in found.items():
        head, lines = table_of(summary)
        parts.append(f"<h2>{html.escape(split)}: {_most(summary)} scenes</h2><table><tr>")
        parts += [f"<th>{html.escape(cell)}</th>" for cell in head]
        for line in lines:
            parts += ["</tr><tr>", *(f"<td>{html.escape(cell)}</td>" for cell in line)]
        parts.append("</tr></table>")
    for title, picture in charts.values():
        data = base64.b64encode(picture).decode()
        title = html.escape(title)
        parts.append(f"<h3>{title}</h3><img alt='{title}' src='data:image/png;base64,{data}'>")
    style = (
        "body{font:15px/1.5 sans-serif;max-width:75em;margin:2em auto;padding:0 1em;color:#22282e}"
        "table{border-collapse:collapse}"
        "td,th{padding:.3em .7em;border-bottom:1px solid #c9ced3;text-align:left}"
        "img{max-width:100%}"
    )
    return (
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Benchmark</title>"
        f"<style>{style}</style><body>{''.join(parts)}</body></html>\n"
    )


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _most(summary: Sequence[Summary]) -> int:
    """Scenes of the split that was judged."""
    return max(s.scenes for s in summary)


def _failures(summary: Summary) -> str:
    """Most frequent first."""
    some = sorted((f for f in FAILURES if summary.failures[f] > 0), key=lambda f: -summary.failures[f])
    return ", ".join(f"{f.replace('_', ' ')} {_percent(summary.failures[f])}" for f in some)


def _interval(interval: Interval, percent: bool = False) -> str:
    if percent:
        return f"{_percent(interval.value)} ({100 * interval.low:.0f} to {100 * interval.high:.0f})"
    return f"{interval.value:.2f} ({interval.low:.2f} to {interval.high:.2f})"


def _percent(share: float) -> str:
    """Whole per cent, but neither 0 nor 100 for what is nearly so."""
    if math.isnan(share):
        return ""
    nearly = share not in (0, 1) and round(share, 2) in (0, 1)
    return f"{100 * share:.{1 if nearly else 0}f} %"


def _number(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"
