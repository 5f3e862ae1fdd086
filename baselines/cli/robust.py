"""How the console tells the robust statement, and the worst cases as plans that can be opened."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from baselines.cli.console import BadInput
from baselines.cli.words import FAILS, UNKNOWN
from baselines.pictures.words import percent

if TYPE_CHECKING:
    from planners.certify import Certificate, Robust
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene

RobustOption = Annotated[
    bool,
    typer.Option("--robust", help="Say how likely it fails on flaps that are not quite as the scene says."),
]
NAMED = 2
"""Of what hurts most."""


def check_stated(scene: Scene) -> None:
    """Raise BadInput for a scene of which nothing robust can be stated."""
    from planners.certify.robust import check_statable
    from retract_env.errors import SceneError

    try:
        check_statable(scene)
    except SceneError as problem:
        raise BadInput(str(problem)) from None


def stated(
    certificate: Certificate, scene: Scene, grasp: Grasp, path: JawPath, asked: Robust | None = None
) -> Certificate:
    """The certificate with the robust statement, showing how far that is."""
    from baselines.cli.progress import Under
    from planners.certify import Robust, stated

    asked = asked or Robust()
    with Under(f"{asked.samples:,} flaps as they may turn out to be") as under:
        return stated(certificate, scene, grasp, path, asked, under.step, under.judged)


def told(certificate: Certificate) -> list[str]:
    """The robust statement in plain words, line by line; none where nothing is stated."""
    said = certificate.robust
    if said is None:
        return []
    count, samples = sum(said["failures"].values()), said["samples"]
    fails = (
        f"robust: fails in at most {percent(said['bound'])} of flaps as uncertain as this"
        if said["holds"]
        else f"not robust: may fail in up to {percent(said['bound'])} of flaps as uncertain as this, "
        f"more than {percent(said['eps'])}"
    )
    judges = {
        "the rod": said["judged"]["rod"],
        "finite elements": said["judged"]["finite_elements"],
        "neither": said["judged"]["undecided"],
    }
    by = ", ".join(f"{n:,} by {judge}" for judge, n in judges.items() if n)
    lines = [
        f"{fails}, with confidence {100 * (1 - said['beta']):.6g} %: "
        f"{f'{count:,}' if count else 'none'} of {samples:,} did; judged {by}"
    ]
    if count:
        most_first = sorted(said["failures"].items(), key=lambda item: -item[1])
        lines.append("  fails by: " + ", ".join(f"{FAILS.get(why, why)} {n:,}" for why, n in most_first))
    if hurting := [line for line, _ in zip(hurts(certificate), range(NAMED), strict=False)]:
        lines.append("  what hurts most: " + ", then ".join(hurting))
    return lines


def hurts(certificate: Certificate) -> Iterator[str]:
    """What is unknown, each with what the end of its range costs, most of its limit first."""
    said = certificate.robust
    if said is None or said["sensitivities"] is None:
        return
    limits = {"strain": certificate.strain_limit, "friction": certificate.friction_limit}
    costs: list[tuple[float, str]] = []
    for name, slopes in said["sensitivities"].items():
        half = slopes["half_range"]
        by = {what: abs(slopes[what]) * half for what in limits}
        if name == "friction":  # of which more is not needed: the limit is less
            by = {"friction": limits["friction"] * half}
        what = max(by, key=lambda w: by[w] / limits[w])
        if by[what] > 0:
            limit = "limit of " if name == "friction" else ""
            line = f"{UNKNOWN.get(name, name)} ({limit}{what} ±{by[what]:.3f})"
            costs.append((by[what] / limits[what], line))
    for _, line in sorted(costs, reverse=True):
        yield line


def worst_flaps(
    scene: Scene, grasp: Grasp, path: JawPath, certificate: Certificate
) -> Iterator[tuple[dict[str, Any], Any, tuple[Scene, Grasp, JawPath] | None]]:
    """Of each of the worst draws, if there is a statement: the case, the draw, and scene, grasp and path
    there, None where the jaws do not close on the flap at all."""
    from planners.certify.robust import drawn
    from retract_env.scenarios import scenario

    for case in [] if certificate.robust is None else certificate.robust["worst"]:
        z = drawn(case)
        yield case, z, scenario(scene, grasp, path, z)


def worst_cases(scene: Scene, grasp: Grasp, path: JawPath, certificate: Certificate) -> dict[str, Any]:
    """Files with the worst of what was drawn, as plans: worst-1.json and so on, the worst first.

    None where nothing is stated, nor of a case in which the jaws do not close on the flap at all: no plan
    says that.
    """
    files: dict[str, Any] = {}
    for _, _, there in worst_flaps(scene, grasp, path, certificate):
        if there is not None:
            flap, held, moved = there
            files[f"worst-{len(files) + 1}.json"] = {
                "scene": flap.dump(),
                "grasp": {"x": held.x, **held.firmness},
                "path": moved.to_json(),
            }
    return files


def forget_worst_cases(folder: Path, but: Collection[Path] = ()) -> None:
    """Delete files of that sort in a folder but those that were just written."""
    for file in folder.glob("worst-*.json"):
        if is_worst_case(file) and file not in but:
            file.unlink()


def is_worst_case(file: Path) -> bool:
    """Whether the file is called as those of worst cases are."""
    return re.fullmatch(r"worst-[0-9]+\.json", file.name) is not None
