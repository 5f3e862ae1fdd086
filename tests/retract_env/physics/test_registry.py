"""The list of physics: what it says of each is so, and what is missing or unknown is said in one line."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import retract_env
from baselines.learning.recipe import EnvSettings
from retract_env.env import TissueRetractEnv
from retract_env.physics.pool import PhysicsPool
from retract_env.physics.registry import PHYSICS, PhysicsKind, physics_kind
from retract_env.scene import Scene
from retract_env.task import default_scene

ROOT = Path(__file__).resolve().parents[3]


class Still:
    """Knows when it is closed."""

    resolutions = ("only",)

    def __init__(self, scene: Scene, jaw_x: float, resolution: str, stop_when: Any = None):
        self.made_with = scene, jaw_x, resolution, stop_when
        self.closed = False

    def close(self) -> None:
        self.closed = True


MAKE: Any = Still
STILL = PhysicsKind("still", "TissueRetractStill-v0", MAKE, resolution="only", about="nothing that moves")


@pytest.mark.parametrize("kind", PHYSICS.values(), ids=list(PHYSICS))
def test_what_a_line_says_is_so(kind: PhysicsKind) -> None:
    assert PHYSICS[kind.name] is kind is physics_kind(kind.name)
    assert kind.resolution in kind.resolutions
    assert bool(kind.needs) == bool(kind.install)
    assert EnvSettings(physics=kind.name).physics == kind.name


@pytest.mark.parametrize("kind", PHYSICS.values(), ids=list(PHYSICS))
def test_each_is_made_and_answers(kind: PhysicsKind) -> None:
    if kind.needs and find_spec(kind.needs) is None:
        pytest.skip(f"{kind.needs} is not installed")
    physics = kind.make(default_scene(), -0.03, kind.resolutions[0])
    assert physics.reset().progress == 0 == physics.state().progress
    physics.close()


def test_one_that_is_added_is_known_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PHYSICS, "still", STILL)
    assert TissueRetractEnv("still").spec is None
    assert EnvSettings(physics="still").physics == "still"
    with pytest.raises(ValueError, match=r"^physics = 'jelly', allowed bullet, fem, rod, still$"):
        TissueRetractEnv("jelly")


def test_a_missing_package_is_named_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kind = replace(STILL, needs="no_such_package", install="pip install no-such-package")
    monkeypatch.setitem(PHYSICS, "still", kind)
    with pytest.raises(ImportError) as caught:
        TissueRetractEnv("still")
    assert str(caught.value) == (
        'physics = "still" needs no_such_package: pip install no-such-package; '
        "TissueRetractFEM-v0, on the finite elements, or TissueRetractRod-v0, on a planar rod, "
        "needs nothing more"
    )


def test_the_package_loads_gymnasium_and_nothing_heavier() -> None:
    code = "import sys, retract_env; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "gymnasium" in loaded and retract_env.__version__
    assert not loaded & {"numba", "scipy", "shapely", "pydantic", "pybullet", "matplotlib", "pygame"}


def test_a_pool_keeps_the_last_flaps_and_closes_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PHYSICS, "still", STILL)
    pool, scene = PhysicsPool("still", size=2), default_scene()
    first, second = (pool.take(scene, x) for x in (-0.01, -0.02))
    assert pool.take(scene, -0.01) is first
    third = pool.take(scene, -0.03)  # the second was used least recently
    assert [p.closed for p in (first, second, third)] == [False, True, False]  # type: ignore[attr-defined]
    copied = pickle.loads(pickle.dumps(pool))
    assert copied.take(scene, -0.01) is not first
    pool.close()
    assert first.closed and third.closed  # type: ignore[attr-defined]
    assert pool.take(scene, -0.01) is not first
