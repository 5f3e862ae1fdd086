"""How far the rod is from fine finite elements: python -m benchmarks.rod_distance.

Needs the sets `calibration`, `test` and `wide` of `benchmarks.rod_motions`, computed on `fine`, and compares
what else is there of them: `coarse` finite elements and PyBullet. Prints tables and writes the quantiles that
the package carries, retract_env/rod/distance.json; with --picture docs/images/rod_distance.png too.

All follow the same poses. States count while both find them within the limits of strain and friction; for the
quantiles, while the rod does. Errors are those of the rod less fine finite elements: of the lowest clearance
over the flap's length, of eps_1% (greatest so far) relative, of the required friction (greatest so far) as it
is.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import on_one_thread, progress, table
from benchmarks.rod_batch import Course, Followed, follow, friction
from benchmarks.rod_motions import COLUMNS, KINDS, SETS, motion, scene_of, stored
from retract_env.objectives import verdict
from retract_env.rod import distance
from retract_env.scene import Scene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

P = {name: i for i, name in enumerate(COLUMNS)}
LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
NEAR = {"strain": 0.06, "friction": 0.05, "clearance": 0.01}
"""Of the limit; as it is; of the length: nearer to its limits than that a motion counts as near."""
ASKED = {"clearance": "1 % (0.5 %)", "strain": "6 % (3 %)", "friction": "0.05 (0.03)"}
LONGEST = 60
"""States of any path, at most."""


@dataclass
class Pair:
    """One motion on fine finite elements and on something else."""

    name: str
    seed: int
    kind: str
    scene: Scene
    grasp: tuple[float, float]
    fine: Array
    """(n, 12) rows of COLUMNS"""
    fine_end: str
    other: Array
    """(m, 12)"""
    other_end: str
    points: Array = field(default_factory=lambda: np.empty((0, 0, 0)))

    @cached_property
    def common(self) -> slice:
        """States from the squeeze on that both reached."""
        first = int((self.fine[:, P["progress"]] < 1).sum())
        return slice(first, min(len(self.fine), len(self.other)))

    def within(self, states: Array) -> int:
        """How many of these states are, from the first on, within the limits."""
        limits = self.scene.limits
        ok = (states[:, P["strain"]] <= limits.strain) & (friction(states) <= limits.friction)
        return int(np.argmin(np.append(ok & (states[:, P["overlap"]] == 0), False)))

    def errors(self, rod_alone: bool = False) -> dict[str, Array]:
        """By quantity, (n,) of each state within the limits of both, or of the rod alone: rod less fine,
        strain over that of fine, or, where the rod alone counts, over that of the rod."""
        a, b = self.fine[self.common], self.other[self.common]
        n = self.within(b) if rod_alone else min(self.within(a), self.within(b))
        a, b = a[:n], b[:n]
        highest = np.maximum.accumulate
        strain_a, strain_b = highest(a[:, P["strain"]]), highest(b[:, P["strain"]])
        now_a, now_b = friction(a), friction(b)
        return {
            "clearance": (b[:, P["clearance"]] - a[:, P["clearance"]]) / self.scene.tissue.length,
            "strain": (strain_b - strain_a) / (strain_b if rod_alone else strain_a),
            "friction": highest(now_b) - highest(now_a) if n else now_b,
            "friction now": now_b - now_a,
        }


def pairs(name: str, other: str = "rod") -> list[Pair]:
    """A set's motions that are there on fine finite elements and on the other."""
    scenes: dict[int, Scene] = {}
    there: dict[tuple[int, str], dict[str, Any]] | None = None
    if other != "rod":
        there = {(m["seed"], m["kind"]): m for m in stored(name, other)}
    found = []
    for m in stored(name):
        if there is not None and (m["seed"], m["kind"]) not in there:
            continue
        scene = scenes.setdefault(m["seed"], scene_of(name, m["seed"]))
        o: dict[str, Any] = {"states": [], "end": ""} if there is None else there[m["seed"], m["kind"]]
        states, others = (np.array(s["states"], float).reshape(-1, len(COLUMNS)) for s in (m, o))
        grasp = (m["x"], m["compression"])
        found.append(Pair(name, m["seed"], m["kind"], scene, grasp, states, m["end"], others, o["end"]))
    if there is None:
        _follow(found)
    return [pair for pair in found if len(pair.fine)]


