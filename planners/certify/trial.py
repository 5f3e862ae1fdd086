"""The judge: follows any jaw path through the finite elements and says what became of it. Sec. III-C, IV-A.

A retraction is only as good as its certificate. The certifier knows nothing of who proposed the path, and
judges it at the scene's own limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields

from planners.certify.certificate import REASONS, Certificate
from planners.certify.retraction import Retraction
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene

FINER = {"coarse": "medium", "medium": "fine", "fine": "finer"}


class Trial(Retraction):
    """A retraction at the scene's own limits: the only one that ends in a certificate."""

    def __init__(self, scene: Scene, grasp: Grasp, path: JawPath, resolution: str = "fine"):
        """Raises ValueError as a Retraction."""
        super().__init__(scene, grasp, path, resolution)

    def certificate(self) -> Certificate:
        """The verdict, once the trial has ended."""
        assert self.physics is not None and self.reason in REASONS
        limits, frames = self.scene.limits, self.frames
        history = {
            "progress": [f.progress for f in frames],
            "strain": [f.max_strain for f in frames],
            "worst_at": [f.worst_at.tolist() for f in frames],
            "friction": [f.required_friction.tolist() if f.progress >= 1 else [0.0, 0.0] for f in frames],
            "reactions": [f.reactions.tolist() for f in frames],
            "clearance": [f.clearance for f in frames],
            "jaws": [f.jaws.tolist() for f in frames],
        }
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
            grasp={"x": self.grasp.x, "compression": self.grasp.compression},
            path={"kind": self.path.kind, "end": frames[-1].progress},
            history=history,
            frames=tuple(frames),
            section=self.physics.section,
        )


def certify(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    resolution: str = "fine",
    verify: bool = False,
    on_increment: Callable[[], None] = lambda: None,
) -> Certificate:
    """Simulate one retraction and judge it.

    resolution: a name in RESOLUTIONS; verify: repeat it on a finer mesh and report the differences.
    Raises ValueError for a grasp off the flap, a path that does not begin there, or an unknown resolution,
    and its kind MeshError where the flap with jaws there cannot be meshed.
    """
    trial = Trial(scene, grasp, path, resolution)
    if verify and resolution not in FINER:
        raise ValueError(
            f"resolution = {resolution!r} has no finer one to verify with, allowed {', '.join(FINER)}"
        )
    trial.squeeze()
    trial.move(on_increment=on_increment)
    certificate = trial.certificate()
    return verified(certificate, scene, grasp, path) if verify else certificate


def verified(certificate: Certificate, scene: Scene, grasp: Grasp, path: JawPath) -> Certificate:
    """The certificate with the differences to the same retraction on the next finer mesh."""
    finer = certify(scene, grasp, path, FINER[certificate.mesh["resolution"]])
    differences = {
        "resolution": finer.mesh["resolution"],
        "nodes": finer.mesh["nodes"],
        "reason": finer.reason,
        "max_strain": finer.max_strain,
        "max_strain_difference": _ratio(certificate.max_strain, finer.max_strain) - 1,
        "required_friction": finer.required_friction,
        "required_friction_difference": certificate.required_friction - finer.required_friction,
        "end_difference": certificate.path["end"] - finer.path["end"],
    }
    content = {f.name: getattr(certificate, f.name) for f in fields(certificate)}
    return Certificate(**content | {"verification": differences})


def _ratio(a: float, b: float) -> float:
    return a / b if b else math.nan  # a finer flap that found no rest has no strain
