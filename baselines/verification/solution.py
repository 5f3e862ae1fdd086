"""Solution verification: what a certificate states, on ever finer meshes, and the grid convergence index.

The index is Roache's (1994), by the procedure of Celik et al. (J. Fluids Eng. 130, 2008): values on three
meshes, each half as large as the one before, give the observed order p, the limit that they tend to, and the
error of the finest one, 1.25 times its distance from that limit. How far the mesh of certificates is off the
limit stands beside it: it is another mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from baselines.jobs.journal import Row
from baselines.verification.flaps import HEIGHT, flap
from baselines.verification.sections import split
from planners.certify import Retraction, certify
from planners.eased import eased
from planners.paths import circular, ctc
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, SectionMesh
from retract_env.physics.fem import FemPhysics
from retract_env.scene import Limits, LineOfSight, Scene, Vein, load_scene

COARSEST = replace(RESOLUTIONS["fine"], name="coarsest", patch=3, edge=0.24, growth=0.6, bulk=1.2)
"""Twice split, its elements at the jaws' edges are 1/17 of a jaw. From about 1/30 on the surface of a firmly
gripped flap folds at these sharp edges, and several equilibria exist (benchmarks/_reference.py): beyond that
nothing converges."""
SPLITS = (0, 1, 2)
"""How often each of its triangles is cut into four."""
CERTIFIED = -1
"""In the place of a number of splits: the mesh of certificates."""
RATIO = 2.0
"""of the sizes of meshes that follow each other"""
SAFETY = 1.25
ORDERS = (0.5, 3.0)
"""Between which an observed order is believed."""
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
    "homogeneous, B near, CTC": Case(lambda: load_scene("homogeneous_near"), Grasp(-0.020, 0.0011), ctc),
    "homogeneous, B near, circular": Case(
        lambda: load_scene("homogeneous_near"), Grasp(-0.020, 0.0011), circular
    ),
    "ten veins, CTC": Case(lambda: load_scene("ten_veins"), Grasp(-0.03485, 0.000967), ctc),
    "eased, light grip": Case(lambda: _seen_at(flap(), 0.35), Grasp(-0.030, 0.10 * HEIGHT), eased),
    "stiff rectangular veins at the grasp, CTC": Case(_stiff_boxes, Grasp(-0.030, 0.15 * HEIGHT), ctc),
    "20 mm deep, CTC": Case(lambda: flap(depth=0.020), Grasp(-0.025, 0.15 * HEIGHT), ctc),
    "8 mm thick, no bed, CTC": Case(lambda: flap(height=0.008, bed=False), Grasp(-0.030, 0.0012), ctc),
}
"""Eight, from firm to light, from homogeneous to stiff veins where the jaws are."""


WIDE = Limits(strain=0.99, friction=5.0, clearance=0.1)
"""Limits that nothing here breaks, a clearance that nothing reaches: paths are followed to their end."""


class SplitMesh(FemPhysics):
    """On COARSEST, its triangles cut into four so many times."""

    def __init__(self, scene: Scene, jaw_x: float, splits: int):
        self._splits = splits
        super().__init__(scene, jaw_x, COARSEST)

    def _meshed(self) -> SectionMesh:
        section = super()._meshed()
        for _ in range(self._splits):
            section = split(section, self.scene, self.jaw_x)
        return section


class OnMesh(Retraction):
    """A retraction on such a mesh, followed to the end of its path."""

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, splits: int):
        super().__init__(scene, grasp, path, limits=WIDE)
        self._splits = splits

    def _physics(self) -> FemPhysics:
        return SplitMesh(self.scene, self.grasp.x, self._splits)


@cache
def until_certified(name: str) -> tuple[Scene, JawPath]:
    """The scene of a case, and the path up to where its certificate ends, in view.

    Raises ValueError where it is not certified.
    """
    case = CASES[name]
    scene = case.scene()
    path = case.path(scene, case.grasp)
    found = certify(scene, case.grasp, path)
    if not found.certified:
        raise ValueError(f"{name}: not certified, {found.reason}")
    end = float(found.path["end"])
    poses = [*path.poses[: math.floor(end) + 1], path.pose_at(end)]
    return scene, JawPath.from_poses(np.array(poses), path.kind)


def on_mesh(resolution: str, case: str, splits: int) -> Row:  # noqa: ARG001  (of the study; here splits count)
    """What is certified of a case, on a mesh; splits: one of SPLITS, or CERTIFIED."""
    scene, path = until_certified(case)
    grasp = CASES[case].grasp
    plain = splits == CERTIFIED
    retraction = Retraction(scene, grasp, path, limits=WIDE) if plain else OnMesh(scene, grasp, path, splits)
    retraction.squeeze()
    retraction.move()
    assert retraction.physics is not None
    return {
        "reason": retraction.reason,
        "unknowns": len(retraction.physics.model.free),
        "max_strain": retraction.max_strain,
        "required_friction": retraction.required_friction,
        "clearance": retraction.clearance,
        "length": scene.tissue.length,
    }


@dataclass(frozen=True)
class Converged:
    """What meshes say of one quantity."""

    values: tuple[float, ...]
    """coarse to fine"""
    order: float
    """observed; nan where the values do not tend to one side"""
    limit: float
    """that the values tend to; the finest where they do not"""
    index: float
    """of the finest mesh, relative to the scale"""
    certified: float
    """on the mesh of certificates"""
    off: float
    """of that from the limit, relative to the scale"""


def convergence(values: Sequence[float], certified: float, scale: float) -> Converged:
    """From values on three meshes, coarse to fine, each RATIO times as fine as the one before; scale: what
    errors are compared with.

    Where they do not tend to a limit at an order in ORDERS, the finest value stands for it, and the range of
    all three for its error (Eca and Hoekstra, J. Comput. Phys. 262, 2014); an order beyond is cut.
    """
    coarse, middle, fine = values
    shrunk = (coarse - middle) / (middle - fine) if middle != fine else math.nan
    order = math.log(shrunk) / math.log(RATIO) if shrunk > 0 else math.nan
    if order >= ORDERS[0]:
        beyond = (fine - middle) / (RATIO ** min(order, ORDERS[1]) - 1)
        limit, error = fine + beyond, abs(beyond)
    else:  # nan too
        limit, error = fine, max(values) - min(values)
    return Converged(
        tuple(values), order, limit, SAFETY * error / scale, certified, (certified - limit) / scale
    )


def converged(by_splits: Mapping[int, Row]) -> dict[str, Converged]:
    """Each quantity of a case: strain relative, friction as it is, clearance over the flap's length."""
    fine = by_splits[CERTIFIED]
    scales = {
        "max_strain": float(fine["max_strain"]),
        "required_friction": 1.0,
        "clearance": float(fine["length"]),
    }
    return {
        name: convergence([float(by_splits[k][name]) for k in SPLITS], float(fine[name]), scales[name])
        for name in QUANTITIES
    }