def _follow(found: list[Pair]) -> None:
    """The rod on all of them, to its own end."""
    courses = [Course(p.scene, p.grasp[0], p.fine[:, 0], p.fine[:, 1:5]) for p in found if len(p.fine)]
    there = [p for p in found if len(p.fine)]
    further, longer = [], []
    for pair, course, rod in zip(there, courses, follow(courses), strict=True):
        _keep(pair, rod, course)
        if not pair.other_end:
            if pair.fine_end == "end":
                pair.other_end = "end"
                continue
            # the rod goes on where fine finite elements ended
            rng = np.random.default_rng([pair.seed, KINDS.index(pair.kind)])
            poses = np.array(list(islice(motion(pair.scene, pair.kind, rng)[1], LONGEST)))
            done = max(len(course.poses) - 3, 0)
            progressed = np.concatenate([course.progress, 2.0 + np.arange(done, len(poses))])
            further.append(
                Course(pair.scene, course.x, progressed, np.concatenate([course.poses, poses[done:]]))
            )
            longer.append(pair)
    if further:
        for pair, course, rod in zip(longer, further, follow(further), strict=True):
            _keep(pair, rod, course)
            pair.other_end = pair.other_end or "end"


def _keep(pair: Pair, rod: Followed, course: Course) -> None:
    pair.other, pair.points = rod.states, rod.points * pair.scene.tissue.height
    pair.other_end = ""
    first = int((rod.states[:, 0] < 1).sum())
    for k in range(first, len(rod.states)):
        found = verdict_of(pair.scene, rod.states[k : k + 1])
        if found is not None:
            pair.other_end = found
            pair.other, pair.points = pair.other[: k + 1], pair.points[: k + 1]
            return
    if len(rod.states) < len(course.poses):
        pair.other_end = "Diverged"


def verdict_of(scene: Scene, states: Array, shift: tuple[float, float] = (0.0, 0.0)) -> str | None:
    """What settles a motion first among states (n, 12). shift: by so many NEAR strain and friction, and
    clearance, are larger than they are."""
    limits = scene.limits
    loads, rise = shift[0], shift[1] * NEAR["clearance"] * scene.tissue.length
    for state, needed in zip(states, friction(states), strict=True):
        found = verdict(
            state[P["strain"]] * (1 + loads * NEAR["strain"]),
            needed + loads * NEAR["friction"],
            state[P["clearance"]] + rise,
            limits.strain,
            limits.friction,
            limits.clearance,
            bool(state[P["overlap"]]),
        )
        if found is not None:
            return found
    return None


def far_from_limits(pair: Pair) -> bool:
    """Whether fine finite elements say the same of every state if it is shifted by NEAR to whatever side."""
    states = pair.fine[pair.common.start :]
    shifts = [(loads, rise) for loads in (-1.0, 1.0) for rise in (-1.0, 1.0)]
    before = {verdict_of(pair.scene, states[:-1], shift) for shift in shifts}
    last = {verdict_of(pair.scene, states[-1:], shift) or "end" for shift in shifts}
    return before == {None} and last == {pair.fine_end}


def _of_kind(kind: str) -> Callable[[Pair], bool]:
    return lambda pair: pair.kind == kind


GROUPS: dict[str, Callable[[Pair], bool]] = {
    "all": lambda _: True,
    **{kind: _of_kind(kind) for kind in KINDS},
    "no vein": lambda p: not p.scene.tissue.veins,
    "1 to 9 veins": lambda p: 0 < len(p.scene.tissue.veins) < 10,
    "10 and more": lambda p: len(p.scene.tissue.veins) >= 10,
}


