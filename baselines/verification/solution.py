"""Solution verification: what a certificate states, on ever finer meshes, and the grid convergence index.

The index is Roache's (1994), by the procedure of Celik et al. (J. Fluids Eng. 130, 2008): the observed order
p comes from three meshes whose sizes differ by the factors r21 and r32; the error of the middle one, from
which certificates come, is 1.25 e32 / (r32^p - 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from baselines.jobs.journal import Row
from baselines.verification.flaps import HEIGHT, flap
from planners.certify import certify
from planners.eased import eased
from planners.paths import circular, ctc
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import LineOfSight, Scene, Vein, load_scene

MESHES = ("medium", "fine", "finer")
SAFETY = 1.25
ORDERS = (0.5, 3.0)
"""Between which an observed order is believed; outside, the nearer of them is used."""
QUANTITIES = ("max_strain", "required_friction", "clearance")


@dataclass(frozen=True)
class Case:
    """A retraction that is followed to one place on all meshes."""

    scene: Callable[[], Scene]
    grasp: Grasp
    path: Callable[[Scene, Grasp], JawPath]


def _seen_at(scene: Scene, part: float) -> Scene:
    """With B at that part of the length."""
    line = LineOfSight.at(-part * scene.tissue.length, math.pi / 4)
    return scene.model_copy(update={"line_of_sight": line})


def _stiff_boxes() -> Scene:
    """Three rectangular veins of 400 kPa beside the grasp."""
    boxes = [
        (-0.0335, -0.0315, 0.0006, 0.0022),
        (-0.0285, -0.0265, 0.0020, 0.0036),
        (-0.0245, -0.0225, 0.0008, 0.0026),
    ]
    veins = [Vein(outline=((a, c), (b, c), (b, d), (a, d)), modulus=400e3) for a, b, c, d in boxes]
    return flap(veins=veins)


CASES: Mapping[str, Case] = {
    "homogeneous, CTC": Case(lambda: load_scene("homogeneous"), Grasp(-0.025, 0.0011), ctc),
    "homogeneous, B near, CTC": Case(lambda: load_scene("homogeneous_near"), Grasp(-0.015, 0.0011), ctc),
    "homogeneous, B near, circular": Case(
        lambda: load_scene("homogeneous_near"), Grasp(-0.020, 0.0011), circular
    ),
    "ten veins, CTC": Case(lambda: load_scene("ten_veins"), Grasp(-0.03485, 0.000967), ctc),
    "eased, light grip": Case(lambda: _seen_at(flap(), 0.35), Grasp(-0.030, 0.10 * HEIGHT), eased),
    "stiff rectangular veins at the grasp, CTC": Case(_stiff_boxes, Grasp(-0.030, 0.15 * HEIGHT), ctc),
    "20 mm deep, CTC": Case(lambda: flap(depth=0.020), Grasp(-0.025, 0.15 * HEIGHT), ctc),
    "8 mm thick, no bed, CTC": Case(lambda: flap(height=0.008, bed=False), Grasp(-0.025, 0.0012), ctc),
}
"""Eight, from firm to light, from homogeneous to stiff veins where the jaws are."""


def freed(scene: Scene, clearance: float = 0.1) -> Scene:
    """At limits that nothing here breaks, and a clearance that nothing reaches: paths are followed to their
    end."""
    limits = scene.limits.model_copy(update={"strain": 0.99, "friction": 5.0, "clearance": clearance})
    return scene.model_copy(update={"limits": limits})


def until_seen(case: Case) -> tuple[Scene, JawPath]:
    """The scene at wide limits, and the path up to the waypoint by which the target is in view on the
    coarsest of the meshes."""
    scene = case.scene()
    path = case.path(scene, case.grasp)
    seen = certify(freed(scene, 0.0), case.grasp, path, MESHES[0])
    last = min(math.ceil(seen.path["end"]), path.last)
    return freed(scene), JawPath(path.waypoints[: last + 1], path.kind)


def on_mesh(resolution: str, case: str, mesh: str) -> Row:  # noqa: ARG001  (of the study; here `mesh` counts)
    """What the certificate of a case states on a mesh."""
    scene, path = until_seen(CASES[case])
    found = certify(scene, CASES[case].grasp, path, mesh)
    return {
        "reason": found.reason,
        "nodes": found.mesh["nodes"],
        **{name: getattr(found, name) for name in QUANTITIES},
        "length": scene.tissue.length,
    }


@dataclass(frozen=True)
class Converged:
    """What three meshes say of one quantity."""

    values: tuple[float, ...]
    """coarse to fine"""
    order: float
    """observed; nan where the values do not tend to one side"""
    index: float
    """of the middle mesh, relative to the scale"""


def convergence(values: Sequence[float], nodes: Sequence[int], scale: float) -> Converged:
    """Observed order, and index of the middle one of three meshes, coarse to fine.

    scale: what an error is compared with. Sizes go with the square root of the number of nodes: sections are
    refined, the depth hardly is.
    """
    coarse, middle, fine = values
    r32, r21 = math.sqrt(nodes[1] / nodes[0]), math.sqrt(nodes[2] / nodes[1])
    order = observed_order(coarse - middle, middle - fine, r32, r21)
    used = float(np.clip(1.0 if math.isnan(order) else order, *ORDERS))
    error = max(abs(coarse - middle) / (r32**used - 1), abs(middle - fine))
    return Converged(tuple(values), order, SAFETY * error / scale)


def observed_order(e32: float, e21: float, r32: float, r21: float) -> float:
    """p with e32 / e21 = r21^p (r32^p - 1) / (r21^p - 1), by iteration; nan where the differences change sign
    or do not shrink."""
    if e21 == 0 or e32 / e21 <= 0:
        return math.nan
    p = 1.0
    for _ in range(200):
        shift = math.log((r21**p - 1) / (r32**p - 1))
        last, p = p, abs(math.log(e32 / e21) + shift) / math.log(r21)
        if abs(p - last) < 1e-10:
            break
        if not 1e-3 < p < 50:
            return math.nan
    return p


def indices(by_mesh: Mapping[str, Row]) -> dict[str, Converged]:
    """Of each quantity of a case; clearance is compared with the flap's length."""
    rows = [by_mesh[mesh] for mesh in MESHES]
    nodes, fine = [int(row["nodes"]) for row in rows], rows[MESHES.index("fine")]
    scales = {**{name: float(fine[name]) for name in QUANTITIES}, "clearance": float(fine["length"])}
    return {name: convergence([float(row[name]) for row in rows], nodes, scales[name]) for name in QUANTITIES}
