"""The judge: follows any jaw path through the finite elements and says what became of it. Sec. III-C, IV-A.

A retraction is only as good as its certificate. The certifier knows nothing of who proposed the path, and
judges it at the scene's own limits.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

from planners.certify.certificate import MESH_ERRORS, PATCH_SLIP, REASONS, Certificate
from planners.certify.moving import DAMPING, NOWHERE, Start, check_motion, moving, way_long
from planners.certify.retraction import FRICTION_TOLERANCE, STRAIN_TOLERANCE, Retraction
from planners.certify.robust import OnJudged, Robust, check_statable, statement
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

FINER = {"coarse": "medium", "medium": "fine", "fine": "finer"}
VERIFIED_IN = 4
"""Parts of an increment when a certificate is verified."""
ROUNDING = 1e-4
"""Between the same retraction on two kinds of processors, as a part, or in SI units; on one there is none. Of
120 firm retractions 103 keep to it in all increments (benchmarks/machines.py)."""


class Trial(Retraction):
    """A retraction at the scene's own limits: the only one that ends in a certificate."""

    def __init__(
        self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str = "fine", division: int = 1
    ):
        """division: of each increment. Raises ValueError as a Retraction."""
        super().__init__(scene, grasp, path, resolution, division=division)

    def certificate(self) -> Certificate:
        """The verdict, once the trial has ended."""
        assert self.physics is not None and self.reason in REASONS
        limits, frames = self.scene.limits, self.frames
        prism = self.physics.model.prism
        return Certificate(
            certified=self.reason == "ok",
            reason=self.reason,
            max_strain=self.max_strain,
            strain_limit=limits.strain,
            required_friction=self.required_friction,
            friction_limit=limits.friction,
            clearance=self.clearance,
            increments=len(frames) - 1,
            mesh={
                "nodes": len(prism.section.points) * prism.levels,
                "elements": sum(b.count for b in prism.blocks),
                "resolution": self.resolution,
            },
            scene_hash=self.scene.hash,
            grasp={"x": self.grasp.x, **self.grasp.firmness},
            path={"kind": self.path.kind, "end": frames[-1].progress},
            history=self.history(),
            peaks=self._peaks(),
            clearance_limit=limits.clearance,
            margins={
                "mesh": MESH_ERRORS.get(self.resolution) if self.scene.neo_hookean else None,
                "peaks": {"strain": STRAIN_TOLERANCE, "friction": FRICTION_TOLERANCE},
                "patch_slip": PATCH_SLIP,
            },
            frames=tuple(frames),
            section=self.physics.section,
        )

    def _peaks(self) -> dict[str, Any]:
        """Where the greatest strain and friction are."""
        strained = max(self.frames, key=lambda f: f.worst_strain)
        moved = [f for f in self.frames if f.progress >= 1]
        gripped = max(moved, key=lambda f: float(f.required_friction.max()), default=None)
        return {
            "strain": {"progress": strained.progress, "place": strained.worst_at.tolist()},
            "friction": None
            if gripped is None
            else {
                "progress": gripped.progress,
                "jaw": ("lower", "upper")[int(gripped.required_friction.argmax())],
            },
            # m^2 of the section, covered twice beside a jaw's edge
            "crease": max(f.crease for f in self.frames),
            "strain_tolerance": STRAIN_TOLERANCE,
            "friction_tolerance": FRICTION_TOLERANCE,
        }


