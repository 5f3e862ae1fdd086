"""Look-ahead: an environment goes back to where it stood, and on from there as before, to the last bit."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from planners.paths import ctc
from retract_env.env import TissueRetractEnv
from retract_env.errors import Diverged
from retract_env.grasp import Grasp
from retract_env.physics.base import TissueState
from retract_env.physics.fem import FemPhysics, FemState
from retract_env.physics.registry import PHYSICS, PhysicsKind
from retract_env.scene import Scene, load_scene
from tests.retract_env.physics.test_physics_fem import GRASP, at_rest, same_bits, veined
from tests.retract_env.playing import BULLET, FEM, LIFT, ROD, digest

ROOT = Path(__file__).resolve().parents[2]
HELD = {"x": -0.03, "compression": 1e-3}
CLOSE = np.array([-0.2, 0.1, 0.0])

KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "fem": (FEM, {"scene": "ten_veins"}),
    "noisy": (FEM, {"scene": "random", "sensors": {"noise": 0.01}}),
    "bullet": (BULLET, {"scene": "random", "sensors": {"noise": 0.01}}),
    "rod": (ROD, {"scene": "random", "sensors": {"noise": 0.01}}),
}


def go_on(env: TissueRetractEnv, steps: int = 3) -> str:
    """Digest of all that it says of some steps more, then of the next episode, which its own generator
    draws."""
    said: list[Any] = []
    for k in range(steps):
        said.append(env.step(LIFT * (1 - 0.1 * k)))
        if said[-1][2] or said[-1][3]:
            break
    return digest([*said, env.reset(), env.step(CLOSE), env.step(LIFT)])


def begin(env: TissueRetractEnv, moves: int = 2) -> None:
    env.reset(seed=2)
    for action in [CLOSE, *[LIFT] * moves]:
        env.step(action)


@pytest.mark.parametrize(("name", "options"), KINDS.values(), ids=KINDS)
def test_going_on_from_a_state_is_going_on_as_before(
    make: Callable[..., TissueRetractEnv], name: str, options: dict[str, Any]
) -> None:
    untouched, env, other = make(name, **options), make(name, **options), make(name, **options)
    begin(untouched)
    expected = go_on(untouched)
    begin(env)
    state = env.get_state()
    assert go_on(env) == expected, "getting a state changes how the environment goes on"
    for _ in range(2):
        env.set_state(state)
        assert env.episode.now.steps == 3
        assert go_on(env) == expected
    other.set_state(state)  # before its first reset
    other.set_state(other.get_state())
    assert go_on(copy.deepcopy(other)) == expected
    assert go_on(other) == expected  # which now stands on another flap, held elsewhere
    other.set_state(state)
    assert go_on(other) == expected


def test_states_are_set_in_any_order(make: Callable[..., TissueRetractEnv]) -> None:
    """Before the grasp, with closed jaws, after moves, at the end: what follows each is what followed it."""
    env = make(scene="ten_veins")
    states, said = [], []
    env.reset(seed=0)
    for action in (CLOSE, LIFT, LIFT / 2, LIFT * [-1.0, 1.0, 0.5], LIFT):
        states.append(env.get_state())
        said.append((action, digest([env.step(action)])))
    for k in np.random.default_rng(0).permutation(2 * len(states)) % len(states):
        env.set_state(states[k])
        assert env.episode.now.steps == k and len(env.episode.history) == k + 1
        for action, expected in said[k : k + 2]:
            assert digest([env.step(action)]) == expected
    env.set_state(states[0])
    assert env.step(np.array([0.0, 1.0, 0.0]))[2]  # tears
    over = env.get_state()
    env.set_state(states[1])
    assert digest([env.step(LIFT)]) == said[1][1]
    env.set_state(over)
    with pytest.raises(ResetNeeded):
        env.step(LIFT)


def test_a_closed_environment_opens_again_where_it_stood(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp=HELD)
    env.reset(seed=0)
    state = env.get_state()
    expected = digest([env.step(LIFT)])
    env.close()
    env.set_state(state)
    assert digest([env.step(LIFT)]) == expected


@pytest.mark.parametrize("kind", ["noisy", "bullet"])
def test_a_state_is_the_same_in_a_fresh_process(
    make: Callable[..., TissueRetractEnv], kind: str, tmp_path: Path
) -> None:
    name, options = KINDS[kind]
    env = make(name, **options)
    begin(env)
    kept = tmp_path / "state"
    kept.write_bytes(pickle.dumps(env.get_state()))
    physics = env.spec.kwargs["physics"] if env.spec else ""
    # there it stands on another flap before
    code = f"""
