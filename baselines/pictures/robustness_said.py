"""What the study `robustness` says in words: its table, and claims with what was found.

No number depends on what is here, so that rows that took hours outlive a better wording.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Row = Mapping[str, Any]
Said = tuple[str, str, Literal["yes", "in part", "no"]]
Array = NDArray[np.float64]

QUESTION = (
    "Every plan is certified at the resolution below and then judged on flaps that are not quite as the "
    "scene says: stiffness, Poisson's ratio, weight, thickness, friction, the place of the grasp, how far "
    "or how hard the jaws close, and the line of sight, all drawn from the default prior "
    "([docs/robustness.md](../robustness.md)). Up to {draws} fresh draws a plan are followed by coarse "
    "finite elements; one survives if that retraction ends well. `ctc` and `circular` close by Eq. 5; the "
    "same paths from the same grasp *as lightly as survives* are closed by the least compression with which "
    "99 % of {by_rod} draws survive by the corrected rod, which compares the two paths at equal survival. "
    "`swift` grips by position, by force, and with exact knowledge: planned as if all were known, judged as "
    "the others. The frontier is `swift` planning for a prior of 0 to 1.25 times the default width."
)
ENOUGH = 0.99
NEAR = 0.02
"""Strains that differ by less than this part count as equal."""
COLUMNS = (
    "scene", "method", "demand", "part", "x", "compression", "force", "reason", "max_strain",
    "required_friction", "clearance", "holds", "bound", "stated_failures", "by_rod", "draws", "survived",
    "ends",
)  # fmt: skip


def tabulated(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Each plan, and after one that was closed as lightly as survives the compressions that were tried."""
    table = []
    for row in rows:
        table.append({name: "" if row.get(name) is None else row[name] for name in COLUMNS})
        for rung in row.get("ladder", ()):
            known = {
                "scene": row["scene"],
                "method": f"{row['method']}, tried",
                "by_rod": rung["survival"],
                **{name: rung[name] for name in ("part", "compression", "reason", "max_strain")},
            }
            table.append(dict.fromkeys(COLUMNS, "") | known)
    return table


def said(rows: Sequence[Row], standard: Sequence[str]) -> list[Said]:
    """Claims of the study, those that the rows tell something of."""
    found = [
        _held(rows, "swift", "closing by position"),
        _held(rows, "swift_force", "closing by force"),
        _spares(rows, "swift", 0.5),
        _spares(rows, "swift_force", 0.42),
        _paths_by_eq5(rows),
        _paths_at_equal_survival(rows, standard),
        _wisdom(rows),
        _fragile(rows),
        _exact(rows),
        _statement(rows),
    ]
    return [claim for claim in found if claim is not None]


def of_method(rows: Sequence[Row], method: str, flaps: bool = True) -> dict[str, Row]:
    """Rows of one method by scene, at the demand that it is known for; flaps: of the test flaps, if any."""
    demand = 0.0 if method == "swift_exact" else 1.0
    mine = {r["scene"]: r for r in rows if r["method"] == method and r["demand"] == demand}
    test = {scene: row for scene, row in mine.items() if scene.startswith("test")}
    return test if flaps and test else mine


def planned(rows: Mapping[str, Row]) -> dict[str, Row]:
    """Those whose plan is certified."""
    return {scene: row for scene, row in rows.items() if row["reason"] == "ok"}


def counted(rows: Mapping[str, Row]) -> tuple[int, int]:
    """Draws that survived, and all: of plans that are certified."""
    good = [row for row in planned(rows).values() if row["draws"]]
    return sum(row["survived"] for row in good), sum(row["draws"] for row in good)


def shared(rows: Sequence[Row], *methods: str) -> set[str]:
    """The scenes of which there is a row of each of these methods: what is said of several is said there."""
    return set.intersection(*(set(of_method(rows, method)) for method in methods))


def among(rows: Mapping[str, Row], scenes: Collection[str]) -> dict[str, Row]:
    """Those of these scenes."""
    return {scene: row for scene, row in rows.items() if scene in scenes}


def share(part: int, whole: int) -> str:
    """98.5 % of 200."""
    return f"{100 * part / whole:.2f} % of {whole}" if whole else "of none"


def ratios(rows: Sequence[Row], above: str, below: str, equal: bool = False) -> Array:
    """Strain of one method over that of another, on the scenes that both are certified on; equal: and where
    both survive enough by the rod."""
    one, other = planned(of_method(rows, above)), planned(of_method(rows, below))
    both = [s for s in one if s in other]
    if equal:
        both = [s for s in both if min(one[s]["by_rod"], other[s]["by_rod"]) >= ENOUGH]
    return np.array([one[s]["max_strain"] / other[s]["max_strain"] for s in both])


