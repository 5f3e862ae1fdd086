"""What environment k of a vector does depends on its seed alone: not on the others, not on threads."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import sys
import threading
from typing import Any

import numpy as np
import pytest

from tests.retract_env.playing import digest
from tests.retract_env.vectors import NEXT, SAME, Player, play, row, same, singles, vector

# --- Seeds


@pytest.mark.parametrize(
    "seed", [3, np.int64(3), [7, 5, 11], np.arange(3), (None, 4, None), [1, None, 1]], ids=str
)
def test_seeds_are_those_of_single_ones(seed: Any) -> None:
    native, single = vector(3, scene="random"), singles(3, scene="random")
    for envs in (native, single):
        envs.reset(seed=0)  # what has no seed goes on from here
    given = seed.tolist() if hasattr(seed, "tolist") else seed  # of which Gymnasium's knows nothing
    same(play(native, Player(0, 3), 8, seed), play(single, Player(0, 3), 8, given))
    assert native.np_random_seed == single.np_random_seed
    same(native.reset(), single.reset())
    same(native.reset(seed=None), single.reset(seed=None))


def test_without_any_seed_they_differ_and_their_seeds_can_be_had() -> None:
    envs = vector(3, scene="random")
    assert envs.np_random_seed == (None, None, None)
    first = envs.reset()[0]
    seeds = envs.np_random_seed
    assert len(set(seeds)) == 3 and None not in seeds
    assert not np.array_equal(first[0], first[1])
    envs.reset()
    assert envs.np_random_seed == seeds
    assert np.array_equal(vector(3, scene="random").reset(seed=seeds)[0], first)


def test_a_reset_without_a_seed_goes_on() -> None:
    envs, other = vector(2, scene="random"), vector(2, scene="random")
    said = [envs.reset(seed=4)[0], *(envs.reset()[0] for _ in range(3))]
    assert len({digest([[one]]) for one in said}) == 4
    again = [other.reset(seed=4)[0], *(other.reset()[0] for _ in range(3))]
    same(said, again)


# --- Who else is there


@pytest.fixture(scope="module")
def many() -> list[Any]:
    """What 40 environments say on one thread, some of them with a scene of their own."""
    return _playing(40, 1)


def _playing(count: int, threads: int, **options: Any) -> list[Any]:
    envs = vector(count, threads=threads, scene="random", sensors={"noise": 0.01}, **options)
    for k in range(0, count, 5):
        envs.set_scene(k, "ten_veins")
    said = play(envs, Player(8, count), 20)
    envs.close()
    return said


@pytest.mark.parametrize("count", [1, 7, 8, 9, 16, 17])
def test_it_does_not_depend_on_how_many_there_are(many: list[Any], count: int) -> None:
    said = _playing(count, 1)
    for k in range(count):
        same(row(said, k), row(many, k))


@pytest.mark.parametrize("threads", [2, 3, 64])
def test_it_does_not_depend_on_threads(many: list[Any], threads: int) -> None:
    same(_playing(40, threads), many)


def test_a_closed_one_goes_on() -> None:
    envs, other = (vector(20, threads=2, scene="random") for _ in range(2))
    for one in (envs, other):
        one.reset(seed=0)
    envs.close()
    envs.close()
    actions = np.full((20, 3), 0.2)
    same(envs.step(actions), other.step(actions))
    envs.close()


def test_two_threads_of_a_program_step_two_vectors_at_once() -> None:
    expected = {seed: _seeded(seed) for seed in (0, 1)}
    found: dict[int, Any] = {}
    threads = [
        threading.Thread(target=lambda seed=seed: found.__setitem__(seed, _seeded(seed))) for seed in (0, 1)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)
    for seed in (0, 1):
        same(found[seed], expected[seed])


def _seeded(seed: int) -> list[Any]:
    envs = vector(20, threads=2, scene="random", autoreset_mode=SAME)
    return play(envs, Player(seed, 20), 15, seed)


def _step(envs: Any, out: Any) -> None:
    out.put(digest([list(envs.step(np.full((20, 3), 0.3))[:4])]))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere processes are not forked")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_goes_on_with_threads_of_its_own() -> None:
    envs = vector(20, threads=2, scene="random", autoreset_mode=NEXT)
    envs.reset(seed=0)
    envs.step(np.zeros((20, 3)))
    context = multiprocessing.get_context("fork")
    out = context.Queue()
    process = context.Process(target=_step, args=(envs, out))
    process.start()
    try:
        theirs = out.get(timeout=60)
    finally:
        process.join(10)
        process.kill()
    assert theirs == digest([list(envs.step(np.full((20, 3), 0.3))[:4])])


@pytest.mark.parametrize("how", ["copy", "pickle"])
def test_a_copy_goes_on_as_the_original(how: str) -> None:
    envs = vector(20, threads=2, scene="random", sensors={"noise": 0.01})
    envs.set_scene(3, "ten_veins")
    play(envs, Player(0, 20), 4)
    copied = copy.deepcopy(envs) if how == "copy" else pickle.loads(pickle.dumps(envs))
    same(_on(copied), _on(envs))


def _on(envs: Any) -> list[Any]:
    said = [envs.step(np.full((envs.num_envs, 3), 0.3)) for _ in range(6)]
    return [*said, envs.reset(), envs.step(np.zeros((envs.num_envs, 3)))]
