"""What the page of a plan says in words and shows besides: verdict, margins, candidates, worst cases."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from baselines.cli.robust import told, worst_flaps
from baselines.cli.verdict import MM, MN, margins
from baselines.cli.words import FAILS, SHORT, UNKNOWN

if TYPE_CHECKING:
    from baselines.pictures.page import Shown, Table, Tried
    from planners.certify import Certificate
    from retract_env.grasp import Grasp, JawPath
    from retract_env.scene import Scene

MOST_MOTIONS = 24
"""Of one table that are followed by the rod; each is some 40 kB of the page."""
NAMED = 4
"""Of what differs in a worst case that are named, the farthest from what the scene says first."""
COLUMNS = ("#", "came to", "grasp, mm", "closed by", "path", "strain", "friction", "clearance, mm")


def shown(
    name: str,
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    candidates: Sequence[Mapping[str, Any]] = (),
    rod: bool = True,
    on_step: Callable[[], None] = lambda: None,
) -> Shown:
    """A plan for the page, followed once by finite elements and, where asked, its alternatives by the rod.

    candidates: as plan files have them. Raises NotFollowed, and ValueError for candidates that no planner
    writes.
    """
    from baselines.pictures.page import Shown, followed

    return Shown(
        name=name,
        scene=scene,
        motion=followed(scene, grasp, path, certificate, on_step),
        good=certificate.certified,
        verdict="certified" if certificate.certified else "not certified",
        told=_told(certificate),
        robust=tuple(_sentence(line.strip()) for line in told(certificate)),
        tables=(
            _candidates(scene, grasp, path, candidates, rod, on_step),
            _worst(scene, grasp, path, certificate, rod, on_step),
        ),
    )


def _told(c: Certificate) -> tuple[str, ...]:
    """Verdict and margins."""
    by = f"by finite elements in three dimensions ({c.mesh['resolution']} mesh, {c.mesh['nodes']:,} nodes)"
    verdict = (
        f"Certified {by}: the target comes into view, the grasp holds, the tissue is spared."
        if c.certified
        else f"Not certified {by}: {FAILS.get(c.reason, c.reason)}."
    )
    held = (
        f"pressing with {c.grasp['force'] * MN:.1f} mN"
        if "force" in c.grasp
        else f"closed by {c.grasp['compression'] * MM:.2f} mm"
    )
    above = f"{abs(c.clearance) * MM:.2f} mm {'above' if c.clearance >= 0 else 'below'} the line of sight AB"
    lines = [
        verdict,
        f"Strain: {c.max_strain:.3f} of {c.strain_limit:g} allowed, in the worst 1 % of the tissue; "
        f"{_spare(c.max_strain, c.strain_limit)}.",
        f"Friction: {c.required_friction:.2f} needed of {c.friction_limit:g}; "
        f"{_spare(c.required_friction, c.friction_limit)}.",
        f"Visibility: the lowest tissue ends {above}, asked is {c.clearance_limit * MM:g} mm above it.",
        f"Grasp: {-c.grasp['x'] * MM:.1f} mm from the fixed end, jaws {held}.",
    ]
    if said := margins(c):
        lines.append(_sentence(said))
    if (finer := c.verification) is not None:
        lines.append(
            f"On the {finer['resolution']} mesh: strain {finer['max_strain']:.3f}, "
            f"friction {finer['required_friction']:.2f}, {FAILS.get(finer['reason'], 'certified')}."
        )
    return tuple(lines)


def _sentence(said: str) -> str:
    return said[0].upper() + said[1:] + "."


def _spare(value: float, limit: float) -> str:
    left = 1 - value / limit
    if left >= 0:
        return f"{100 * left:.0f} % to spare"
    return "more than any friction gives" if math.isinf(left) else f"{-100 * left:.0f} % too much"


def _candidates(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    candidates: Sequence[Mapping[str, Any]],
    rod: bool,
    on_step: Callable[[], None],
) -> Table:
    """What the planner tried. Paths that follow from a grasp alone are made again, for the rod to follow."""
    from baselines.pictures.page import Table
    from planners.paths import PATHS

    again = PATHS.get(path.kind)
    known = again is not None and again(scene, grasp) == path  # this planner's paths follow from the grasp
    rows: list[Tried] = []
    for k, one in enumerate(candidates):
        at = _grasp_of(one, f"plan.candidates[{k}]")
        kind = str(one.get("path", ""))
        moves = rod and known and kind in PATHS and sum(row.motion is not None for row in rows) < MOST_MOTIONS
        made = PATHS[kind](scene, at) if moves else None
        try:
            rows.append(_candidate(k, scene, one, at, made, at == grasp and one.get("reason") == "ok"))
        except OverflowError as problem:  # a whole number may be too long for a float
            raise ValueError(f"plan.candidates[{k}]: {problem}") from None
        on_step()
    if not scene.neo_hookean:
        note = "Only their numbers are kept: the rod does not know this tissue's law."
    elif known and rod:
        note = "The rod, quick and approximate, shows how they move."
    elif known:
        note = "`retract view` on this plan's folder adds how they move, by the rod."
    else:
        note = "Only their numbers are kept: this planner's paths do not follow from their grasps."
    dismissed = " With ~: numbers of the rod, by which they were dismissed."
    return Table(f"What the planner tried: {len(rows)}", note + dismissed, COLUMNS, tuple(rows))


def _candidate(
    k: int, scene: Scene, one: Mapping[str, Any], at: Grasp, path: JawPath | None, chosen: bool
) -> Tried:
    from baselines.pictures.page import Tried, followed_by_rod
    from planners.base import DISMISSED

    reason = str(one.get("reason"))
    about = "~" if reason == DISMISSED else ""
    closed = f"{at.compression * MM:.2f} mm" if at.force is None else f"{at.force * MN:.1f} mN"
    numbers = (
        about + _number(one.get("max_strain"), 1, ".3f"),
        about + _number(one.get("required_friction"), 1, ".2f"),
        about + _number(one.get("clearance"), MM, ".2f"),
    )
    kind = str(one.get("path", ""))
    came = "chosen" if chosen else SHORT.get(reason, reason)
    score = at.score
    told = [
        f"Candidate {k + 1}: grasped {-at.x * MM:.2f} mm from the fixed end, jaws closed by {closed}, "
        f"path {kind}. Came to: {FAILS.get(reason, SHORT.get(reason, reason))}.",
        f"Strain {numbers[0]} of {scene.limits.strain:g}, friction {numbers[1]} of "
        f"{scene.limits.friction:g}, clearance {numbers[2]} mm, after {one.get('increments', 0)} increments.",
    ]
    if math.isfinite(score):
        told.append(f"Score of the spring model: {score:.3g} J/m\N{SUPERSCRIPT TWO}.")
    motion = None if path is None else followed_by_rod(scene, at, path)
    if motion is not None:
        told.append(
            f"By the rod: strain {motion.worst.max():.3f}, clearance {motion.clearance[-1] * MM:.2f} mm "
            "at the end."
        )
    cells = (str(k + 1), came, f"{at.x * MM:.2f}".replace("-", "\N{MINUS SIGN}"), closed, kind, *numbers)
    return Tried(f"candidate {k + 1}", cells, tuple(told), motion, chosen=chosen)


def _grasp_of(one: Mapping[str, Any], field: str) -> Grasp:
    """Raises ValueError, one line, where it is no grasp as plan files have them."""
    from retract_env.grasp import Grasp

    said = one.get("grasp")
    try:
        if not isinstance(said, Mapping):
            raise ValueError("allowed is an object with x and compression or force")
        score = said.get("score")
        firmness = {name: float(said[name]) for name in ("compression", "force") if name in said}
        return Grasp(float(said["x"]), score=math.nan if score is None else float(score), **firmness)
    except KeyError as missing:
        raise ValueError(f"{field}.grasp: {missing.args[0]} is missing") from None
    except (TypeError, ValueError, OverflowError) as problem:
        raise ValueError(f"{field}.grasp: {problem}") from None


def _number(value: object, factor: float, form: str) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return format(factor * float(value), form).replace("-", "\N{MINUS SIGN}")
    return "lets go" if value == "inf" else "\N{EN DASH}"


def _worst(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    rod: bool,
    on_step: Callable[[], None],
) -> Table:
    """The flaps, of those that were drawn, on which the plan fails or is nearest to it."""
    from baselines.pictures.page import Table, Tried, followed_by_rod

    rows = []
    filed = 0
    for case, z, there in worst_flaps(scene, grasp, path, certificate):
        reason = case["reason"]
        came = "holds, nearest to failing" if reason == "ok" else FAILS.get(reason, reason)
        differs = _differs(scene, grasp, z)
        motion = followed_by_rod(*there) if rod and there is not None else None
        told = [f"{came[0].upper()}{came[1:]}. What differs from the scene: {', '.join(differs)}."]
        filed += there is not None
        number = "\N{EN DASH}" if there is None else str(filed)
        rows.append(
            Tried(
                "a case of which there is no plan" if there is None else f"worst case {filed}",
                (number, came, ", ".join(differs[:NAMED])),
                tuple(told),
                motion,
                None if there is None else there[0],
            )
        )
        on_step()
    note = "Of the flaps that were drawn, those on which the plan fails or that are nearest to it. "
    note += "The files worst-1.json and so on beside the certificate are these, as plans; of those that the "
    note += "jaws do not close on at all there is none."
    columns = ("#", "what becomes of it", "differs most in")
    return Table(f"Worst cases: {len(rows)}", note, columns, tuple(rows), words=len(columns))


def _differs(scene: Scene, grasp: Grasp, z: Any) -> list[str]:
    """What a draw changes, the farthest in its range first."""
    from retract_env.scenarios import values
    from retract_env.scene import UNKNOWNS

    found = values(scene, z[None], math.nan if grasp.force is None else grasp.force)
    lengths, out = ("grasp", "closing", "target"), []
    for k in sorted(range(len(UNKNOWNS)), key=lambda k: -abs(z[k])):
        name = UNKNOWNS[k]
        value = float(getattr(found, name)[0])
        if name in lengths:
            said = f"{value * MM:+.2f} mm" if value else ""
        elif name == "poisson":
            said = f"\N{GREEK SMALL LETTER NU} = {value:.3f}" if scene.uncertainty.poisson else ""
        else:
            said = f"{100 * (value - 1):+.0f} %" if abs(value - 1) >= 5e-3 else ""
        if (name == "force") == (grasp.force is None) and name in ("force", "closing"):
            continue  # the other kind of grip
        if said:
            out.append(f"{UNKNOWN[name]} {said}".replace("-", "\N{MINUS SIGN}"))
    return out
