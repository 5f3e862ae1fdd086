"""The benchmark's results as files: rows in CSV, the ranking in Markdown, charts, one HTML page of it all."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.benchmark.charts import curve_chart, profile_chart, share_chart
from baselines.benchmark.ranking import (
    RANKING,
    YOUR_OWN,
    details,
    heading,
    in_text,
    legend,
    table_of,
    troubles,
)
from baselines.benchmark.scores import Summary, best_known, scores_by_method, summaries
from baselines.benchmark.splits import Benchmark
from baselines.benchmark.tasks import numbers
from baselines.jobs.files import csv_text, written_whole
from baselines.jobs.journal import Row

NAME = "benchmark"
Curves = Mapping[str, Sequence[Sequence[Mapping[str, Any]]]]
"""Training's lines, by method, one list for each seed."""
Charts = Mapping[str, tuple[str, bytes]]
"""Title and PNG by the file's name."""
STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:75em;margin:2em auto;padding:0 1em;color:#22282e}"
    "table{border-collapse:collapse}"
    "td,th{padding:.3em .7em;border-bottom:1px solid #c9ced3;text-align:left}"
    "img{max-width:100%}pre{background:#f4f5f6;padding:.7em}"
)


@dataclass(frozen=True)
class Ranked:
    """A split's results."""

    title: str
    said: str
    """which scenes, which code"""
    summary: list[Summary]
    troubles: list[str]


def write_report(
    rows: Sequence[Row],
    folder: Path,
    benchmark: Benchmark,
    command: str,
    curves: Curves,
    known: Mapping[str, float],
) -> list[Path]:
    """Write all files, or none; returns their paths. rows: of all splits; known: strains that were certified
    before, by the scene's hash. Raises OSError."""
    best = best_known(rows, known)
    splits = {s: [row for row in rows if row["split"] == s] for s in dict.fromkeys(r["split"] for r in rows)}
    ranked: dict[str, Ranked] = {}
    charts: dict[str, tuple[str, bytes]] = {}
    for split, of in splits.items():
        found = summaries(of, best, benchmark.seed, benchmark.bootstrap)
        ranked[split] = Ranked(*heading(split, benchmark, of), found, troubles(of))
        charts[f"{NAME}-{split}-outcomes.png"] = (
            f"What becomes of each method's retractions on the split {split}, with 95 % intervals",
            share_chart(found),
        )
        charts[f"{NAME}-{split}-profiles.png"] = (
            f"How near each method comes to the least strain known, on the split {split}",
            profile_chart(scores_by_method(of, best)),
        )
    if curves:
        title = "Training, judged on the validation split: the mean of seeds, and their range"
        charts[f"{NAME}-training.png"] = (title, curve_chart(curves))
    files = {
        f"{NAME}.csv": csv_text(numbers(rows)).encode(),
        f"{NAME}.md": _markdown(ranked, benchmark, command, charts).encode(),
        f"{NAME}.html": _page(ranked, benchmark, command, charts).encode(),
        **{name: picture for name, (_, picture) in charts.items()},
    }
    with ExitStack() as all_or_none:
        for name, content in files.items():
            all_or_none.enter_context(written_whole(folder / name)).write_bytes(content)
    return [folder / name for name in files]


def _markdown(ranked: Mapping[str, Ranked], benchmark: Benchmark, command: str, charts: Charts) -> str:
    parts = ["# Benchmark", f"`{command}`", legend(benchmark)]
    for split, one in ranked.items():
        parts += [f"## {one.title}", one.said, in_text(one.summary, RANKING)]
        parts += ["More of the same:", in_text(one.summary, details(one.summary))]
        if one.troubles:
            parts += ["Answers that could not be judged:", "\n".join(f"* {line}" for line in one.troubles)]
        parts += [f"![{t}]({name})" for name, (t, _) in charts.items() if name.startswith(f"{NAME}-{split}-")]
    if (training := f"{NAME}-training.png") in charts:
        parts += ["## Training", f"![{charts[training][0]}]({training})"]
    return "\n\n".join([*parts, "## Your own", YOUR_OWN]) + "\n"


def _page(ranked: Mapping[str, Ranked], benchmark: Benchmark, command: str, charts: Charts) -> str:
    parts = ["<h1>Benchmark</h1>", f"<p><code>{html.escape(command)}</code></p>", _told(legend(benchmark))]
    for one in ranked.values():
        parts += [f"<h2>{html.escape(one.title)}</h2><p>{_inline(one.said)}</p>"]
        parts += [_table(one.summary, RANKING), "<p>More of the same:</p>"]
        parts += [_table(one.summary, details(one.summary))]
        if one.troubles:
            lines = "".join(f"<li>{_inline(line)}</li>" for line in one.troubles)
            parts.append(f"<p>Answers that could not be judged:</p><ul>{lines}</ul>")
    for title, picture in charts.values():
        data = base64.b64encode(picture).decode()
        title = html.escape(title)
        parts.append(f"<h3>{title}</h3><img alt='{title}' src='data:image/png;base64,{data}'>")
    parts += ["<h2>Your own</h2>", _told(YOUR_OWN)]
    return (
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Benchmark</title>"
        f"<style>{STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _table(summary: Sequence[Summary], names: Sequence[str]) -> str:
    head, lines = table_of(summary, names)
    rows = ["".join(f"<th>{_inline(cell)}</th>" for cell in head)]
    rows += ["".join(f"<td>{_inline(cell)}</td>" for cell in line) for line in lines]
    return f"<table><tr>{'</tr><tr>'.join(rows)}</tr></table>"


def _told(text: str) -> str:
    """Paragraphs of Markdown as far as the texts here use it: two stars, backticks, one listing of code."""
    before, fence, rest = text.partition("```python\n")
    code, _, after = rest.partition("```")
    parts = []
    for prose in (before, after):
        parts.append("".join(f"<p>{p}</p>" for p in _inline(prose).split("\n\n") if p.strip()))
    return f"<pre>{html.escape(code)}</pre>".join(parts) if fence else parts[0]


def _inline(text: str) -> str:
    """Markdown's two stars and backticks, as far as texts, tables and lists here use them, as HTML."""
    marked = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", html.escape(text), flags=re.DOTALL)
    return re.sub(r"`(.+?)`", r"<code>\1</code>", marked, flags=re.DOTALL)
