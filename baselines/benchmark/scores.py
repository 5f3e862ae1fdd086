"""What rows of the benchmark say of each method: shares, margins, and interquartile means with intervals.

The score of a method on a scene is the least certified strain known there over its own, so 1 for the best
and 0 where it is not certified. Interquartile means over scenes and training seeds, and
their 95 % bootstrap intervals, are rliable's (Agarwal et al., NeurIPS 2021).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.jobs.journal import Row
from planners.certify import FAILURES

Array = NDArray[np.float64]

REFERENCE = "ctc"
"""The paper's planner; the scenes where it certifies a retraction are those that others should solve too."""


@dataclass(frozen=True)
class Interval:
    """An estimate and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Summary:
    """One method on one split."""

    method: str
    runs: int
    scenes: int
    certified: Interval
    """share of scenes"""
    of_reference: float
    """share of those scenes that the reference certifies, nan without it"""
    failures: dict[str, float]
    """share of each failure"""
    score: Interval
    """interquartile mean; nan where no best strain is known"""
    excess: float
    """median of strain over the best known one, less 1, where certified; nan where never, or none is known"""
    friction_margin: float
    """median part of the friction limit that is left, where certified"""
    clearance: float
    """m, median at the end, where certified"""
    evaluations: float
    """mean equilibria computed until grasp and path were handed in"""
    seconds: float
    """median time until then"""
    step_seconds: float
    """mean time of a policy's decision, nan for planners"""
    transfer: float
    """share of scenes where the policy succeeds on Bullet, nan where not asked"""


def summaries(
    rows: Sequence[Row], best: Mapping[str, float] | None, seed: int, bootstrap: int
) -> list[Summary]:
    """One for each method, most certified first, then by score. The rows are those of one split.

    best: strain to compare with, by the scene's hash; None where there is none for some scene: then there
    are no scores. seed, bootstrap: of the intervals.
    """
    table = _tables(rows)
    reference = {row["number"] for row in rows if row["method"] == REFERENCE and row["certified"]}
    certified = intervals({n: _values(t, _certified) for n, t in table.items()}, np.mean, seed, bootstrap)
    middle = dict.fromkeys(table, Interval(np.nan, np.nan, np.nan))
    if best is not None:
        middle = intervals(scores_by_method(rows, best), interquartile_mean, seed, bootstrap)
    found = [_summary(name, table[name], certified[name], middle[name], best, reference) for name in table]
    return sorted(found, key=lambda s: (-s.certified.value, -s.score.value, s.method))


def best_known(rows: Sequence[Row], known: Mapping[str, float]) -> dict[str, float]:
    """Least certified strain of each scene, by its hash: of these rows and of what was known before."""
    best = dict(known)
    for row in rows:
        if row["certified"]:
            best[row["scene_hash"]] = min(best.get(row["scene_hash"], np.inf), row["max_strain"])
    return best


def score(row: Row, best: Mapping[str, float]) -> float:
    """Best known strain over the row's own; 0 where it is not certified."""
    return best[row["scene_hash"]] / row["max_strain"] if row["certified"] else 0.0


def scores_by_method(rows: Sequence[Row], best: Mapping[str, float]) -> dict[str, Array]:
    """(runs, scenes) scores of each method, over the scenes that it was judged on."""
    return {name: _values(table, lambda row: score(row, best)) for name, table in _tables(rows).items()}


def interquartile_mean(scores: Array) -> float:
    """Mean of the middle half of all scores."""
    from rliable.metrics import aggregate_iqm

    return float(aggregate_iqm(scores))


def intervals(
    values: dict[str, Array], statistic: Callable[[Array], Any], seed: int, bootstrap: int
) -> dict[str, Interval]:
    """Statistic of each (runs, scenes) array, and its 95 % interval over resampled runs and scenes."""
    from rliable.library import get_interval_estimates

    # rliable draws from NumPy's global generator, even where it is given one
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        points, ends = get_interval_estimates(
            values, lambda x: np.array([statistic(x)]), task_bootstrap=True, reps=bootstrap
        )
    finally:
        np.random.set_state(state)  # noqa: NPY002
    return {n: Interval(float(points[n][0]), float(ends[n][0, 0]), float(ends[n][1, 0])) for n in values}


def _tables(rows: Sequence[Row]) -> dict[str, list[list[Row]]]:
    """Rows of each method by run, then by scene."""
    found: dict[str, list[list[Row]]] = {}
    for name in dict.fromkeys(row["method"] for row in rows):
        place = {(row["run"], row["number"]): row for row in rows if row["method"] == name}
        runs, scenes = (sorted({key[k] for key in place}) for k in (0, 1))
        found[name] = [[place[run, number] for number in scenes] for run in runs]
    return found


def _values(matrix: list[list[Row]], value: Callable[[Row], float]) -> Array:
    return np.array([[value(row) for row in run] for run in matrix], np.float64)


def _certified(row: Row) -> float:
    return float(row["certified"])


def _summary(
    name: str,
    matrix: list[list[Row]],
    certified: Interval,
    middle: Interval,
    best: Mapping[str, float] | None,
    reference: set[int],
) -> Summary:
    rows = [row for run in matrix for row in run]
    good = [row for row in rows if row["certified"]]
    asked = [row for row in rows if row["number"] in reference]
    played = [row for row in rows if row["transfer"] is not None]
    decisions = sum(row["decisions"] for row in rows)
    spent = sum(row["timing"]["decision_seconds"] for row in rows)

    def median(values: list[float]) -> float:
        return float(np.median(values)) if values else np.nan

    def share(some: Sequence[Row], of: Sequence[Row]) -> float:
        return len(some) / len(of) if of else np.nan

    return Summary(
        method=name,
        runs=len(matrix),
        scenes=len(matrix[0]),
        certified=certified,
        of_reference=share([row for row in asked if row["certified"]], asked),
        failures={f: share([row for row in rows if row["reason"] == f], rows) for f in FAILURES},
        score=middle,
        excess=np.nan if best is None else median([1 / score(row, best) - 1 for row in good]),
        friction_margin=median([1 - row["required_friction"] / row["friction_limit"] for row in good]),
        clearance=median([row["clearance"] for row in good]),
        evaluations=float(np.mean([row["evaluations"] for row in rows])),
        seconds=median([row["timing"]["seconds"] for row in rows]),
        step_seconds=spent / decisions if decisions else np.nan,
        transfer=share([row for row in played if row["transfer"] == "ok"], played),
    )