def certify(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    resolution: str = "fine",
    verify: bool = False,
    on_increment: Callable[[], None] = lambda: None,
    robust: Robust | bool = False,
    speed: float | None = None,
) -> Certificate:
    """Simulate one retraction and judge it.

    resolution: a name in RESOLUTIONS; verify: repeat it on a finer mesh in `VERIFIED_IN` times as many
    increments and report the differences; robust: say also how likely the plan fails where the scene is not
    quite what it says, with `Robust()` or as asked; speed: m/s, say also what the motion comes to where it is
    made at this mean speed, smoothly, with inertia.
    Raises ValueError for a grasp off the flap, a path that does not begin there, an unknown resolution, no
    speed, or a robust statement of tissue whose law the rod does not know, and its kind MeshError where the
    flap with jaws there cannot be meshed.
    """
    trial = Trial(scene, grasp, path, resolution)
    if robust:
        check_statable(scene)
    if speed is not None:
        check_motion(scene, speed)
    if verify and resolution not in FINER:
        raise ValueError(
            f"resolution = {resolution!r} has no finer one to verify with, allowed {', '.join(FINER)}"
        )
    trial.squeeze()
    trial.move(on_increment=on_increment)
    certificate = trial.certificate()
    if verify:
        certificate = verified(certificate, scene, grasp, path)
    if speed is not None:
        certificate = timed(certificate, scene, speed, on_increment=on_increment)
    return stated(certificate, scene, grasp, path, robust, on_increment) if robust else certificate


def stated(
    certificate: Certificate,
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    asked: Robust | bool = True,
    on_increment: Callable[[], None] = lambda: None,
    on_judged: OnJudged = lambda done, of: None,  # noqa: ARG005
) -> Certificate:
    """The certificate with the robust statement; asked: True for `Robust()`."""
    asked = asked if isinstance(asked, Robust) else Robust()
    said = statement(scene, grasp, path, certificate, asked, on_increment, on_judged)
    return replace(certificate, robust=said)


def timed(
    certificate: Certificate,
    scene: Scene,
    speed: float,
    start: Start = "smooth",
    damping: float = DAMPING,
    on_increment: Callable[[], None] = lambda: None,
) -> Certificate:
    """The certificate with what its motion comes to at a mean speed, m/s, where there is a motion.

    certificate: as computed here, with its frames. Raises ValueError as `moving.check_motion`.
    """
    check_motion(scene, speed, start, damping)
    if way_long(certificate.frames) < NOWHERE:  # a limit broke as the jaws closed, or they go nowhere
        return certificate
    resolution = certificate.mesh["resolution"]
    found = moving(scene, certificate.frames, speed, resolution, start, damping, on_increment)
    return replace(certificate, moving=asdict(found))


def verified(certificate: Certificate, scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    """The certificate with the differences to the same retraction on the next finer mesh, in finer steps."""
    trial = Trial(scene, grasp, path, FINER[certificate.mesh["resolution"]], VERIFIED_IN)
    trial.squeeze()
    trial.move()
    finer = trial.certificate()
    differences = {
        "resolution": finer.mesh["resolution"],
        "nodes": finer.mesh["nodes"],
        "increments": finer.increments,
        "reason": finer.reason,
        "max_strain": finer.max_strain,
        "max_strain_difference": _ratio(certificate.max_strain, finer.max_strain) - 1,
        "required_friction": finer.required_friction,
        "required_friction_difference": certificate.required_friction - finer.required_friction,
        "end_difference": certificate.path["end"] - finer.path["end"],
    }
    return replace(certificate, verification=differences)


def _ratio(a: float, b: float) -> float:
    return a / b if b else math.nan  # a finer flap that found no rest has no strain


def differences(said: Certificate, found: Certificate) -> list[str]:
    """What one certificate says otherwise than another, a line a field; numbers may differ by `ROUNDING`."""
    one, other = said.to_json(), found.to_json()
    return [
        line
        for name in sorted(one.keys() & other.keys() - {"hash"})
        for line in _apart(name, one[name], other[name])
    ]


def _apart(name: str, said: Any, found: Any) -> list[str]:
    if isinstance(said, dict) and isinstance(found, dict) and said.keys() == found.keys():
        return [line for key in said for line in _apart(f"{name}.{key}", said[key], found[key])]
    if isinstance(said, list) and isinstance(found, list) and len(said) == len(found):
        lines = (_apart(f"{name}[{i}]", a, b) for i, (a, b) in enumerate(zip(said, found, strict=True)))
        return next((line for line in lines if line), [])  # one of a history says it
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (said, found))
    same = math.isclose(said, found, rel_tol=ROUNDING, abs_tol=ROUNDING) if numbers else said == found
    return [] if same else [f"{name} = {_brief(said)}, recomputed {_brief(found)}"]


def _brief(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else reprlib.repr(value)
