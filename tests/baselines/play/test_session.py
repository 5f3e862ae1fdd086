"""A person's episode: made of actions, taken back, and handed in as it was."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.play.handing_in import LEAD, OFF, handed_in, thinned
from baselines.play.session import FRAMES, SHARE, SLOW, Phase, Session
from retract_env.grasp import Grasp, JawPath, to_jaws
from tests.baselines.play.person import GRASP, closed, directions, retract, session


def play_again(begun: Session) -> None:
    """The episode's actions in its environment, from its seed, to the last bit."""
    played = begun.played
    seen, _ = begun.env.reset(seed=begun.dealt.seed)
    assert np.array_equal(seen, played.observations[0])
    for k, action in enumerate(played.actions):
        assert action.dtype == np.float32 and np.abs(action).max() <= 1
        seen, reward, terminated, truncated, _ = begun.env.step(action)
        assert np.array_equal(seen, played.observations[k + 1]) and reward == played.rewards[k]
    assert (terminated, truncated) == (played.terminated, played.truncated)


def at(begun: Session) -> Phase:
    """Its phase, of which a type checker believes that no call changes it."""
    return begun.phase


def test_a_retraction_by_hand_is_an_episode_of_the_environment() -> None:
    done = retract(closed())
    assert done.success and done.phase is Phase.ENDED and not done.failure
    play_again(done)


@pytest.mark.parametrize("physics", ["rod", "fem"])
def test_what_was_taken_back_is_no_part_of_the_episode(physics: str) -> None:
    begun = closed(physics=physics)
    for _ in range(30):
        begun.move((0, 1, -1))
    before, steps = begun.pose, len(begun)
    for _ in range(4):  # fewer than are taken back at once
        begun.move((-1, 0, 1))
    assert begun.undo() and len(begun) < steps + 4
    for _ in range(steps - len(begun)):
        begun.move((0, 1, -1))
    assert begun.pose == pytest.approx(before, abs=1e-12)
    play_again(begun)


def test_a_pause_ends_what_is_taken_back_at_once() -> None:
    begun = closed()
    for _ in range(3):
        begun.move((0, 1, -1))
    before = begun.pose
    begun.move((0, 0, 0))
    for _ in range(3):
        begun.move((1, 0, 0))
    assert len(begun) == 7 and begun.undo()
    assert len(begun) == 4 and np.array_equal(begun.pose, before)


def test_no_more_is_taken_back_at_once_than_the_largest_move() -> None:
    begun = closed()
    for _ in range(36):
        begun.move((0, 1, 0))
    ends = [begun.pose]
    while begun.undo() and at(begun) is Phase.MOVE:
        ends.append(begun.pose)
    ways = -np.diff([pose[1] for pose in ends])
    assert (ways > 0).all() and ways.max() < 2e-3 + 1e-9 and len(ways) == 4
    begun = closed()
    for _ in range(3):
        begun.move((0, 1, 0), seconds=0.3)  # a slow physics
    assert begun.undo() and len(begun) == 3


def test_a_physics_that_cannot_be_put_back_makes_the_moves_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for restorable in (True, False):
        monkeypatch.setattr(Session, "restorable", restorable)
        begun = closed()
        for direction, _ in zip(directions(), range(25), strict=False):
            begun.move(direction)
        assert begun.undo()
        assert begun.phase is (Phase.MOVE if restorable else Phase.BACK)
        rounds = 0
        while begun.phase is Phase.BACK:
            assert not begun.undo()
            begun.go_on()
            rounds += 1
        assert rounds == (0 if restorable else 21)
        begun.move((1, 0, 0))
        ends.append(begun.played)
    assert np.array_equal(ends[0].observations, ends[1].observations)
    assert np.array_equal(ends[0].actions, ends[1].actions)


def test_a_broken_limit_can_be_taken_back_and_a_success_stays() -> None:
    begun = closed()
    while at(begun) is Phase.MOVE:
        begun.move((0, 1, 1))
    assert begun.failure == "slip" and not begun.success
    assert begun.undo() and at(begun) is Phase.MOVE and not begun.failure
    assert begun.undo() and begun.undo()
    while at(begun) is Phase.MOVE:
        assert begun.undo()
    assert at(begun) is Phase.GRASP and len(begun) == 0 and not begun.undo()
    begun.confirm()
    assert retract(begun).success and not begun.undo()
    play_again(begun)