import pickle, sys
from pathlib import Path
from retract_env.env import TissueRetractEnv
from tests.retract_env.test_env_state import begin, go_on
env = TissueRetractEnv({physics!r}, resolution="coarse", **{options!r})
env.reset(seed=5)
env.set_state(pickle.loads(Path(sys.argv[1]).read_bytes()))
print(go_on(env))
"""
    command = [sys.executable, "-c", code, str(kept)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == go_on(env)


def test_what_is_no_state_or_of_another_environment_is_refused(make: Callable[..., TissueRetractEnv]) -> None:
    env = make(grasp=HELD)
    with pytest.raises(ResetNeeded):
        env.get_state()
    env.reset(seed=0)
    env.step(LIFT)
    before, state = env.episode, env.get_state()
    finer = make(grasp=HELD, resolution="medium")
    longer = make(grasp=HELD, task={"steps": 9, "cap": 3})
    for given, error, said in (
        (7, TypeError, r"^a state of get_state is needed, not int$"),
        (state.episode, TypeError, r"needed, not EpisodeState$"),
    ):
        with pytest.raises(error, match=said):
            env.set_state(given)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^the state is of an environment with resolution = 'coarse', here"):
        finer.set_state(state)
    with pytest.raises(
        ValueError, match=r"^the state is of an environment whose task differs in steps, cap$"
    ):
        longer.set_state(state)
    assert env.episode is before
    if find_spec("pybullet"):
        with pytest.raises(ValueError, match=r"with physics = 'fem', here 'bullet'$"):
            make(BULLET).set_state(state)


class Plain:
    """The finite elements without a state of their own, as physics of other packages may be."""

    resolutions = FemPhysics.resolutions

    def __init__(self, *given: Any, **named: Any):
        self._physics = FemPhysics(*given, **named)
        self.section = self._physics.section
        self.reset, self.move_to = self._physics.reset, self._physics.move_to
        self.state, self.close = self._physics.state, self._physics.close


def test_a_physics_without_states_makes_its_moves_again(
    make: Callable[..., TissueRetractEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: Any = Plain
    monkeypatch.setitem(PHYSICS, "plain", PhysicsKind("plain", "Plain-v0", made, "coarse", "no states"))
    env, plain = make(scene="ten_veins"), TissueRetractEnv("plain", scene="ten_veins")
    begin(env)
    begin(plain)
    state = plain.get_state()
    assert state.episode.physics is None
    expected = go_on(env)
    assert go_on(plain) == expected
    plain.set_state(pickle.loads(pickle.dumps(state)))
    assert go_on(plain) == expected


# --- States of a physics alone


@pytest.mark.parametrize("kind", PHYSICS.values(), ids=list(PHYSICS))
def test_what_a_physics_that_has_states_promises(kind: PhysicsKind) -> None:
    if kind.needs and find_spec(kind.needs) is None:
        pytest.skip(f"{kind.needs} is not installed")
    if not hasattr(kind.load(), "get_state"):
        pytest.skip("has no states; episodes make their moves again")
    scene = load_scene("ten_veins")
    height = scene.tissue.height
    poses = np.array([[HELD["x"], height / 2 + 1e-3 * k, -0.05 * k, 0.8 * height] for k in range(5)])
    physics: Any = kind.make(scene, HELD["x"], kind.resolution)
    other: Any = kind.make(scene, HELD["x"], kind.resolution)
    physics.reset()
    physics.move_to(poses[0], 1.0)
    states = [physics.get_state()]
    expected = []
    for pose in poses[1:]:
        expected.append(physics.move_to(pose))
        states.append(physics.get_state())
    for k in (3, 1, 0, 2, 1):
        state = pickle.loads(pickle.dumps(states[k]))
        for one in (physics, other):
            one.set_state(state)
            assert k == 0 or same_bits(one.state(), expected[k - 1])
            assert same_bits(one.move_to(poses[k + 1]), expected[k])
            assert same_bits(one.state(), expected[k])
    with pytest.raises(TypeError):
        physics.set_state(None)
    with pytest.raises(ValueError, match="grasp"):
        kind.make(scene, -0.02, kind.resolution).set_state(states[0])  # type: ignore[attr-defined]
    physics.close()
    other.close()


def along(physics: FemPhysics, scene: Scene, stops: list[float]) -> list[TissueState]:
    way = ctc(scene, GRASP)
    return [physics.move_to(way.pose_at(p), p) for p in stops]


def test_a_state_on_a_path_predicts_and_corrects_as_before() -> None:
    """On a path equilibria are extrapolated and factorisations serve more than one: both go on."""
    scene, first, last = veined(), [0.5, 1.0, 1.5, 2.0, 2.5, 3.0], [3.5, 4.0, 4.5]
    untouched, physics = at_rest(scene), at_rest(scene)
    along(untouched, scene, first)
    expected = along(untouched, scene, last)
    along(physics, scene, first)
    state = physics.get_state()
    assert isinstance(state, FemState) and state.kept is not None and len(state.kept.curvature)
    known = list(state.history)
    way = ctc(scene, GRASP)
    middle, _ = physics.between(known, way.pose_at(2.5), way.pose_at(2.8), 2.8)
    physics.set_state(state)
    before = physics.equilibrium.counts["factorisations"]
    for found, right in zip(along(physics, scene, last), expected, strict=True):
        assert same_bits(found, right)
    assert physics.equilibrium.counts["factorisations"] > before

    away = FemPhysics(scene, GRASP.x, "coarse")
    for given in (state, pickle.loads(pickle.dumps(state))):
        away.set_state(given)
        away.set_state(away.get_state())  # before anything was factorised again
        for found, right in zip(along(away, scene, last), expected, strict=True):
            assert same_bits(found, right)
    away.set_state(state)
    assert same_bits(away.between(known, way.pose_at(2.5), way.pose_at(2.8), 2.8)[0], middle)
    assert same_bits(away.reset(), at_rest(scene).state())


def test_a_state_after_a_move_that_failed() -> None:
    scene = veined()
    physics, height = at_rest(scene), scene.tissue.height
    closed = np.array([GRASP.x, height / 2, 0.0, 0.75 * height])
    physics.move_to(closed, 1.0)
    with pytest.raises(Diverged):
        physics.move_to(closed * [1, 1, 1, -0.07])
    state, away = physics.get_state(), FemPhysics(scene, GRASP.x, "coarse")
    away.set_state(state)
    assert same_bits(away.state(), physics.state())
    lifted = closed * [1, 1.5, 1, 1]
    assert same_bits(away.move_to(lifted), physics.move_to(lifted))


def test_a_state_off_any_path_is_small() -> None:
    """Nothing of the solver's is kept that the next move would not use: trees keep thousands of states."""
    scene = veined()
    physics = at_rest(scene)
    closed = np.array([GRASP.x, scene.tissue.height / 2, 0.0, 0.75 * scene.tissue.height])
    physics.move_to(closed, 1.0)
    physics.move_to(closed * [1, 1.5, 1, 1])
    # where it stands, what holds it, where the factorisation was made
    numbers = 3 * len(physics.displacements)
    assert len(pickle.dumps(physics.get_state())) < 8 * numbers + 2_000


def test_a_state_of_another_flap_is_refused() -> None:
    state = at_rest(veined()).get_state()
    for other, said in (
        (FemPhysics(load_scene("homogeneous"), GRASP.x, "coarse"), "another scene: "),
        (FemPhysics(veined(), Grasp(-0.02, 1e-3).x, "coarse"), "another grasp: -0.025, here -0.02$"),
        (FemPhysics(veined(), GRASP.x, "medium"), "another resolution: "),
    ):
        with pytest.raises(ValueError, match=said):
            other.set_state(state)
