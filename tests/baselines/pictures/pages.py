"""Plans and motions that several tests of the page use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.cli.shown import shown
from baselines.pictures.page import Motion, Shown
from planners.certify import Certificate, certify
from planners.paths import ctc
from retract_env.grasp import Grasp, JawPath
from retract_env.scene import Scene, load_scene
from retract_env.spring import SpringModel

HOSTILE = """</script><img src=x onerror="document.title='taken'"> & 'quoted' <!--"""
"""A scene's name that would be code in a page that does not escape it."""


def judged(name: str = "ten_veins", resolution: str = "coarse") -> tuple[Scene, Grasp, JawPath, Certificate]:
    """The CTC path of the spring model's best grasp, with its certificate."""
    scene = load_scene(name)
    grasp = SpringModel(scene.tissue).stable_grasps()[0]
    path = ctc(scene, grasp)
    return scene, grasp, path, certify(scene, grasp, path, resolution)


def two_plans() -> list[Shown]:
    """A plan of a scene with a hostile name, and what becomes of it where only half the strain is allowed."""
    scene, grasp, path, certificate = judged()
    scene = scene.model_copy(update={"name": HOSTILE})
    failed = replace(certificate, certified=False, reason="strain", strain_limit=certificate.max_strain / 2)
    candidate = {"grasp": {"x": grasp.x, "compression": grasp.compression, "score": 1.0}, "path": "ctc"}
    said = {"reason": "ok", "max_strain": 0.25, "required_friction": "inf", "clearance": -1e-3}
    one = shown("first <b>", scene, grasp, path, certificate, [candidate | said])
    return [
        one,
        replace(shown("second", scene, grasp, path, failed, [], rod=False), motion=slower(one.motion)),
    ]


def slower(motion: Motion) -> Motion:
    """The same motion over twice as many waypoints after the squeeze."""
    progress = np.where(motion.progress > 1, 2 * motion.progress - 1, motion.progress)
    return replace(motion, progress=progress)
