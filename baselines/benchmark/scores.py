"""What rows of the benchmark say of each method: shares, margins, and interquartile means with intervals.

The score of a method on a scene is the least certified strain known there over its own, so 1 for the best
and 0 where it is not certified. Interquartile means over scenes and training seeds are rliable's (Agarwal et
al., NeurIPS 2021). The 95 % intervals are of bootstrap samples that draw whole seeds and whole scenes: a seed
drawn anew for each scene would average out what one seed is like on all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.benchmark.contest import REASONS
from baselines.jobs.journal import Row

Array = NDArray[np.float64]

REFERENCE = "ctc"
"""The paper's planner; the scenes where it certifies a retraction are those that others should solve too."""


@dataclass(frozen=True)
class Interval:
    """An estimate and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


UNKNOWN = Interval(np.nan, np.nan, np.nan)


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
    excess: Interval
    """median of strain over the best known one, less 1, where certified; nan where never, or none is known"""
    survival: Interval
    """mean share of draws that plans survive, none where not certified; nan where not asked"""
    firm_excess: Interval
    """as excess, of the strain with a grip of which nearly all draws survive, where there is one"""
    firm: float
    """share of scenes where there is one; nan where survival was not asked"""
    closed_loop: Interval
    """mean share of draws on which a policy that acts step by step succeeds, nan where not asked"""
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

    @property
    def rank(self) -> tuple[float, float, float, str]:
        """Tables are sorted by it: certified, then survival, then excess, then the name."""
        nothing = np.nan_to_num(self.survival.value, nan=0.0)
        excess = np.nan_to_num(self.excess.value, nan=np.inf)
        return (-self.certified.value, -float(nothing), float(excess), self.method)


def summaries(
    rows: Sequence[Row], best: Mapping[str, float] | None, seed: int, bootstrap: int
) -> list[Summary]:
    """One for each method, in the order of their ranks. The rows are those of one split.

    best: strain to compare with, by the scene's hash; None where there is none for some scene: then there
    are no scores. seed, bootstrap: of the intervals.
    """
    rows = _with_what_was_not_played(rows)
    table = _tables(rows)
    reference = {row["number"] for row in rows if row["method"] == REFERENCE and row["certified"]}

    def all_over(value: Callable[[Row], float], statistic: Callable[[Array], Any]) -> dict[str, Interval]:
        """Of each method, over the rows for which there is a value; UNKNOWN where there is none."""
        values = {name: _values(matrix, value) for name, matrix in table.items()}
        return {name: _interval(v, statistic, seed, bootstrap) for name, v in values.items()}

    def share(value: Callable[[Row], float]) -> dict[str, Interval]:
        """Likewise the mean of shares, with an interval also where all are alike."""
        return {n: _where_all_are_alike(i, table[n]) for n, i in all_over(value, _mean_known).items()}

    certified = share(_certified)
    survival = share(lambda row: _number(row["survival"]))
    closed_loop = share(lambda row: _number(row["closed_loop"]))
    middle = excess = firm = dict.fromkeys(table, UNKNOWN)
    if best is not None:
        middle = all_over(lambda row: score(row, best), interquartile_mean)
        excess = all_over(lambda row: _excess(row, "max_strain", best), _median_known)
        firm = all_over(lambda row: _excess(row, "firm_strain", best), _median_known)
    found = [
        _summary(
            matrix,
            reference,
            method=name,
            certified=certified[name],
            score=middle[name],
            excess=excess[name],
            survival=survival[name],
            firm_excess=firm[name],
            closed_loop=closed_loop[name],
        )
        for name, matrix in table.items()
    ]
    return sorted(found, key=lambda s: s.rank)


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


def _with_what_was_not_played(rows: Sequence[Row]) -> list[Row]:
    """The rows, with a failure where a method that plays elsewhere handed nothing in: by crashing on hard
    scenes it would else leave them out of what is said of its play."""
    failed = {"closed_loop": 0.0, "transfer": "not_played"}
    plays = {(row["method"], name) for row in rows for name in failed if row[name] is not None}
    return [
        row
        if row["max_strain"] is not None
        else row | {n: f for n, f in failed.items() if row[n] is None and (row["method"], n) in plays}
        for row in rows
    ]


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


def _interval(values: Array, statistic: Callable[[Array], Any], seed: int, bootstrap: int) -> Interval:
    """Of (runs, scenes) values, nan where there is none; over resampled runs and scenes."""
    whole = float(statistic(values))
    if np.isnan(whole):
        return UNKNOWN
    rng, (runs, scenes) = np.random.default_rng(seed), values.shape
    found = [
        float(statistic(values[np.ix_(rng.integers(runs, size=runs), rng.integers(scenes, size=scenes))]))
        for _ in range(bootstrap)
    ]
    known = [whole if np.isnan(one) else one for one in found]  # where a sample left out all that is known
    low, high = np.percentile(known, [2.5, 97.5])
    return Interval(whole, float(low), float(high))


def _where_all_are_alike(share: Interval, matrix: list[list[Row]]) -> Interval:
    """A share that is all or none on every scene, with Clopper and Pearson's interval for so many scenes:
    samples of what is all alike know of no other value."""
    if share.value not in (0, 1):
        return share
    from scipy.stats import binomtest

    scenes = len(matrix[0])
    ends = binomtest(round(share.value * scenes), scenes).proportion_ci(0.95)
    return Interval(share.value, float(ends.low), float(ends.high))


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _excess(row: Row, strain: str, best: Mapping[str, float]) -> float:
    """A strain over the best one known, less 1; nan where not certified, or there is none."""
    if not row["certified"] or row[strain] is None:
        return np.nan
    return float(row[strain]) / best[row["scene_hash"]] - 1


def _mean_known(values: Array) -> float:
    """Mean of what is known; nan where nothing is, as in a sample that left it out."""
    known = values[~np.isnan(values)]
    return float(np.mean(known)) if len(known) else np.nan


def _median_known(values: Array) -> float:
    """Likewise the median."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else np.nan


def _summary(matrix: list[list[Row]], reference: set[int], **found: Any) -> Summary:
    rows = [row for run in matrix for row in run]
    good = [row for row in rows if row["certified"]]
    asked = [row for row in rows if row["number"] in reference]
    played = [row for row in rows if row["transfer"] is not None]
    drawn = [row for row in rows if row["survival"] is not None]
    decisions = sum(row["decisions"] for row in rows)
    spent = sum(row["timing"]["decision_seconds"] for row in rows)

    def median(values: list[float]) -> float:
        return float(np.median(values)) if values else np.nan

    def share(some: Sequence[Row], of: Sequence[Row]) -> float:
        return len(some) / len(of) if of else np.nan

    return Summary(
        runs=len(matrix),
        scenes=len(matrix[0]),
        of_reference=share([row for row in asked if row["certified"]], asked),
        failures={f: share([row for row in rows if row["reason"] == f], rows) for f in REASONS},
        firm=share([row for row in drawn if row["firm_strain"] is not None], drawn),
        friction_margin=median([1 - row["required_friction"] / row["friction_limit"] for row in good]),
        clearance=median([row["clearance"] for row in good]),
        evaluations=float(np.mean([row["evaluations"] for row in rows])),
        seconds=median([s for row in rows if (s := row["timing"]["seconds"]) is not None]),
        step_seconds=spent / decisions if decisions else np.nan,
        transfer=share([row for row in played if row["transfer"] == "ok"], played),
        **found,
    )