def error_table(found: Sequence[Pair]) -> str:
    """Quantiles of the errors of states, by kind of path and number of veins."""
    rows = []
    errors = [(pair, pair.errors()) for pair in found]
    for label, chosen in GROUPS.items():
        of = [e for pair, e in errors if chosen(pair) and len(e["strain"])]
        if not of:
            continue
        cells: list[object] = [label, len(of), sum(len(e["strain"]) for e in of)]
        for name in ("clearance", "strain", "friction", "friction now"):
            values = np.concatenate([e[name] for e in of])
            scale, digits = (100, 2) if name == "clearance" else (100, 1) if name == "strain" else (1, 3)
            worst = values[np.abs(values).argmax()]
            quantiles = "/".join(f"{scale * v:.{digits}f}" for v in np.percentile(values, [5, 50, 95]))
            cells += [
                quantiles,
                f"{scale * np.percentile(np.abs(values), 95):.{digits}f}",
                f"{scale * worst:.{digits}f}",
            ]
        rows.append(cells)
    head = ["5/50/95 %", "95 % of abs", "worst"]
    names = ("clearance, % of length", "eps max, %", "friction", "friction now")
    return table(["motions of", "motions", "states", *(f"{n} {h}" for n in names for h in head)], rows)


def broken(pair: Pair) -> set[str]:
    """All that fine finite elements say of the state that settles a motion: of several broken limits
    `verdict` tells one. A jaw that pulls slips too."""
    if pair.fine_end in ("ok", "end"):
        return {pair.fine_end}
    state, limits = pair.fine[-1], pair.scene.limits
    slips = bool(friction(pair.fine[-1:])[0] > limits.friction)
    strained = bool(state[P["strain"]] > limits.strain)
    named = {"slip": slips, "release": slips, "strain": strained, "contact": state[P["overlap"]] > 0}
    return {pair.fine_end, *(name for name, so in named.items() if so)}


def confusion(found: Sequence[Pair], other: str) -> str:
    """How motions end on both, and how often that agrees."""
    ends = Counter((pair.fine_end, pair.other_end) for pair in found)
    columns = sorted({b for _, b in ends})
    rows = [[a, *(ends[a, b] for b in columns)] for a in sorted({a for a, _ in ends})]
    ways: dict[str, Callable[[Pair], bool]] = {
        "the same name": lambda p: p.fine_end == p.other_end,
        "a limit that is broken": lambda p: p.other_end in broken(p),
        "ok or not": lambda p: (p.fine_end == "ok") == (p.other_end == "ok"),
    }
    solved = [p for p in found if p.fine_end not in ("Diverged", "MeshError")]
    shares = []
    for of, chosen in (("all", solved), ("far from the limits", [p for p in solved if far_from_limits(p)])):
        agree = [[way(p) for p in chosen] for way in ways.values()]
        shares.append(
            [of, len(chosen), *(f"{100 * np.mean(a):.1f} % ({len(a) - sum(a)} not)" for a in agree)]
        )
    shown = table([f"fine \\ {other}", *columns], rows)
    return shown + "\n\n" + table(["agree on", "motions", *ways], shares)


def worst_cases(found: Sequence[Pair], count: int = 6) -> str:
    """The motions with the largest errors of each quantity."""
    rows = []
    for name in ("clearance", "strain", "friction"):
        errors = [(np.abs(e[name]), e[name], pair) for pair in found if len((e := pair.errors())[name])]
        for size, signed, pair in sorted(errors, key=lambda item: -float(item[0].max()))[:count]:
            k = int(size.argmax())
            state, height = pair.fine[pair.common][k], pair.scene.tissue.height
            shown = f"{100 * signed[k]:+.1f} %" if name != "friction" else f"{signed[k]:+.3f}"
            where = [f"{v:.2f}" for v in (pair.grasp[0] / height, pair.grasp[1] / height, state[P["theta"]])]
            veins = len(pair.scene.tissue.veins)
            rows.append([name, shown, pair.seed, pair.kind, veins, f"{state[0]:g}", *where])
    return table(["error of", "size", "seed", "path", "veins", "progress", "x/h", "c", "theta"], rows)


def differing(found: Sequence[Pair]) -> str:
    """Motions far from the limits of which the rod says what fine finite elements do not."""
    rows = [
        [p.seed, p.kind, len(p.scene.tissue.veins), p.fine_end, p.other_end, len(p.fine), len(p.other)]
        for p in found
        if far_from_limits(p) and p.other_end not in broken(p)
    ]
    return table(["seed", "path", "veins", "fine", "rod", "states", "rod's"], rows) if rows else "none"