def _agrees(good: bool, partly: bool) -> Literal["yes", "in part", "no"]:
    return "yes" if good else "in part" if partly else "no"


def _held(rows: Sequence[Row], method: str, grip: str) -> Said | None:
    mine = of_method(rows, method)
    survived, draws = counted(mine)
    if not draws:
        return None
    certified = planned(mine)
    weak = sum(r["survived"] < ENOUGH * r["draws"] for r in certified.values())
    bear = sum(bool(r["holds"]) for r in certified.values())
    found = (
        f"{share(survived, draws)} draws survive; {len(certified)} of {len(mine)} flaps have a certified "
        f"plan, {weak} of these survive less than 99 %; {bear} bear the statement that at most 1 % fail"
    )
    part = survived / draws
    return (
        f"plans of `swift`, {grip}, survive on 99 % of fresh draws",
        found,
        _agrees(part >= 0.99, part >= 0.97),
    )


def _spares(rows: Sequence[Row], method: str, asked: float) -> Said | None:
    eq5, equal = ratios(rows, method, "ctc"), ratios(rows, method, "ctc_lightest")
    if not len(eq5):
        return None
    also = (
        f"; over that of `ctc` closed as lightly as survives {np.median(equal):.2f}, on {len(equal)}"
        if len(equal)
        else ""
    )
    middle = float(np.median(eq5))
    return (
        f"`{method}` strains at most {asked:g} times as much as `ctc`, median over flaps",
        f"{middle:.2f} ({np.quantile(eq5, 0.1):.2f} to {np.quantile(eq5, 0.9):.2f} on 80 % of {len(eq5)})"
        f"{also}",
        _agrees(middle <= asked, middle <= 1.1 * asked),
    )


def _lower(values: Array) -> str:
    wins, losses = int((values < 1 - NEAR).sum()), int((values > 1 + NEAR).sum())
    return (
        f"lower on {wins} of {len(values)}, higher on {losses}, equal within {100 * NEAR:.0f} % on "
        f"{len(values) - wins - losses}; median ratio {np.median(values):.2f}"
    )


def _is_lower(values: Array) -> Literal["yes", "in part", "no"]:
    """Whether ratios are below 1: in the median, or at least more often than above."""
    more_often = (values < 1 - NEAR).sum() > (values > 1 + NEAR).sum()
    middle = float(np.median(values))
    return _agrees(middle < 1 - NEAR, middle <= 1 + NEAR and bool(more_often))


def _paths_by_eq5(rows: Sequence[Row]) -> Said | None:
    values = ratios(rows, "ctc", "circular")
    if not len(values):
        return None
    both = shared(rows, "ctc", "circular")
    mine = {m: among(of_method(rows, m), both) for m in ("ctc", "circular")}
    survive = ", ".join(f"`{m}` {share(*counted(found))} draws" for m, found in mine.items())
    none = len(both) - len(planned(mine["circular"]))
    return (
        "closed by Eq. 5, CTC strains the tissue less than a circular path",
        f"{_lower(values)}; of the {len(both)} that both were tried on `circular` finds nothing on {none}. "
        f"They survive alike? {survive}",
        _is_lower(values),
    )


def _paths_at_equal_survival(rows: Sequence[Row], standard: Sequence[str]) -> Said | None:
    values = ratios(rows, "ctc_lightest", "circular_lightest", equal=True)
    if not len(values):
        return None
    one, other = (of_method(rows, f"{path}_lightest", flaps=False) for path in ("ctc", "circular"))
    told = [
        f"{name.replace('_', ' ')} {one[name]['max_strain']:.3f} and {other[name]['max_strain']:.3f}"
        for name in standard
        if name in planned(one) and name in planned(other)
    ]
    tried = shared(rows, "ctc_lightest", "circular_lightest")
    firm = [among(reach(rows, f"{m}_lightest"), tried) for m in ("ctc", "circular")]
    judged = [share(*counted(among(mine, firm[0].keys() & firm[1].keys()))) for mine in firm]
    agrees = _is_lower(values)
    verdict = {
        "yes": "Yes: CTC still beats circular",
        "in part": "In part: they are equal in the median, and CTC lower more often",
        "no": "No: circular beats CTC" if np.median(values) > 1 + NEAR else "No: they are equal",
    }[agrees]
    return (
        "at equal survival (99 %), each closed as lightly as that allows, CTC still beats circular",
        f"{verdict}. CTC {_lower(values)}. 99 % is reached by some compression on {len(firm[0])} of the "
        f"{len(tried)} that both were tried on for CTC, {len(firm[1])} for circular; by finite elements "
        f"{judged[0]} and {judged[1]} draws survive where both reach it. Strain of CTC and circular: "
        f"{', '.join(told)}",
        agrees,
    )


