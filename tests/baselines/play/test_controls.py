"""Keyboard, mouse and gamepad, by events that nobody made."""

from __future__ import annotations

import math

import numpy as np
import pygame
import pytest

from baselines.play.controls import AGAIN, DEAD, FIRMER, KEYS, NOTCH, Controls
from baselines.play.game import Command, Drive
from tests.baselines.play.person import button, key, moved, wheel

POSE = np.array([-0.04, 0.002, 0.0, 0.004])
TURN = math.radians(18.0)
FRAME = 1 / 30


def controls() -> Controls:
    """A pixel is a millimetre."""
    return Controls(lambda place: np.array(place) * 1e-3)


def drive(asked: Controls, choosing: bool = False) -> Drive:
    return asked.drive(POSE, TURN, FRAME, choosing)


@pytest.mark.parametrize("code", sorted(KEYS))
def test_a_key_asks_once(code: int) -> None:
    asked = controls()
    assert asked.read(key(code), False) is KEYS[code]
    assert asked.read(key(code, down=False), False) is None


def test_closing_the_window_quits() -> None:
    assert controls().read(pygame.event.Event(pygame.QUIT), True) is Command.QUIT


@pytest.mark.parametrize(
    ("codes", "asked_for"),
    [
        ([pygame.K_LEFT], (-1, 0, 0)),
        ([pygame.K_d, pygame.K_w], (1, 1, 0)),
        ([pygame.K_DOWN, pygame.K_q], (0, -1, 1)),
        ([pygame.K_LEFT, pygame.K_RIGHT, pygame.K_e], (0, 0, -1)),
    ],
)
def test_held_keys_add_up_until_they_are_released(
    codes: list[int], asked_for: tuple[float, float, float]
) -> None:
    asked = controls()
    for code in codes:
        asked.read(key(code), False)
    for _ in range(2):
        now = drive(asked)
        assert (now.x, now.y, now.turn) == asked_for and not now.slow
    asked.read(key(pygame.K_LSHIFT), False)
    assert drive(asked).slow
    for code in [*codes, pygame.K_LSHIFT]:
        asked.read(key(code, down=False), False)
    assert drive(asked) == Drive()


def test_keys_are_let_go_with_the_window() -> None:
    asked = controls()
    asked.read(key(pygame.K_UP), False)
    asked.read(key(pygame.K_u), False)
    asked.read(pygame.event.Event(pygame.WINDOWFOCUSLOST), False)
    assert drive(asked) == Drive() and asked.repeated(10.0) is None


def test_a_held_undo_goes_on_after_a_while() -> None:
    asked = controls()
    asked.read(key(pygame.K_u), False)
    assert asked.repeated(AGAIN) is None
    seen = sum(asked.repeated(FRAME) is Command.UNDO for _ in range(120))
    assert 0.6 * 4 / AGAIN < seen < 4 / AGAIN
    asked.read(key(pygame.K_u, down=False), False)
    assert asked.repeated(10.0) is None


def test_the_mouse_places_and_a_click_closes_the_jaws() -> None:
    asked = controls()
    asked.read(moved((-30, 2)), True)
    asked.read(wheel(2), True)
    assert drive(asked, choosing=True) == Drive(place=-0.03, firmer=2 * FIRMER)
    assert drive(asked, choosing=True) == Drive()  # a mouse at rest leaves the place to the keys
    assert asked.read(button((-20, 2)), True) is Command.CONFIRM
    assert drive(asked, choosing=True).place == pytest.approx(-0.02)
    assert drive(asked).towards is None


def test_dragging_carries_the_jaws_along_from_where_they_are() -> None:
    asked = controls()
    asked.read(button((10, 20)), False)
    assert drive(asked).towards == pytest.approx(POSE[:2])
    asked.read(moved((13, 24)), False)
    assert drive(asked).towards == pytest.approx(POSE[:2] + np.array([0.003, 0.004]))
    asked.read(button((13, 24), down=False), False)
    assert drive(asked).towards is None


def test_the_wheel_turns_by_its_notches_at_the_pace_of_a_key() -> None:
    asked = controls()
    asked.read(wheel(3), False)
    turns = [drive(asked).turn for _ in range(30)]
    assert max(turns) == 1
    assert sum(turns) * TURN * FRAME == pytest.approx(3 * NOTCH)
    asked.read(wheel(-3), False)
    asked.read(key(pygame.K_q), False)
    assert drive(asked).turn == 1  # a key counts more, and what was left is forgotten
    asked.read(key(pygame.K_q, down=False), False)
    assert drive(asked).turn == 0


def axis(number: int, value: float) -> pygame.event.Event:
    return pygame.event.Event(pygame.JOYAXISMOTION, instance_id=0, axis=number, value=value)


def pad_button(number: int, down: bool = True) -> pygame.event.Event:
    kind = pygame.JOYBUTTONDOWN if down else pygame.JOYBUTTONUP
    return pygame.event.Event(kind, instance_id=0, button=number)


def test_a_gamepads_sticks_are_analog_and_at_rest_near_their_middle() -> None:
    asked = controls()
    asked.read(axis(0, 1.0), False)
    asked.read(axis(1, -1.0), False)  # a stick counts downwards
    asked.read(axis(2, 0.01), False)
    asked.read(axis(2, DEAD + (1 - DEAD) / 2), False)
    now = drive(asked)
    assert asked.has_pad
    assert (now.x, now.y, now.turn) == pytest.approx((1, 1, -0.5))  # to the right is clockwise
    for number in range(3):
        asked.read(axis(number, 0.9 * DEAD), False)
    assert drive(asked) == Drive()


def test_a_trigger_is_no_stick() -> None:
    """Pads differ in which axis is the right stick's; a trigger rests at -1."""
    asked = controls()
    asked.read(axis(3, 1.0), False)
    assert drive(asked).turn == -1
    asked.read(axis(2, -0.98), False)
    asked.read(axis(2, 1.0), False)
    assert drive(asked).turn == -1
    other = controls()
    other.read(axis(2, 0.05), False)
    other.read(axis(2, -1.0), False)
    other.read(axis(3, 0.9), False)  # up and down here
    assert drive(other).turn == 1


def test_a_gamepads_buttons() -> None:
    asked = controls()
    wanted = [Command.CONFIRM, Command.UNDO, Command.RESTART, Command.NEW]
    assert [asked.read(pad_button(k), False) for k in range(4)] == wanted
    assert asked.read(pad_button(4), False) is None and drive(asked).turn == 1
    asked.read(pad_button(4, down=False), False)
    asked.read(pad_button(5), False)
    assert drive(asked).turn == -1
    asked.read(pygame.event.Event(pygame.JOYDEVICEREMOVED, instance_id=0), False)
    assert drive(asked) == Drive() and not asked.has_pad