def scores(found: Sequence[Pair]) -> dict[str, dict[str, dict[str, Array]]]:
    """By unit, quantity and side: each motion's, or flap's, worst of what fine has more than the rod.

    Lower sides come with their sign turned, so that more is worse; a motion without a state counts as no
    error.
    """
    by_motion: dict[str, dict[str, list[float]]] = {
        q: {s: [] for s in distance.SIDES} for q in distance.QUANTITIES
    }
    for pair in found:
        errors = pair.errors(rod_alone=True)
        for name in distance.QUANTITIES:
            more = -np.append(errors[name], 0.0) if not len(errors[name]) else -errors[name]
            by_motion[name]["upper"].append(float(more.max()))
            by_motion[name]["lower"].append(float((-more).max()))
            by_motion[name]["two-sided"].append(float(np.abs(more).max()))
    seeds = np.array([pair.seed for pair in found])
    motions = {q: {s: np.array(v) for s, v in sides.items()} for q, sides in by_motion.items()}
    flaps = {
        q: {s: np.array([v[seeds == seed].max() for seed in np.unique(seeds)]) for s, v in sides.items()}
        for q, sides in motions.items()
    }
    return {"motion": motions, "flap": flaps}


def quantiles(found: Sequence[Pair], test: Sequence[Pair]) -> tuple[dict[str, Any], str]:
    """What distance.json has, and a table of it."""
    known, unseen = scores(found), scores(test)
    data: dict[str, Any] = {"levels": list(LEVELS), "sizes": {}, "quantiles": {}, "covered": {}}
    rows = []
    for unit, by_quantity in known.items():
        data["sizes"][unit] = {
            "calibration": len(by_quantity["strain"]["upper"]),
            "test": len(unseen[unit]["strain"]["upper"]),
        }
        data["quantiles"][unit], data["covered"][unit] = {}, {}
        for name, sides in by_quantity.items():
            data["quantiles"][unit][name], data["covered"][unit][name] = {}, {}
            for side, errors in sides.items():
                values = [distance.quantile(errors, level) for level in LEVELS]
                covered = [float((unseen[unit][name][side] <= v).mean()) for v in values]
                sign = -1.0 if side == "lower" else 1.0
                data["quantiles"][unit][name][side] = [
                    round(sign * v, 6) if math.isfinite(v) else None for v in values
                ]
                data["covered"][unit][name][side] = [round(v, 4) for v in covered]
                cells = [f"{sign * v:.4f} ({100 * s:.1f} %)" for v, s in zip(values, covered, strict=True)]
                rows.append([f"{unit}, {name}, {side}", *cells])
    return data, table(["fine less rod", *(f"{100 * level:g} %" for level in LEVELS)], rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--picture", action="store_true", help="draw docs/images/rod_distance.png, by fine solves"
    )
    options = parser.parse_args(arguments)
    missing = [name for name in ("calibration", "test", "wide") if not stored(name)]
    if missing:
        sys.exit(f"nothing on disk of {', '.join(missing)}: python -m benchmarks.rod_motions makes it")
    progress("following the sets on the rod")
    calibration, test, wide = (pairs(name) for name in ("calibration", "test", "wide"))
    for name, found in (("calibration", calibration), ("test", test), ("wide", wide)):
        flaps = len({p.seed for p in found})
        print(f"\n{name}: {len(found)} motions of {flaps} flaps of {SETS[name][1]}\n\n{error_table(found)}\n")
        print(confusion(found, "rod"))
    asked = ", ".join(f"{name} {value}" for name, value in ASKED.items())
    print(f"\nasked (tried for) of the 95 %: {asked}\n\nthe worst of test\n\n{worst_cases(test)}")
    print(f"\nfar from the limits, with another end\n\n{differing(test)}")
    for label in ("coarse", "bullet"):
        found = pairs("test", label)
        if found:
            chosen = {(p.seed, p.kind) for p in found}
            print(f"\n{label}: {len(found)} motions of test\n\n{error_table(found)}\n")
            print(confusion(found, label))
            if len(found) < len(test):
                print(f"\nthe rod on those\n\n{error_table([p for p in test if (p.seed, p.kind) in chosen])}")
    data, text = quantiles(calibration, test)
    distance.MEASURED.write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    print(f"\nquantiles of calibration (and the share of test that they cover)\n\n{text}")
    if options.picture:
        from benchmarks.rod_picture import draw

        draw(test)


if __name__ == "__main__":
    on_one_thread("benchmarks.rod_distance", sys.argv[1:])
    main(sys.argv[1:])