def reach(rows: Sequence[Row], method: str) -> dict[str, Row]:
    """Certified plans that survive enough by the rod."""
    return {s: r for s, r in planned(of_method(rows, method)).items() if r["by_rod"] >= ENOUGH}


def _wisdom(rows: Sequence[Row]) -> Said | None:
    lighter = [m for m in ("eased", "fem_gradient") if of_method(rows, m)]
    tried = shared(rows, "ctc", *lighter)
    survived, draws = counted(of_method(rows, "ctc"))
    eased, light = reach(rows, "ctc_lightest"), planned(of_method(rows, "ctc"))
    both = [s for s in eased if s in light]
    if not both or not draws or not lighter:
        return None
    parts = np.array([eased[s]["part"] for s in both])
    cost = np.array([light[s]["max_strain"] / eased[s]["max_strain"] for s in both])
    safer = {m: counted(among(of_method(rows, m), tried)) for m in ("ctc", *lighter)}
    gone = [f"`{m}` {share(*count)}" for m, count in safer.items()]
    firmer = float(np.median(cost))
    wiser = survived / draws >= 0.99 and any(safer[m][0] < 0.99 * safer[m][1] for m in lighter)
    verdict = "Wiser than it did" if wiser else "No wiser than it did"
    if wiser and firmer > 1.1:
        verdict += f", but firmer than it needs to be: it strains {firmer:.2f} times as much as survival asks"
    return (
        "Eq. 5 looks wiser once survival is asked for",
        f"{verdict}. With it `ctc` survives {share(survived, draws)} draws. On the {len(tried)} that it and "
        f"plans that close as lightly as the scene itself allows were tried on: {', '.join(gone)}. The least "
        f"compression that survives is {np.median(parts):.2f} times Eq. 5's ({parts.min():.2f} to "
        f"{parts.max():.2f}), on {len(both)}",
        _agrees(wiser and firmer <= 1.1, wiser),
    )


def _fragile(rows: Sequence[Row]) -> Said | None:
    light = ("eased", "fem_gradient", "light_grip", "elastica", "swift_exact")
    mine = {m: of_method(rows, m) for m in light}
    told = {m: count for m, found in mine.items() if (count := counted(found))[1]}
    if not told:
        return None
    parts = [survived / draws for survived, draws in told.values()]
    return (
        "plans of least strain under exact knowledge do not survive",
        "; ".join(f"`{m}` {share(*count)} draws on {len(mine[m])}" for m, count in told.items()),
        _agrees(max(parts) < 0.97, min(parts) < 0.97),
    )


def _exact(rows: Sequence[Row]) -> Said | None:
    values = ratios(rows, "swift_exact", "fem_gradient")
    if not len(values):
        return None
    near, far = float((values <= 1 + NEAR).mean()), float((values > 1.05).mean())
    return (
        "with exact knowledge `swift` strains as much as `fem_gradient`",
        f"at most {1 + NEAR:g} times as much on {100 * near:.0f} % of {len(values)}, more than 1.05 times on "
        f"{100 * far:.0f} %; median {np.median(values):.3f}, greatest {values.max():.3f}",
        _agrees(near >= 0.95 and far == 0, near >= 0.8),
    )


def _statement(rows: Sequence[Row]) -> Said | None:
    stated = [r for r in rows if r["reason"] == "ok" and r["draws"] and r["bound"] is not None]
    held = [r for r in stated if r["holds"]]
    if not held:
        return None
    failed, draws = sum(r["draws"] - r["survived"] for r in held), sum(r["draws"] for r in held)
    wrong = sum((r["draws"] - r["survived"]) / r["draws"] > r["bound"] for r in stated)
    return (
        "the robust statement holds: of plans said to fail in at most 1 % of cases, no more do",
        f"of {len(held)} such plans {share(failed, draws)} draws fail; of all {len(stated)} plans with a "
        f"statement {wrong} fail on a greater part of their draws than their bound says, chance included",
        _agrees(failed / draws <= 0.01, failed / draws <= 0.02),
    )
