"""Grasps and paths that are tried: kinds of paths by name, uniform grasps on any tissue."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from baselines.verification.flaps import HEIGHT, LENGTH
from planners import PLANNERS
from planners.paths import PAPER_PATHS, PATHS
from planners.proposals import along, stable_grasps, uniform_grasps
from retract_env.spring import SpringModel, optimal_compression
from tests.planners.retractions import a_scene, veined

ROOT = Path(__file__).resolve().parents[2]
SCENES = {"homogeneous": a_scene(), "veined": veined()}
every_scene = pytest.mark.parametrize("name", SCENES)


def test_paths_go_by_the_name_that_they_bear() -> None:
    grasp = stable_grasps(a_scene())[0]
    for name, path_of in PATHS.items():
        assert path_of(a_scene(), grasp).kind == name
    assert set(PAPER_PATHS) <= set(PATHS)
    assert set(PAPER_PATHS) <= set(PLANNERS)


def test_a_further_kind_of_path_becomes_no_planner() -> None:
    """Nor is it searched by one: the module is made again with the kind in the registry."""
    code = (
        "import importlib, planners, planners.paths as paths\n"
        "before = list(planners.PLANNERS)\n"
        "paths.PATHS['steep'] = paths.ctc\n"
        "planners = importlib.reload(planners)\n"
        "assert list(planners.PLANNERS) == before, list(planners.PLANNERS)\n"
        "assert 'steep' not in planners.PLANNERS['exhaustive'].args[2]\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@every_scene
def test_every_grasp_goes_along_every_path(name: str) -> None:
    scene = SCENES[name]
    grasps = stable_grasps(scene)
    proposals = along(scene, grasps, PAPER_PATHS)
    assert [(grasp, path.kind) for grasp, path in proposals] == [
        (grasp, kind) for grasp in grasps for kind in PAPER_PATHS
    ]
    assert all(path == PATHS[path.kind](scene, grasp) for grasp, path in proposals)


@every_scene
def test_uniform_grasps_are_evenly_spaced_with_their_jaws_on_the_flap(name: str) -> None:
    scene = SCENES[name]
    x = np.array([grasp.x for grasp in uniform_grasps(scene, 20)])
    width = scene.jaws.width
    np.testing.assert_allclose(x[1:-1], -LENGTH * np.arange(19, 1, -1) / 20)
    assert x[0] == pytest.approx(-LENGTH + width / 2)
    assert x.max() < -width / 2


def test_on_homogeneous_tissue_they_are_those_of_the_spring_model() -> None:
    scene = a_scene()
    model = SpringModel(scene.tissue).stable_grasps(jaw_width=scene.jaws.width, samples=20)
    uniform = uniform_grasps(scene, 20)
    assert uniform == sorted(model, key=lambda grasp: grasp.x)
    assert all(grasp.compression == pytest.approx(HEIGHT / 4) for grasp in uniform)


def test_compression_balances_the_energies_of_the_basin() -> None:
    """Eq. 5, with the stiffness at the grasp and the lower of the maxima beside it."""
    scene = veined()
    model = SpringModel(scene.tissue)
    middle = next(b for b in model.basins() if b.left < -0.025 < b.right)  # between the two veins
    for grasp in uniform_grasps(scene, 100):
        k = float(model.k_eq(grasp.x))
        if middle.left < grasp.x < middle.right and k < middle.k_n:
            delta = optimal_compression(k, middle.k_n, HEIGHT, 0.5)
            assert grasp.compression == pytest.approx(float(delta))
            assert grasp.score == pytest.approx(middle.k_n * float(delta) ** 2 / 2)
        # U_L = U_n: no grasp closes by more than half of what the strain limit leaves
        assert 0 < grasp.compression <= HEIGHT / 4 * (1 + 1e-12)


def test_no_grasps_are_refused() -> None:
    with pytest.raises(ValueError, match="samples = 0"):
        uniform_grasps(a_scene(), 0)
