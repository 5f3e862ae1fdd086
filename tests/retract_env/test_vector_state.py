"""Look-ahead with many flaps: all go back to where they stood, and on as before, to the last bit."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from retract_env.vector import VectorState
from tests.retract_env.playing import digest
from tests.retract_env.vectors import HELD, Player, play, row, same, vector

ROOT = Path(__file__).resolve().parents[2]

KINDS: dict[str, dict[str, Any]] = {
    "random": {"scene": "random", "task": {"steps": 9}},
    "noisy": {"scene": "random", "sensors": {"noise": 0.01}, "autoreset_mode": "SameStep"},
    "veins": {"scene": "ten_veins", "grasp": "spring", "autoreset_mode": "SameStep"},
    "held": {"scene": "random", "grasp": HELD},
    "unknown": {"scene": "random", "unknowns": {"closing": 5e-4}, "task": {"steps": 9}},
    "spring": {"scene": "random", "grasp": "spring"},
}
MOVE = np.array([0.3, 0.8, -0.7])


def go_on(envs: Any, steps: int = 8) -> list[Any]:
    """All that they say from here on, new episodes of theirs included."""
    n = envs.num_envs
    said = [envs.step(np.tile(MOVE, (n, 1)) * np.linspace(0.3, 1, n)[:, None]) for _ in range(steps)]
    mask = np.arange(n) % 2 == 0
    return [*said, envs.reset(options={"reset_mask": mask}), envs.step(np.tile(MOVE, (n, 1))), envs.reset()]


@pytest.mark.parametrize("kind", KINDS)
def test_going_on_from_a_state_is_going_on_as_before(kind: str) -> None:
    untouched, envs, other = (vector(9, **KINDS[kind]) for _ in range(3))
    other.reset(seed=77)
    play(other, Player(9, 9), 3, None)
    for one in (untouched, envs):
        one.set_scene(1, "twenty_veins")  # more veins than there is room for at first
        play(one, Player(0, 9), 5)
    expected = go_on(untouched)
    state = envs.get_state()
    same(go_on(envs), expected)
    kept = pickle.dumps(state)
    for given in (state, pickle.loads(kept), copy.deepcopy(state)):
        for one in (envs, other, vector(9, **KINDS[kind])):
            one.set_state(given)
            one.set_state(one.get_state())
            same(go_on(one), expected)
    assert pickle.dumps(state) == kept, "going on changes a state"


def test_states_are_set_in_any_order() -> None:
    envs = vector(9, scene="random", task={"steps": 6})
    envs.reset(seed=0)
    player, states, said = Player(0, 9), [], []
    seen = envs.reset(seed=1)[0]
    for _ in range(14):
        states.append(envs.get_state())
        chosen = player(seen)
        said.append((chosen, envs.step(chosen)))
        seen = said[-1][1][0]
    for k in np.random.default_rng(0).permutation(2 * len(states)) % len(states):
        envs.set_state(states[k])
        for chosen, expected in said[k : k + 2]:
            same(envs.step(chosen), expected)


def test_a_masked_reset_shows_the_others_as_the_state_has_them() -> None:
    envs, mask = vector(3, scene="random"), np.array([True, False, False])
    seen = play(envs, Player(0, 3), 4)[-1][0]
    state = envs.get_state()
    play(envs, Player(1, 3), 3, seed=50)
    for one in (envs, vector(3, scene="random")):
        one.set_state(state)
        assert np.array_equal(one.reset(options={"reset_mask": mask})[0][1:], seen[1:])


@pytest.mark.parametrize("count", [1, 8, 19])
def test_one_is_continued_in_many_ways(count: int) -> None:
    """As often as asked, whatever environment k was and wherever its continuations are."""
    envs = vector(11, scene="random", sensors={"noise": 0.01}, autoreset_mode="SameStep")
    envs.set_scene(9, "ten_veins")
    play(envs, Player(0, 11), 5)
    state = envs.get_state()
    alone, tree = (
        vector(n, scene="random", sensors={"noise": 0.01}, autoreset_mode="SameStep") for n in (1, count)
    )
    for k in (0, 4, 9, 10):
        tree.set_state(state.repeated(k, count))
        tree.set_state(tree.get_state().repeated(count - 1, count))
        steps = [np.random.default_rng(s).uniform(-1, 1, (count, 3)) for s in range(8)]
        said = [tree.step(chosen) for chosen in steps]
        for j in {0, count // 2, count - 1}:
            alone.set_state(state.repeated(k, 1))
            expected = [alone.step(chosen[j : j + 1]) for chosen in steps]
            for one, other in zip(
                row([s[:4] for s in said], j), row([e[:4] for e in expected], 0), strict=True
            ):
                same(one, other)


def test_it_is_the_same_in_a_fresh_process(tmp_path: Path) -> None:
    envs = vector(10, **KINDS["noisy"])
    play(envs, Player(0, 10), 5)
    kept = tmp_path / "state"
    kept.write_bytes(pickle.dumps(envs.get_state()))
    code = """
import pickle, sys
from pathlib import Path
from tests.retract_env.test_vector_state import KINDS, digest, go_on, vector
envs = vector(10, **KINDS["noisy"])
envs.set_state(pickle.loads(Path(sys.argv[1]).read_bytes()))
print(digest([one[:1] for one in go_on(envs)]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(kept)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == digest([one[:1] for one in go_on(envs)])


def test_scenes_and_grasp_come_with_a_state() -> None:
    """Of the next episodes, as they would have been where the state is from."""
    theirs, ours = vector(3, scene="random", grasp="spring"), vector(3, scene="homogeneous")
    theirs.set_scene(2, "ten_veins")
    theirs.reset(seed=0)
    ours.set_state(theirs.get_state())
    same(go_on(ours), go_on(theirs))


def test_a_state_with_fewer_veins_leaves_room_for_more() -> None:
    few, many = (vector(2, scene="random", ranges={"veins": [n, n]}) for n in (0, 20))
    few.reset(seed=0)
    many.set_state(few.get_state())
    assert np.array_equal(
        many.reset(seed=3)[0], vector(2, scene="random", ranges={"veins": [20, 20]}).reset(seed=3)[0]
    )


def test_over_is_over() -> None:
    envs = vector(2, autoreset_mode="Disabled")
    envs.reset(seed=0)
    envs.step(np.array([[0.0, 1.0, 0.0], [0.0, -0.5, 0.0]]))  # tears the first
    state = envs.get_state()
    envs.reset()
    envs.set_state(state)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 3)))


def test_what_is_no_state_or_of_others_is_refused_and_changes_nothing() -> None:
    envs = vector(3, grasp=HELD)
    with pytest.raises(ResetNeeded):
        envs.get_state()
    envs.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(ResetNeeded):
        envs.get_state()
    envs.reset(seed=0)
    state = envs.get_state()
    expected = go_on(envs)
    envs.set_state(state)
    wrong: list[tuple[Any, type[Exception], str]] = [
        (7, TypeError, r"^state is a int, allowed a VectorState$"),
        (state.repeated(0, 2), ValueError, r"^state of 2 environments, allowed 3$"),
        (_other_task(), ValueError, r"^the state is of an environment whose task differs in steps$"),
    ]
    for given, error, said in wrong:
        with pytest.raises(error, match=said):
            envs.set_state(given)
    for k, n in ((-1, 2), (3, 2), (0, 0)):
        with pytest.raises(ValueError, match=r"allowed"):
            state.repeated(k, n)
    same(go_on(envs), expected)


def _other_task() -> VectorState:
    envs = vector(3, grasp=HELD, task={"steps": 9})
    envs.reset(seed=0)
    return envs.get_state()
