"""A result of our own: what each planner's plans strain, and how often they hold where the tissue, the grip
or the line of sight are not quite as the scene says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baselines.benchmark.splits import load_benchmark
from baselines.jobs.journal import Row
from baselines.paper.experiments import Experiment
from baselines.paper.study import Claim, Report, Study, paper_scene
from baselines.paper.survival import BY_ROD, lightest, planned
from baselines.pictures.robustness import draw
from baselines.pictures.robustness_said import QUESTION, said, tabulated
from retract_env.scene import Scene

FLAPS = 100
"""of the benchmark's test split"""
STANDARD = ("homogeneous", "ten_veins", "twenty_veins")
DRAWS, FLAP_DRAWS = 100, 40
"""for each plan, on finite elements: on a standard scene, on a test flap"""
HOPELESS = 0.9
"""On test flaps, the survival by the rod below which the robust statement is not asked for."""
FIRST_SEED = 52_100_000
"""of the draws; each scene has its own, so that draws of several may be counted together"""
METHODS: dict[str, tuple[str, float]] = {
    "eased": ("eased", 1.0),
    "swift": ("swift", 1.0),
    "swift_force": ("swift_force", 1.0),
    "swift_exact": ("swift", 0.0),
    "ctc": ("ctc", 1.0),
    "fem_gradient": ("fem_gradient", 1.0),
    "circular": ("circular", 1.0),
}
"""The planner of each, and how many times as wide as the scene's the prior is that it plans for; quick ones
first."""
LIGHTEST = {"ctc_lightest": "ctc", "circular_lightest": "circular"}
STANDARD_METHODS = ("light_grip", "elastica")
"""Which take minutes: on the standard scenes alone."""
DEMANDS = (0.25, 0.5, 0.75, 1.25)
"""Times as wide as the scene's is the prior that `swift` plans for, to draw a frontier; with 0 and 1 that are
among METHODS."""
FRONTIER_FLAPS = 20
"""Test flaps that the frontier is drawn for."""


def methods_of(scene: Scene, name: str, seed: int, count: int, standard: bool) -> list[Experiment]:
    """All methods on one scene."""
    on = _on(scene, seed, count, standard)
    others = {name: (name, 1.0) for name in STANDARD_METHODS} if standard else {}
    closed = on if standard else {**on, "hopeless": 1.0}  # 99 % survive, which is less than is stated
    return [
        *(_planned(on, name, method, *how) for method, how in METHODS.items()),
        *(
            Experiment(lightest, {**closed, "path": path}, {"scene": name, "method": method, "demand": 1.0})
            for method, path in LIGHTEST.items()
        ),
        *(_planned(on, name, method, *how) for method, how in others.items()),
    ]


def frontier_of(scene: Scene, name: str, seed: int, count: int) -> list[Experiment]:
    """`swift` at several demands on one scene."""
    on = _on(scene, seed, count, standard=True)
    return [_planned(on, name, "swift", "swift", demand) for demand in DEMANDS]


def _on(scene: Scene, seed: int, count: int, standard: bool) -> dict[str, Any]:
    """What the work on a scene has in common."""
    return {
        "scene": scene.dump(),
        "count": count,
        "seed": seed,
        "hopeless": 0.0 if standard else HOPELESS,
    }


def _planned(on: dict[str, Any], name: str, method: str, planner: str, prior: float) -> Experiment:
    label = {"scene": name, "method": method, "demand": prior}
    return Experiment(planned, {**on, "planner": planner, "prior": prior}, label)


def robustness_experiments(
    standard: Sequence[str], flaps: int, count: int, flap_count: int
) -> list[Experiment]:
    """What is most telling comes first: the standard scenes, then one test flap after the other.

    count, flap_count: draws for each plan, on a standard scene and on a test flap.
    """
    test = load_benchmark("benchmark").splits["test"].scenes(flaps)
    seeds = range(FIRST_SEED, FIRST_SEED + len(standard) + len(test))
    named = [(paper_scene(name), name) for name in standard]
    named += [(scene, f"test {number}") for number, scene in enumerate(test)]
    every = [(*one, seed) for one, seed in zip(named, seeds, strict=True)]
    known, random = every[: len(standard)], every[len(standard) :]
    return [
        *(e for one in known for e in methods_of(*one, count, standard=True)),
        *(e for one in known for e in frontier_of(*one, count)),
        *(e for one in random for e in methods_of(*one, flap_count, standard=False)),
        *(e for one in random[:FRONTIER_FLAPS] for e in frontier_of(*one, 0)),
    ]


def _experiments() -> list[Experiment]:
    return robustness_experiments(STANDARD, FLAPS, DRAWS, FLAP_DRAWS)


def _report(rows: Sequence[Row]) -> Report:
    return Report(
        "Strain against survival",
        QUESTION.format(draws=max(row["draws"] for row in rows), by_rod=BY_ROD),
        tabulated(rows),
        draw(rows, STANDARD),
        [Claim(*one) for one in said(rows, STANDARD)],
    )


STUDY = Study("robustness", "what plans strain, and what they survive", _experiments, _report)