def test_a_held_key_moves_the_jaws_by_millimetres_a_second_and_no_way_is_faster() -> None:
    for direction, slow in (((1, 0, 0), False), ((1, 1, 0), False), ((-0.6, 0.8, 0), True)):
        begun = closed()
        start = begun.pose
        for _ in range(6):
            begun.move(direction, slow=slow)
        way = np.hypot(*(begun.pose - start)[:2])
        assert way == pytest.approx(6e-3 * (SLOW if slow else 1.0) * 6 / FRAMES, rel=1e-5)
    assert session().speed(False) == pytest.approx([6e-3, 6e-3, np.radians(18)])
    assert np.array(session().env.task_config.move) * SHARE * FRAMES == pytest.approx(session().speed(False))


def test_a_slow_frame_moves_farther_but_never_beyond_an_action() -> None:
    begun = closed()
    start = begun.pose
    begun.move((0, 1, -1), seconds=0.1)
    assert (begun.pose - start)[1] == pytest.approx(6e-4, rel=1e-5)
    begun.move((0, 1, -1), seconds=10.0)
    assert np.array_equal(begun.played.actions[-1], np.array([0, 1, -1], np.float32))


def test_dragged_jaws_come_to_where_they_are_dragged_and_stay() -> None:
    begun = closed()
    x, y = begun.pose[:2] + np.array([3e-4, 4e-4])
    for _ in range(10):
        begun.move_towards(x, y, 0.0)
    assert begun.pose[:2] == pytest.approx([x, y], abs=2e-5)
    assert len(begun) < 6


def test_the_grasp_that_is_proposed_is_the_one_that_is_taken() -> None:
    begun = session()
    begun.propose_at(GRASP)
    assert begun.proposed.x == pytest.approx(GRASP, abs=1e-8)
    begun.propose_at(1.0)
    assert begun.along == 1.0 and begun.proposed.x < 0
    begun.propose(along=-7.0, firmness=3.0)
    assert (begun.along, begun.firmness) == (-1.0, 1.0)
    height = begun.dealt.scene.tissue.height
    assert begun.proposed == Grasp(-begun.dealt.scene.tissue.length, 0.5 * height)
    begun.propose(0.2, -0.3)
    proposed = begun.proposed
    begun.confirm()
    assert begun.env.episode.grasp == proposed and begun.phase is Phase.MOVE
    begun.confirm()
    assert len(begun) == 1


def test_what_is_handed_in_is_the_way_of_the_jaws_with_fewer_waypoints() -> None:
    done = retract(closed())
    found = handed_in(done.env.episode, success=False)
    whole = done.env.episode.path
    assert found is not None and whole is not None
    grasp, path = found
    assert len(path) < len(whole) / 10
    height = done.dealt.scene.tissue.height
    assert path.waypoints[1] == pytest.approx(
        [grasp.x, grasp.compression / 2, grasp.x, height - grasp.compression / 2]
    )
    assert path.waypoints[-1] == pytest.approx(whole.waypoints[-1], abs=1e-12)
    fine = path.jaws_at(np.linspace(1, path.last, 20_000)).reshape(-1, 2, 2)
    for jaws in whole.waypoints[1:].reshape(-1, 2, 2):
        assert np.linalg.norm(fine - jaws, axis=2).max(axis=1).min() < OFF + 2e-6


def test_what_succeeded_is_led_on_as_it_ended() -> None:
    done = retract(closed())
    plain, led = (handed_in(done.env.episode, success=success) for success in (False, True))
    assert plain is not None and led is not None
    kept = len(plain[1])
    assert np.array_equal(led[1].waypoints[:kept], plain[1].waypoints) and len(led[1]) == kept + 3
    more = np.linalg.norm(np.diff(led[1].waypoints[kept - 1 :], axis=0).reshape(3, 2, 2), axis=2).sum(axis=0)
    assert more.max() == pytest.approx(LEAD, rel=0.01)
    turn, ahead = np.diff(led[1].poses[kept - 2 :], axis=0)[:2]
    assert (ahead[:3] / ahead[2]) == pytest.approx(turn[:3] / turn[2], rel=1e-3)


def test_jaws_that_never_closed_hand_in_nothing() -> None:
    assert handed_in(session().env.episode, success=False) is None


def test_thinning_keeps_corners() -> None:
    ahead = np.linspace(0, 1, 30)[:, None] * [[1e-3, 2e-3, -0.3, 0.0]]
    corner = np.concatenate([ahead, ahead[-1] + np.linspace(0, 1, 30)[1:, None] * [[2e-3, 0, 0.2, 0.0]]])
    poses = np.array([-0.03, 2e-3, 0.0, 4e-3]) + corner
    kept = thinned(poses)
    assert kept == pytest.approx(poses[[0, 29, -1]])
    assert JawPath(to_jaws(kept), "played").poses == pytest.approx(kept)
